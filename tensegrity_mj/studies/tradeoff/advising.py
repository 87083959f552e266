"""Advice of a study of cost: its points with their fronts, what to use for an accuracy, and sentences to act on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.runs.judgement import in_short
from tensegrity_mj.studies.tradeoff.experiments import Experiment, Setting, power_text
from tensegrity_mj.studies.tradeoff.reference import FLOOR_FACTOR, Ended, Reference

DECADES = tuple(float(f"1e-{number}") for number in range(1, 13))  # m
Data = Mapping[str, Any]
ENOUGH = 0.1  # of a modelling floor: a smaller numerical error buys nothing
ALIKE = 1.25  # wall times that differ by less are the same to a clock
ADVICE = ("error at most", "fastest here", "fewest right-hand sides")


def pareto(costs: Sequence[float | None], errors: Sequence[float | None], floor: float = 0.0) -> list[int]:
    """Indices of the points that no other beats in cost and error alike, the cheapest first.

    Args:
        costs, errors: one a point; None, NaN and infinity are points without a result, which are never on the front.
        floor: errors below it count as equal to it: differences there say nothing.
    """
    known = [
        (cost, max(error, floor), number)
        for number, (cost, error) in enumerate(zip(costs, errors, strict=True))
        if cost is not None and error is not None and math.isfinite(cost) and math.isfinite(error)
    ]
    front: list[int] = []
    best = math.inf
    for _, error, number in sorted(known):
        if error < best:
            front.append(number)
            best = error
    return front


def cheapest(
    costs: Sequence[float | None], bounds: Sequence[float | None], tolerance: float, alike: float = 1.0
) -> int | None:
    """Index of the cheapest point whose error is at most the tolerance; None where there is none.

    Args:
        alike: costs up to so many times the least count as the least; of those points the first is taken.
    """
    adequate = [
        (cost, number)
        for number, (cost, bound) in enumerate(zip(costs, bounds, strict=True))
        if cost is not None and bound is not None and math.isfinite(cost) and bound <= tolerance
    ]
    if not adequate:
        return None
    least = min(adequate)[0]
    return min(number for cost, number in adequate if cost <= alike * least)


def decades(motion: float, bounds: Sequence[float | None]) -> list[float]:
    """Accuracies 1e-1, 1e-2, ... [m] below the size of the motion, down to the first that no point has."""
    known = [bound for bound in bounds if bound is not None and math.isfinite(bound)]
    best = min(known, default=math.inf)
    below = [tolerance for tolerance in DECADES if tolerance < motion]
    return below[: sum(best <= tolerance for tolerance in below) + 1]


def label(point: Data) -> str:
    return f"{point['family']}, {point['knob']}"


def with_timing(data: Data) -> list[tuple[Data, Data]]:
    """The experiments of a study's data, each with what a clock measured of it."""
    return [(one, data["timing"]["experiments"][one["key"]]) for one in data["experiments"]]


def bounds(experiment: Data) -> list[float | None]:
    """Return for each point its error plus the reference's own [m]; None where it has none."""
    own = experiment["reference"]["own_error"]
    return [None if own is None or one["error"] is None else one["error"] + own for one in experiment["points"]]


def advice(experiment: Data, costs: Sequence[float | None], timing: Sequence[Data] | None = None) -> list[Data]:
    """Return for each decade of accuracy the cheapest adequate point and a sentence on it.

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
    """Return rows of what to use for which accuracy, by wall time and by right-hand sides, under the heads `ADVICE`."""
    pairs = zip(timing["advice"], experiment["by_right_hand_sides"]["advice"], strict=True)
    return [(metres(one["tolerance"]), advice_alone(one), advice_alone(other)) for one, other in pairs]


def floor_sentence(experiment: Data, costs: Sequence[float | None], timing: Sequence[Data] | None = None) -> str | None:
    """Say how holding changes the motion, and what is fine enough for it; None where nothing is held."""
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
    """Return what one must know to take the advice of an experiment, `whole` [s] being the scene's own duration."""
    found, duration = [], experiment["duration"]
    if experiment["note"]:
        found.append(experiment["note"])
    if doubts := experiment["reference"].get("doubts"):
        found.append(f"The reference is in doubt, and all errors with it: {in_short(doubts)}.")
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
    """Say why there is no advice: no reference, or a motion that is too small for any accuracy to be chosen."""
    if experiment["reference"]["engine"] is None:
        return reference_sentence(experiment)
    return (
        f"no node moves by more than {metres(experiment['reference']['motion'])} in {experiment['duration']:g} s, so "
        "that there is no accuracy to choose a setting for: run longer, or start where something moves"
    )


