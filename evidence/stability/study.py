"""The study: points (structures) and for each the predicted and the measured limit of every engine.

A limit is measured by small perturbations, which grow or do not. A run of `STEPS` steps starts with random velocities
that move nothing by more than 1e-11 of the structure's size in a step. It is stable where the largest distance of a
node from the unperturbed motion, in the last quarter of the run, is at most `GROWTH` times that in the first, never
more than 100 times what the velocities alone would make of it, and where no string's tension changes by half in its
spring or by a tenth in its damper: beyond, slack strings would stop the growth, and in Runge-Kutta's stages dampers
pull four times harder than between steps. What round-off of the forces at rest moves in that time is no growth. A run
that ends in a DivergenceError is not stable. That resolves the limit to 0.1 %: beyond it by ε, semi-implicit Euler
multiplies by 1 + √(8 ε) a step and Runge-Kutta by 1 + 7 ε; right at the limit and for motions that nothing holds,
distances grow with time and no faster: by 4 from the first quarter to the last.

Steps are doubled until one is not stable, the bracket is halved by bisection, and steps at 0.6 and 0.85 of the result
are looked at again: were one of them not stable, the search would go on below it.
"""

from __future__ import annotations

import math
import os
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evidence.random_linked import random_velocities
from evidence.stability.cases import (
    AXES,
    joined_points,
    joined_scene,
    map_points,
    random_points,
    scene_at_rest,
    structure_of,
)
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import whole
from tensegrity_mj.basics.fields import function_of
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.controllers.scenes import SCENE_LAW
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.request import Request
from tensegrity_mj.engines.table import NAMES, engine_of, simulates
from tensegrity_mj.errors import DivergenceError, OptionError, TensegrityError
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.moved_supports import velocities_with_supports
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.studies.many import run_study
from tensegrity_mj.studies.stable_steps import at_start, continuous_law
from tensegrity_mj.studies.workers import Workers
from tensegrity_mj.vibration.bodies import Bodies
from tensegrity_mj.vibration.stable_step import StableStep, stable_step
from tensegrity_mj.vibration.state import State, forces_on_nodes, forces_round_off

STEPS = 1000
GROWTH = 10.0
AMPLITUDE = 1e-11  # of the structure's size, moved in a step; less where strings are stretched by little
STRETCH_PART = 1e-4  # of the smallest stretch that is at least moved in a step
DAMPER_PART = 1e-2  # of its tension that a string's damper pulls with at first, at most
# Changes of a string's spring and damper, as parts of its tension, that are no longer small.
SPRING_SLACK, DAMPER_SLACK = 0.5, 0.1
FAR = 100.0  # times what the random velocities make in all the steps: no linear motion goes there
LEAST = 1e-13  # of its size: the smallest motion a step
FLOOR = 3e-10  # of its size: distances of round-off, and of the solver of `discrete`
SAMPLES = 200  # of a run
FIRST = 0.02  # of 2/ω: where the search begins
PRECISION = 0.005  # of the limit
LOOK_AGAIN = (0.6, 0.85)
SEED = 0  # of the perturbations


@dataclass(frozen=True)
class MeasuredLimit:
    """Largest stable step that was measured, and how.

    Attributes:
        limit: [s] the largest step that was stable; 0 where none was; ∞ where all were up to `largest`.
        largest: [s] the largest step that was tried.
        runs: how many.
        reason: how the first step beyond the limit failed, or why nothing could be measured.
    """

    limit: float
    largest: float
    runs: int
    reason: str


