"""The study: points (structures) and for each the predicted and the measured limit of every engine."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.engine_names import NAMES, engine_of, simulates
from tensegrity_mj.studies.stability.cases import joined_scene, structure_of
from tensegrity_mj.studies.stability.measure import STEPS, measured_limit
from tensegrity_mj.vibration.stable_step import StableStep, stable_step

MOST = {"discrete": 300.0}  # of 2/ω: the largest step tried
USUAL_MOST = 100.0
DRAWN = {"random": "random taut structures", "joined": "random structures whose rods share nodes"}
AGREEMENT = 0.1  # of the measured limit
UNEXPLAINED = "not explained"  # how a cause begins where none is known
# Rods above which runs have fewer steps. A hundred still resolve the limit to 1 %: beyond it by ε a motion of 1e-11 of
# the size, which must pass 3e-9 to count, grows by exp(100 · 7 ε) in Runge-Kutta's runs and by more in the others'.
FEWER = ((100, 100), (30, 300))


def limits_at(point: Mapping[str, Any]) -> dict[str, Any]:
    """What `run_many` computes: a structure's limits, {engine: {...}} (see `at_rest`); none of the ODE if joined."""
    scene = joined_scene(point) if point["kind"] == "joined" else Scene(structure_of(point))
    found = {name: at_rest(scene, name) for name in point["engines"] if simulates(name, scene)}
    omega = next((one["omega"] for one in found.values()), None)
    counts = {"rods": len(scene.structure.rods), "strings": len(scene.structure.strings)}
    return {**counts, "omega": omega, "engines": found}


def steps_for(rods: int) -> int:
    """How many steps a measuring run of a structure has."""
    return next((steps for above, steps in FEWER if rods > above), STEPS)


def at_rest(scene: Scene, name: str) -> dict[str, Any]:
    """Predicted and measured limit of one engine for a scene that stands still; null is no limit up to `largest`.

    A limit beyond the scene's duration, as of what nothing holds, is no limit: steps are tried up to the duration.

    With rods that close loops the motion without a perturbation is simulated, too: MuJoCo's constraints settle first.
    """
    found, most = stable_step(scene, engine_of(name, 1.0), law=None), MOST.get(name, USUAL_MOST)
    measured = measured_limit(
        scene,
        lambda step: engine_of(name, step),
        found.omega if found.limit < scene.duration else 2 * most / scene.duration,
        equilibrium=not spanning_forest(scene.structure).closures,
        steps=steps_for(len(scene.structure.rods)),
        most=most,
    )
    ratio = _ratio(found.limit, measured.limit, measured.largest)
    agrees = ratio is not None and abs(ratio - 1) <= AGREEMENT
    return {
        "predicted": _finite(found.limit),
        "measured": _finite(measured.limit),
        "largest": measured.largest,
        "ratio": ratio,
        "agrees": agrees,
        "cause": "" if agrees else why(found, measured.reason),
        "runs": measured.runs,
        "failure": measured.reason,
        **plain_values(found, "omega", "rod", "rod_share", "string", "string_share"),
    }


def why(found: StableStep, reason: str) -> str:
    """Why the two differ."""
    for note in found.notes:
        if "edge of slackness" in note:
            return "strings at the edge of slackness: no linear model"
        if "pole" in note:
            return "a rod near the pole of the ODE's angles"
    if "singular" in reason:
        return "the ODE's angles end at a pole"
    if "slack" in " ".join(found.notes):
        return "strings that are slack at rest become taut"
    return f"{UNEXPLAINED} ({reason or 'nothing grew'})"


def summary(outcomes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Of all points and engines: how many agree, and the causes of the others."""
    rows = [one for values in outcomes for one in values["engines"].values()]
    # Where no step was too long, nothing was measured: such points agree, and have no difference.
    ratios = np.array([one["ratio"] for one in rows if one["ratio"] is not None and one["measured"] is not None])
    causes = Counter(one["cause"] for one in rows if not one["agrees"])
    structures = [all(one["agrees"] for one in values["engines"].values()) for values in outcomes]
    by_engine = {}
    for name in NAMES:
        own = [values["engines"][name] for values in outcomes if name in values["engines"]]
        known = [abs(one["ratio"] - 1) for one in own if one["ratio"] is not None and one["measured"] is not None]
        if own:
            by_engine[name] = {
                "count": len(own),
                "agree": sum(one["agrees"] for one in own),
                "largest_difference": max(known, default=None),
            }
    return {
        "comparisons": len(rows),
        "agree": sum(one["agrees"] for one in rows),
        "structures": len(structures),
        "structures_agree": sum(structures),
        "median_difference": float(np.median(np.abs(ratios - 1))) if len(ratios) else None,
        "engines": by_engine,
        "causes": dict(sorted(causes.items())),
        "allowed": AGREEMENT,
    }


def agreement(part: Mapping[str, Any]) -> str:
    """In words: how many comparisons and structures agree, of a part of the study with a `summary`."""
    total = part["summary"]
    middle = "-" if total["median_difference"] is None else f"{total['median_difference']:.2g}"
    return (
        f"{total['agree']} of {total['comparisons']} comparisons and {total['structures_agree']} of "
        f"{total['structures']} structures agree within {total['allowed']:.0%}; median difference {middle}"
    )


def _ratio(predicted: float, measured: float, largest: float) -> float | None:
    """Predicted over measured; 1 where both are beyond what was tried, null where one of them is nothing."""
    if math.isinf(measured):
        return 1.0 if predicted >= 0.9 * largest else predicted / largest
    if measured == 0 or math.isinf(predicted):
        return None
    return predicted / measured


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