def reference_sentence(experiment: Data) -> str:
    """Say against what the errors are measured, and how far off that may be."""
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
    if value is None:
        return "–"
    return "0 m" if value == 0 else f"{power_text(float(f'{value:.1e}'))} m" if value < 1e-3 else f"{value:.2g} m"


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
        factor = timing["real_time_factor"]
        return f"{factor:.0f} x real time" if factor >= 100 else f"{factor:.2g} x real time"
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


def sentences(data: Data) -> list[str]:
    """The sentences of all experiments of a study's data, by wall time, each headed by its experiment.

    After them what must be known to take their advice, headed so where it does not concern all experiments.
    """
    found = []
    noted: dict[str, list[str]] = {}
    for experiment, own in with_timing(data):
        if own["floor"] is not None:
            found.append(own["floor"])
        elif not own["advice"]:
            found.append(f"{experiment['title']}: {why_none(experiment)}")
            continue
        else:
            found += [f"{experiment['title']}: {one['text']}" for one in own["advice"]]
        for text in remarks(experiment, data["scene"].get("duration", experiment["duration"])):
            noted.setdefault(text, []).append(experiment["title"])
    for text, titles in noted.items():
        found.append(text if len(titles) == len(data["experiments"]) else f"{'; '.join(titles)}: {text}")
    return found


def result_of(
    experiment: Experiment,
    reference: Reference,
    continuous: Reference | None,
    settings: Sequence[Setting],
    records: Sequence[Sequence[Data]],
) -> tuple[Data, Data]:
    """Return the values that are the same each time, and those that were measured with a clock."""
    points, clocked = [], []
    own = reference.own_error
    for setting, runs in zip(settings, records, strict=True):
        first: Data = runs[0] if runs else {"status": Ended.REFUSED.value, "reason": "no reference", "error": None}
        values = {key: value for key, value in first.items() if key != "timing"}
        # A second run of the same setting must be the same run: what it computed is compared bit by bit.
        repeatable = all({**one, "timing": None} == {**first, "timing": None} for one in runs)
        if str(setting.engine) == reference.facts["engine"]:  # a run is not compared with itself
            first = values = {**values, "error": None, "final_error": None, "reason": "it is the reference itself"}
        known = first["error"] is not None
        at_floor = bool(known and first["error"] <= FLOOR_FACTOR * own)
        points.append({**setting.to_dict(), **values, "at_reference_floor": at_floor, "repeatable": repeatable})
        walls = [one["timing"]["wall_time"] for one in runs if one["timing"]["wall_time"] is not None]
        wall = min(walls, default=None)
        factor = experiment.duration / wall if wall and known else None
        clocked.append({"wall_time": wall, "repeats": len(walls), "real_time_factor": factor})
    facts = {
        **experiment.to_dict(),
        "reference": {key: value for key, value in reference.facts.items() if key != "fastest"},
        "modelling_floor": _modelling_floor(experiment, reference, continuous),
        "points": points,
    }
    errors = [one["error"] for one in points]
    floor = own if math.isfinite(own) else 0.0

    def by(costs: Sequence[float | None], timing: Sequence[Data] | None = None) -> Data:
        return {
            "front": pareto(costs, errors, floor),
            "advice": advice(facts, costs, timing),
            "floor": floor_sentence(facts, costs, timing),
        }

    facts["by_right_hand_sides"] = by([one.get("evaluations") for one in points])
    return facts, {"points": clocked, **by([one["wall_time"] for one in clocked], clocked)}


def _modelling_floor(experiment: Experiment, reference: Reference, continuous: Reference | None) -> Data | None:
    """Return how far the held experiment's own motion is from the continuous law's; None where nothing is held."""
    if experiment.actuation.mode is Mode.CONTINUOUS:
        return None
    unknown = {"distance": None, "final_distance": None, "resolved": None}
    if continuous is None and reference.motion is not None:
        return {**unknown, "reason": "the continuous law was not requested"}
    if continuous is None or reference.motion is None or continuous.motion is None:
        missing = continuous if reference.motion is not None and continuous is not None else reference
        return {**unknown, "reason": str(missing.facts["reason"])}
    distance = reference.motion.distance(continuous.motion)
    return {
        "distance": float(distance.max()),
        "final_distance": float(distance[-1]),
        "resolved": reference.own_error + continuous.own_error,
        "reason": "",
    }