def measured_limit(
    scene: Scene,
    engine_of: Callable[[float], Any],
    omega: float,
    *,
    equilibrium: bool = True,
    steps: int = STEPS,
    most: float = 100.0,
) -> MeasuredLimit:
    """The largest stable step, by doubling and bisection.

    Args:
        scene: its start is what is perturbed.
        engine_of: an engine for a step [s].
        omega: [1/s] sets where the search begins (0.02 of 2/ω) and ends; no more than an order of magnitude.
        equilibrium: whether the unperturbed motion is rest; else it is simulated too.
        steps: of each run.
        most: of 2/ω: the largest step that is tried.
    """
    unit = 2 / omega
    runs = 0
    reason = ""

    def stable(step: float) -> bool:
        nonlocal runs, reason
        runs += 1
        found = _why_unstable(scene, engine_of(step), equilibrium, steps)
        if found:
            reason = found
        return not found

    low, high = 0.0, FIRST * unit
    while stable(high):
        low = high
        if high >= most * unit:
            return MeasuredLimit(math.inf, high, runs, "")
        high = min(2 * high, most * unit)
    largest = high
    while True:
        while high - low > PRECISION * high:
            middle = 0.5 * (low + high) if low > 0 else 0.5 * high
            low, high = (middle, high) if stable(middle) else (low, middle)
            if low == 0.0 and high < 1e-3 * FIRST * unit:
                return MeasuredLimit(0.0, largest, runs, reason)
        worse = [part * low for part in LOOK_AGAIN if not stable(part * low)]
        if not worse:
            return MeasuredLimit(low, largest, runs, reason)
        low, high = 0.0, worse[0]


