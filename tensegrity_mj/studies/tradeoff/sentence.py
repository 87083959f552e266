"""Sentences to act on: for an accuracy, what to use; and what no step cures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tensegrity_mj.studies.tradeoff.front import cheapest, decades
from tensegrity_mj.studies.tradeoff.settings import power_text

Data = Mapping[str, Any]
ENOUGH = 0.1  # of a modelling floor: a smaller numerical error buys nothing
ALIKE = 1.25  # wall times that differ by less are the same to a clock
ADVICE = ("error at most", "fastest here", "fewest right-hand sides")


def label(point: Data) -> str:
    """A point's setting for people."""
    return f"{point['family']}, {point['knob']}"


def with_timing(data: Data) -> list[tuple[Data, Data]]:
    """The experiments of a study's data, each with what a clock measured of it."""
    return [(one, data["timing"]["experiments"][one["key"]]) for one in data["experiments"]]


def bounds(experiment: Data) -> list[float | None]:
    """Of each point: its error and the reference's own together [m]; None where it has none."""
    own = experiment["reference"]["own_error"]
    return [None if own is None or one["error"] is None else one["error"] + own for one in experiment["points"]]


def advice(experiment: Data, costs: Sequence[float | None], timing: Sequence[Data] | None = None) -> list[Data]:
    """For each decade of accuracy the cheapest adequate point and a sentence.

    Args:
        costs: one a point: wall times [s] or right-hand sides.
        timing: of the points, where costs are wall times.
    """
    reaches = bounds(experiment)
    facts: list[Data] = []
    for tolerance in decades(experiment["reference"]["motion"] or 0.0, reaches):
        number, text = _choice(experiment, costs, timing, tolerance)
        if number is None:
            text = f"for {power_text(tolerance)} m: {_out_of_reach(experiment, tolerance)}"
        else:
            text = f"for {power_text(tolerance)} m use {text}"
        facts.append({"tolerance": tolerance, "point": number, "text": text})
    return facts


def advice_alone(advised: Data) -> str:
    """A sentence of `advice` without its head, which names the accuracy."""
    head = f"for {power_text(advised['tolerance'])} m"
    return str(advised["text"]).removeprefix(head).removeprefix(" use ").removeprefix(": ")


def advice_rows(experiment: Data, timing: Data) -> list[tuple[str, str, str]]:
    """What to use for which accuracy, by wall time and by right-hand sides, under the heads `ADVICE`."""
    pairs = zip(timing["advice"], experiment["by_right_hand_sides"]["advice"], strict=True)
    return [(metres(one["tolerance"]), advice_alone(one), advice_alone(other)) for one, other in pairs]


def floor_sentence(experiment: Data, costs: Sequence[float | None], timing: Sequence[Data] | None = None) -> str | None:
    """What holding does to the motion, and what is fine enough for it; None where nothing is held."""
    floor = experiment["modelling_floor"]
    if floor is None:
        return None
    if floor["distance"] is None:
        return f"{experiment['title']}: its distance from the continuous law is unknown ({floor['reason']})"
    head = f"{experiment['title']}: {metres(floor['distance'])} from the continuous law's motion, whatever the step"
    if floor["distance"] <= floor["resolved"]:
        return f"{head} (no more than the references' own errors, {metres(floor['resolved'])})"
    number, text = _choice(experiment, costs, timing, ENOUGH * floor["distance"])
    if number is None:
        return f"{head}; no setting here has an error ten times smaller"
    return f"{head}; fine enough for it is {text}"


def remarks(experiment: Data, whole: float) -> list[str]:
    """What must be known of an experiment to take its advice, `whole` [s] being the scene's own duration."""
    found, duration = [], experiment["duration"]
    if experiment["note"]:
        found.append(experiment["note"])
    if duration < whole * (1 - 1e-9):
        found.append(
            f"Runs are {duration:g} s long, the scene's {whole:g} s: what is advised holds for the short ones."
        )
    if experiment["reference"].get("touches") == 0:
        found.append(
            f"Nothing touches anything within {duration:g} s: this is advice for free flight and not for contact, "
            "which needs a longer run, or a start nearer to it."
        )
    return found


def why_none(experiment: Data) -> str:
    """Why there is no advice: no reference, or a motion that is too small for any accuracy to be chosen."""
    if experiment["reference"]["engine"] is None:
        return reference_sentence(experiment)
    return (
        f"no node moves by more than {metres(experiment['reference']['motion'])} in {experiment['duration']:g} s, so "
        "that there is no accuracy to choose a setting for: run longer, or start where something moves"
    )


def reference_sentence(experiment: Data) -> str:
    """What the errors are against, and how far that may be off."""
    reference = experiment["reference"]
    if reference["engine"] is None:
        return f"no reference: {reference['reason']}"
    looser, second = reference["looser"], reference["second_formulation"]
    text = (
        f"reference {reference['engine']}, known to {metres(reference['own_error'])}: "
        f"{metres(looser['difference'])} from {looser['engine']}"
    )
    if second is None:
        return f"{text}; there is no second formulation"
    return f"{text}, {metres(second['difference'])} from {second['engine']}"


def metres(value: float | None) -> str:
    """A distance for people."""
    if value is None:
        return "–"
    return "0 m" if value == 0 else f"{power_text(float(f'{value:.1e}'))} m" if value < 1e-3 else f"{value:.2g} m"


def factor_text(value: float) -> str:
    """A real-time factor for people."""
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}"


def _choice(
    experiment: Data, costs: Sequence[float | None], timing: Sequence[Data] | None, tolerance: float
) -> tuple[int | None, str]:
    """The cheapest adequate point, and what to say of it: where it is not MuJoCo's, of MuJoCo's cheapest too."""
    points, reaches = experiment["points"], bounds(experiment)
    alike = 1.0 if timing is None else ALIKE
    number = cheapest(costs, reaches, tolerance, alike)
    if number is None:
        return None, ""
    text = f"{label(points[number])}: {_cost(costs[number], None if timing is None else timing[number])}"
    if points[number]["engine"] == "mujoco":
        return number, text
    own = [cost if one["engine"] == "mujoco" else None for cost, one in zip(costs, points, strict=True)]
    other = cheapest(own, reaches, tolerance, alike)
    if other is None:
        return number, text
    return number, (
        f"{text}; in MuJoCo {label(points[other]).removeprefix('MuJoCo ')}: "
        f"{_cost(costs[other], None if timing is None else timing[other])}"
    )


def _cost(cost: float | None, timing: Data | None) -> str:
    if timing is not None:
        return f"{factor_text(timing['real_time_factor'])} x real time"
    return f"{cost:.0f} right-hand sides"


def _out_of_reach(experiment: Data, tolerance: float) -> str:
    own = experiment["reference"]["own_error"]
    if own is not None and own >= tolerance:
        return f"nobody can say here, the reference itself is known to {metres(own)}"
    known = [(bound, number) for number, bound in enumerate(bounds(experiment)) if bound is not None]
    if not known:
        reasons = list(dict.fromkeys(one["reason"] for one in experiment["points"] if one.get("reason")))
        return f"no setting completed ({reasons[0]})" if reasons else "no setting completed"
    bound, number = min(known)
    return f"no setting of this sweep; the best is {label(experiment['points'][number])} with {metres(bound)}"
