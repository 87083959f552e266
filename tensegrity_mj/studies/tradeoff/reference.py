"""The reference of an experiment, and how wrong it may be itself.

The reference is the DAE at the tightest tolerance that the budget has. Its own error is the larger of two differences:
from the DAE at ten times that tolerance, and from a second formulation: the ODE or, where rods share nodes, the DAE's
full equations with all multipliers; where neither can, as with contact, MuJoCo's RK4 from the DAE's at the same fine
step, for both err by it alike. Where error control needs too many steps, the DAE's RK4 at two fine steps takes its
place; where the DAE refuses the scene, as with a terrain, MuJoCo's RK4 at two fine steps, and then there is no second
formulation.
"""

from __future__ import annotations

import enum
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import ControllerError, DivergenceError, InfeasibleError, TensegrityError
from tensegrity_mj.runs import convergence, judgement
from tensegrity_mj.runs.recorded import VARIABLES
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import simulate_as_far
from tensegrity_mj.studies.tradeoff.experiments import DOP853_STAGES, Experiment, grid_of_steps, most_evaluations, stays

SAME_TIME = 1e-9  # of the duration


class Ended(enum.Enum):
    """Ways in which a run ended."""

    COMPLETED = "completed"
    DIVERGED = "diverged"  # unstable
    BUDGET = "over budget"  # it needed more steps than it may have
    INFEASIBLE = "infeasible"
    SINGULAR = "singular"
    REFUSED = "refused"  # the engine cannot do this
    FAILED = "failed"  # the law raised an error


FAILURES = {DivergenceError: Ended.DIVERGED, InfeasibleError: Ended.INFEASIBLE, ControllerError: Ended.FAILED}


@dataclass(frozen=True, eq=False)
class Motion:
    """Node positions (T, N, 3) [m] at times (T,) [s]."""

    time: Array
    nodes: Array

    def distance(self, other: Motion) -> Array:
        """(T,) [m]: the largest distance of a node from the same node of another motion at the same times.

        All of it is infinite where the times or the nodes are not the same, or where positions are not finite.
        """
        if self.nodes.shape != other.nodes.shape or not np.allclose(
            self.time, other.time, rtol=0.0, atol=SAME_TIME * max(1.0, float(other.time[-1]))
        ):
            return np.full(max(1, len(other.time)), math.inf)
        with np.errstate(invalid="ignore", over="ignore"):
            distance = np.linalg.norm(self.nodes - other.nodes, axis=-1).max(axis=1)
        return np.where(np.isfinite(distance), distance, math.inf)


@dataclass(frozen=True)
class Attempt:
    """A run that was tried.

    Attributes:
        ended, reason: how, and why where it did not complete.
        run: all of it, the part that was computed, or None.
    """

    ended: Ended
    reason: str
    run: Trajectory | None

    @property
    def motion(self) -> Motion | None:
        """Motion of the run's nodes; None where it did not complete."""
        if self.run is None or self.ended is not Ended.COMPLETED:
            return None
        return Motion(self.run.time, self.run.nodes)