def _why_unstable(scene: Scene, engine: Any, equilibrium: bool, steps: int) -> str:
    """Return how a perturbation grows at the engine's step, or "" where it does not."""
    step = engine.timestep
    size = float(np.ptp(scene.nodes0, axis=0).max(initial=0.0)) or 1.0
    structure = scene.structure
    lengths = structure.string_lengths(scene.nodes0)
    stretch = lengths - structure.rest_lengths
    tight = stretch > 1e-11 * lengths  # below, the perturbation itself would make it slack
    pulls = structure.curves.tension(stretch)
    amplitude = AMPLITUDE
    if tight.any():
        elastic = pulls[tight]
        with np.errstate(divide="ignore"):
            moved = DAMPER_PART * elastic / (2 * structure.damping[tight]) * step  # both ends move; ∞ without a damper
        small = min(STRETCH_PART * stretch[tight].min(), moved.min()) / size
        amplitude = float(np.clip(small, LEAST, AMPLITUDE))
    push = random_velocities(np.random.default_rng(SEED), structure, scene.nodes0, amplitude * size / step)
    if structure.class_number > 1:
        push = velocities_with_supports(structure, scene.nodes0, (), push)
    try:
        run = _run(scene.with_(initial_velocities=scene.velocities0 + push), engine, steps)
        calm = None if equilibrium else _run(scene, engine, steps)
    except DivergenceError as error:
        return f"diverged by {error.time / step:.0f} steps"
    except TensegrityError as error:
        return f"{type(error).__name__}: {error}"
    if run.status is not Status.COMPLETED or (calm is not None and calm.status is not Status.COMPLETED):
        return f"the run ended as {run.status.value}: {run.message}"
    origin = scene.nodes0 if calm is None else calm.nodes
    distance = np.linalg.norm(run.nodes - origin, axis=2).max(axis=1)
    quarter = max(1, len(distance) // 4)
    first, last = float(distance[: quarter + 1].max()), float(distance[-quarter:].max())
    largest = float(distance.max())
    drift = _drift(scene, pulls, steps * step)
    if largest > FAR * amplitude * steps * size + drift:
        return f"grew to {largest:.3g} m within {steps} steps"
    if equilibrium:
        spring = structure.stiffness * np.abs(structure.string_lengths(run.nodes) - lengths)
        damper = structure.damping * np.abs(structure.string_rates(run.nodes, run.velocities))
        change = np.maximum(spring / SPRING_SLACK, damper / DAMPER_SLACK).max(axis=0)
        if np.any((change > pulls)[tight]):
            return f"grew until strings slackened within {steps} steps"
    if last <= GROWTH * max(first, FLOOR * size) + drift:
        return ""
    if equilibrium:
        # Slow growth may be that of the round-off in the equilibrium's own forces: the unperturbed run shows it.
        return _why_unstable(scene, engine, False, steps)
    return f"grew {last / max(first, FLOOR * size):.3g} times from the first quarter of {steps} steps to the last"


def _drift(scene: Scene, tensions: Array, duration: float) -> float:
    """[m] how far the round-off of forces that cancel may move what nothing holds; the end of a rod has ¼ of its mass.

    Two runs may round otherwise, so that a run without a perturbation does not take it out.
    """
    structure = scene.structure
    state = State(scene, Bodies.of(structure), scene.nodes0, np.zeros_like(scene.nodes0), 0.0)
    _, sizes = forces_on_nodes(state, state.segments.directions * tensions[structure.paths.strings, None])
    return float(0.5 * duration**2 * np.max(4 * forces_round_off(state, sizes) / state.bodies.mass))


def _run(scene: Scene, engine: Any, steps: int) -> Trajectory:
    law, actuation, step = native_law(None, scene.structure), Actuation.continuous(), engine.timestep
    interval = max(1, steps // SAMPLES) * step
    request = Request(scene, law, actuation, OnInfeasible.STOP, steps * step, interval, False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # what MuJoCo says of runs that are meant to go wrong
        return engine.run(request)


MOST = {"discrete": 300.0}  # of 2/ω: the largest step tried
USUAL_MOST = 100.0
DRAWN = {"random": "random taut structures", "joined": "random structures whose rods share nodes"}
AGREEMENT = 0.1  # of the measured limit
UNEXPLAINED = "not explained"  # how a cause begins where none is known
# Rods above which runs have fewer steps. A hundred still resolve the limit to 1 %: beyond it by ε a motion of 1e-11 of
# the size, which must pass 3e-9 to count, grows by exp(100 · 7 ε) in Runge-Kutta's runs and by more in the others'.
FEWER = ((100, 100), (30, 300))


def limits_at(point: Mapping[str, Any]) -> dict[str, Any]:
    """Compute a structure's limits for `run_many`, {engine: {...}} (see `at_rest`); none of the ODE if joined."""
    scene = joined_scene(point) if point["kind"] == "joined" else Scene(structure_of(point))
    found = {name: at_rest(scene, name) for name in point["engines"] if simulates(name, scene)}
    omega = next((one["omega"] for one in found.values()), None)
    counts = {"rods": len(scene.structure.rods), "strings": len(scene.structure.strings)}
    return {**counts, "omega": omega, "engines": found}


def steps_for(rods: int) -> int:
    """Return the number of steps of a structure's measuring run."""
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
    """Return the reason for which the predicted and the measured limit differ."""
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
    """Count over all points and engines how many agree, and the causes of the others."""
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
    """Say how many comparisons and structures agree, of a part of the study with a `summary`."""
    total = part["summary"]
    middle = "-" if total["median_difference"] is None else f"{total['median_difference']:.2g}"
    return (
        f"{total['agree']} of {total['comparisons']} comparisons and {total['structures_agree']} of "
        f"{total['structures']} structures agree within {100 * total['allowed']:.0f} %; median difference {middle}"
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


MOST_RODS = 500
QUICK_RODS = 20
FINE = 0.1  # of the stable step and of contact's time: the step of the run that a scene with contact is looked along
RANDOM_RODS, QUICK_RANDOM_RODS = 30, 4
JOINED_RODS, QUICK_JOINED_RODS = 12, 4
JOINED_PART = 3  # for so many random taut structures one whose rods share nodes
MAPPED = ("euler", "implicit", "discrete", "rk4")  # engines of the maps: the others have the limits of one of these


@dataclass(frozen=True, eq=False)
class StabilityStudy:
    """Predicted and measured limits of a scene's structure, of its variations, and of random structures.

    Attributes:
        scene: its start and, with a law, a run are looked at; its structure, prestressed and at rest, is measured.
        law: closes the loop in the part about the scene's own motion; the scene's own by default, where it can be
            evaluated at every stage; None for none.
        engines: names from `engines.table.NAMES`.
        maps: axes of `cases.AXES`.
        quick: few values of each axis, maps of at most 20 rods, and random structures of at most 4.
        random: how many random taut structures; a third as many trees and loops of rods come on top.
        seed: of them.
        folder: where finished points are kept, so that an interrupted study goes on; None keeps them in memory.
        workers: who computes points; all cores by default. Results do not depend on it.
        progress: show bars on stderr.

    Raises:
        OptionError: for unknown names, and maps of a structure whose rods share nodes, or without strings.
    """

    scene: Scene
    _: KW_ONLY
    law: Any = SCENE_LAW
    engines: Sequence[str] = NAMES
    maps: Sequence[str] = ()
    quick: bool = False
    random: int = 0
    seed: int = 0
    folder: str | os.PathLike[str] | None = None
    workers: Workers | None = None
    progress: bool = False

    def __call__(self) -> dict[str, Any]:
        scene, engines = self.scene, list(self.engines)
        whole("seed", self.seed, 0)
        unknown = [name for name in engines if name not in NAMES] + [axis for axis in self.maps if axis not in AXES]
        if unknown or not engines:
            raise OptionError(f"stability: '{unknown[0] if unknown else ''}' is none of {', '.join((*NAMES, *AXES))}")
        linked = scene.structure.class_number > 1
        if self.maps and (linked or not scene.structure.strings):
            raise OptionError(
                f"stability: maps vary the strings of structures of class 1; scene '{scene.name}' has "
                f"{'rods that share nodes' if linked else 'no strings'}: leave the maps out"
            )
        measured = [name for name in engines if simulates(name, scene)]
        base, text = scene_at_rest(scene, bool(self.maps))
        data: dict[str, Any] = {
            "scene": scene.name,
            "engines": engines,
            "start": at_start(scene, continuous_law(scene, self.law), engines),
            "base": {
                "text": text,
                "stand_in": base.structure.node_names != scene.structure.node_names,
                "engines": {name: at_rest(base, name) for name in measured},
            },
        }
        if self.maps:
            points = map_points(base.structure, tuple(self.maps), self.quick, QUICK_RODS if self.quick else MOST_RODS)
            rows = self._limits("maps", "maps", points, [name for name in engines if name in MAPPED] or engines)
            keys = ("axis", "value", "values", "reason")
            data["maps"] = [{key: (row["point"] | row)[key] for key in keys} for row in rows]
        if self.random:
            most = QUICK_RANDOM_RODS if self.quick else RANDOM_RODS
            joined = QUICK_JOINED_RODS if self.quick else JOINED_RODS
            data["random"] = self._drawn("random", random_points(self.random, self.seed, most))
            count = math.ceil(self.random / JOINED_PART)
            data["joined"] = self._drawn("joined", joined_points(count, self.seed, joined))
        return data

    def _drawn(self, name: str, points: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """The limits of structures that were drawn at random."""
        rows = self._limits(name, f"{name} structures", points, list(self.engines))
        kept = [row["values"] for row in rows if row["values"] is not None]
        return {"seed": self.seed, "rows": rows, "failed": len(rows) - len(kept), "summary": summary(kept)}

    def _limits(
        self, name: str, label: str, points: Sequence[dict[str, Any]], engines: list[str]
    ) -> list[dict[str, Any]]:
        tasks = [point | {"engines": engines} for point in points]
        place = None if self.folder is None else Path(self.folder) / name
        found = run_study(limits_at, tasks, place, label, {"workers": self.workers, "progress": self.progress})
        return [
            {"point": point, "values": outcome.get("values"), "reason": outcome.get("reason")}
            for point, outcome in zip(points, found.outcomes, strict=True)
        ]


study_stability = function_of(StabilityStudy)
