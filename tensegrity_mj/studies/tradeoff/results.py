"""What a study of cost comes to: its points with their fronts and advice, and sentences for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.studies.tradeoff import sentence
from tensegrity_mj.studies.tradeoff.experiments import Experiment
from tensegrity_mj.studies.tradeoff.front import pareto
from tensegrity_mj.studies.tradeoff.measurement import Ended
from tensegrity_mj.studies.tradeoff.reference import FLOOR_FACTOR, Reference
from tensegrity_mj.studies.tradeoff.settings import Setting

Data = dict[str, Any]


def sentences(data: Data) -> list[str]:
    """The sentences of all experiments of a study's data, by wall time, each headed by its experiment.

    After them what must be known to take their advice, headed so where it does not concern all experiments.
    """
    found = []
    noted: dict[str, list[str]] = {}
    for experiment, own in sentence.with_timing(data):
        if own["floor"] is not None:
            found.append(own["floor"])
        elif not own["advice"]:
            found.append(f"{experiment['title']}: {sentence.why_none(experiment)}")
            continue
        else:
            found += [f"{experiment['title']}: {one['text']}" for one in own["advice"]]
        for text in sentence.remarks(experiment, data["scene"].get("duration", experiment["duration"])):
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
    """What is the same each time, and what was measured with a clock."""
    points, clocked = [], []
    own = reference.own_error
    for setting, runs in zip(settings, records, strict=True):
        first: Data = runs[0] if runs else {"status": Ended.REFUSED.value, "reason": "no reference", "error": None}
        values = {key: value for key, value in first.items() if key != "timing"}
        known = first["error"] is not None
        # A second run of the same setting must be the same run: what it computed is compared bit by bit.
        repeatable = all({**one, "timing": None} == {**first, "timing": None} for one in runs)
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
            "advice": sentence.advice(facts, costs, timing),
            "floor": sentence.floor_sentence(facts, costs, timing),
        }

    facts["by_right_hand_sides"] = by([one.get("evaluations") for one in points])
    return facts, {"points": clocked, **by([one["wall_time"] for one in clocked], clocked)}


def _modelling_floor(experiment: Experiment, reference: Reference, continuous: Reference | None) -> Data | None:
    """How far the held experiment's own motion is from the continuous law's; None where nothing is held."""
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