def attempt(experiment: Experiment, engine: Any, duration: float | None = None) -> Attempt:
    """Simulate an experiment in an engine; for the experiment's duration unless another is given [s]."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # steps past the limit are part of a sweep
            run = simulate_as_far(
                experiment.scene,
                experiment.law,
                engine,
                duration=experiment.duration if duration is None else duration,
                actuation=experiment.actuation,
                output_interval=experiment.interval,
            )
    except TensegrityError as error:
        ended = next((end for kind, end in FAILURES.items() if isinstance(error, kind)), Ended.REFUSED)
        return Attempt(ended, str(error), None)
    most = getattr(engine, "max_steps", None)
    if run.status is Status.DIVERGED and most is not None and run.cost.get("steps", 0) >= most:
        return Attempt(Ended.BUDGET, run.message, run)
    return Attempt(Ended(run.status.value), run.message, run)


def record(made: Attempt, engine: Any, reference: Motion | None) -> dict[str, Any]:
    """Return the record of an attempt: everything but `timing` is the same each time it is made.

    error, final_error [m]: of the nodes against the reference, over the run and at its end; None where it did not
    complete or there is no reference. steps, evaluations, memory [bytes]: of what was run.
    """
    run, motion = made.run, made.motion
    values: dict[str, Any] = {"status": made.ended.value, "reason": made.reason, "error": None, "final_error": None}
    values |= {"steps": None, "evaluations": None, "memory": None, "simulated": None}
    timing: dict[str, Any] = {"wall_time": None}
    if run is not None:
        values |= {
            "steps": int(run.cost["steps"]),
            "evaluations": int(run.cost["evaluations"]),
            "simulated": float(run.time[-1]) if len(run.time) else 0.0,
        }
        timing["wall_time"] = float(run.cost["wall_time"])
    if motion is not None and run is not None:
        # Counted, as peaks depend on the allocator and on what ran before: what is recorded, and what the engine holds.
        recorded = sum(int(getattr(run, name).nbytes) for name in VARIABLES)
        values["memory"] = recorded + engine.working_bytes(run.scene)
        if reference is not None:
            distance = motion.distance(reference)
            values |= {"error": float(distance.max()), "final_error": float(distance[-1])}
    return {**values, "timing": timing}


GENEROUS = 5  # times the budget of a run of the sweep
MOST_FULL = 100  # rods; the full equations take time with the third power
HELD = 13  # times as much again where the law is sampled, which then costs nothing at most right-hand sides
RTOL, TIGHTER, LOOSER = 1e-12, 1e-13, (1e-11, 1e-10, 1e-9)
ATOL_OF_RTOL = 0.1  # positions are of the order of metres: below, round-off decides
SAME_STEP = " (beside the DAE's RK4 at that step)"
SURE = 1e-2  # of the motion: a reference known no better is none to measure against, where a shorter run has one
FLOOR_FACTOR = 3.0  # errors within so many times the reference's own cannot be distinguished from it


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference solution of an experiment, against which errors are measured.

    Attributes:
        motion: of the nodes; None where there is no reference.
        facts: plain values: engines, differences, own_error [m], the way to it, and the state with most kinetic energy.
    """

    motion: Motion | None
    facts: dict[str, Any]

    @property
    def stays(self) -> bool:
        """True where nothing moves in the reference."""
        return self.motion is not None and stays(self.motion.nodes)

    @property
    def own_error(self) -> float:
        """Bound of the reference's own error [m]; infinite where there is none."""
        value = self.facts["own_error"]
        return float("inf") if value is None else float(value)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, and arrays of the motion, of which `from_dict` makes it again."""
        return {"facts": self.facts, "motion": None if self.motion is None else vars(self.motion)}

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Reference:
        """Make a reference from what `to_dict` returned."""
        motion = None if found["motion"] is None else Motion(**{k: np.array(v) for k, v in found["motion"].items()})
        return cls(motion, found["facts"])


def find_reference(experiment: Experiment, budget: float) -> Reference:
    """Compute the reference of an experiment within `GENEROUS` budgets."""
    tried: list[dict[str, str]] = []

    def noted(engine: Any) -> Attempt:
        made = attempt(experiment, engine)
        tried.append({"engine": str(engine), "status": made.ended.value, "reason": made.reason})
        return made

    most = GENEROUS * most_evaluations(experiment.scene, experiment.native, budget)
    period = experiment.actuation.period
    if period is not None and experiment.duration / period > most:
        reason = f"{experiment.duration / period:.0f} samples of the law are beyond the budget of {most:.0f}"
        return Reference(None, _facts(tried, reason))
    stages = most * (HELD if period is not None else 1)
    for pair, second in _candidates(experiment, stages):
        found = _two(pair, noted)
        if len(found) == 2:
            (tight, made), (loose, other) = found
            assert made.motion is not None
            assert other.motion is not None
            apart = float(made.motion.distance(other.motion).max())
            differences = {"looser": {"engine": str(loose), "difference": apart}}
            for engine, beside in second(tight):
                also = noted(engine)
                own = made if beside is None or also.motion is None else noted(beside)
                if also.motion is not None and own.motion is not None:
                    name = f"{engine}{'' if beside is None else SAME_STEP}"
                    apart = float(own.motion.distance(also.motion).max())
                    differences["second_formulation"] = {"engine": name, "difference": apart}
                    break
            return Reference(made.motion, _facts(tried, "", str(tight), made, **differences))
    reasons = dict.fromkeys(one["reason"] for one in tried)
    return Reference(None, _facts(tried, "; ".join(reasons) or "no engine can be a reference"))


def _candidates(experiment: Experiment, most: float) -> Iterator[tuple[list[Any], Any]]:
    """Engines of which two that complete make a reference, in order, and what gives second formulations of the first:
    engines, each with what it is compared with where that is not the reference itself.
    """
    from tensegrity_mj.engines.mujoco.settings import MuJoCo
    from tensegrity_mj.engines.reference.dae import DAE, Solver
    from tensegrity_mj.engines.reference.method import Method
    from tensegrity_mj.engines.reference.ode import ODE

    steps = max(1, int(most / DOP853_STAGES))
    period, total = experiment.actuation.period, experiment.duration
    grid = grid_of_steps(experiment.interval, period, most / 4, total)[::-1]
    coarser = grid_of_steps(experiment.interval, period, most / GENEROUS / 4, total)[-1:]

    structure = experiment.scene.structure

    def at_step(step: float) -> Any:
        return DAE(method=Method.RK4, timestep=step)

    def formulations(tight: Any) -> Iterator[tuple[Any, Any]]:
        same = {"rtol": tight.rtol, "atol": tight.atol, "max_steps": steps}
        if structure.class_number <= 1:
            yield ODE(**same), None
        elif len(structure.rods) <= MOST_FULL:
            yield DAE(**same, solver=Solver.FULL), None
        for step in coarser:
            yield MuJoCo(step), at_step(step)

    def tolerance(rtol: float) -> Any:
        return DAE(rtol=rtol, atol=ATOL_OF_RTOL * rtol, max_steps=steps)

    yield [tolerance(rtol) for rtol in (RTOL, TIGHTER, *LOOSER)], formulations
    yield (
        [at_step(step) for step in grid[:2]],
        lambda tight: [(MuJoCo(tight.timestep), None)],
    )
    yield [MuJoCo(step) for step in grid[:2]], lambda tight: []


def _two(engines: list[Any], run: Callable[[Any], Attempt]) -> list[tuple[Any, Attempt]]:
    """The tightest two engines that complete, the tighter first; fewer where there are no two."""
    done: list[tuple[Any, Attempt]] = []
    for engine in engines:
        if len(done) == 2:
            break
        if getattr(engine, "rtol", None) == TIGHTER and not done:
            continue
        made = run(engine)
        if made.motion is not None:
            done.append((engine, made))
        elif made.ended not in (Ended.BUDGET, Ended.DIVERGED):
            break
    tightness = [getattr(one, "timestep", None) or getattr(one, "rtol", None) or math.nan for one, _ in done]
    order = np.argsort(tightness, kind="stable")
    return [done[number] for number in order]


def _facts(
    tried: list[dict[str, str]], reason: str = "", engine: str | None = None, made: Attempt | None = None, **apart: Any
) -> dict[str, Any]:
    """The facts of a reference, with its differences from others (`apart`), or the reason why there is none."""
    run = None if made is None else made.run
    fastest = touches = None
    if run is not None:
        if "contact" in run.reports:
            touches = sum(count > 0 for count in run.reports["contact"]["touching"])
        at = int(np.argmax(run.kinetic_energy))
        fastest = {"time": float(run.time[at]), "nodes": run.nodes[at], "velocities": run.velocities[at]}
    return {
        "engine": engine,
        "own_error": max((one["difference"] for one in apart.values()), default=None),
        "looser": apart.get("looser"),
        "second_formulation": apart.get("second_formulation"),
        "motion": None if run is None else convergence.way_of(run.nodes),
        # At how many of the recorded times; None for a scene without contact.
        "touches": touches,
        "reason": reason,
        "doubts": [] if run is None else judgement.doubts(run),
        "tried": tried,
        "fastest": fastest,
    }
