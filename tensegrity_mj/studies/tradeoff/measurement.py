"""One run of one setting, as a record: how it ended, how far it was off, and what it cost. Whatever fails is data."""

from __future__ import annotations

import enum
import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import ControllerError, DivergenceError, InfeasibleError, TensegrityError
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.runs.variables import VARIABLES
from tensegrity_mj.simulation import simulate_as_far
from tensegrity_mj.studies.tradeoff.experiments import Experiment

if TYPE_CHECKING:
    from tensegrity_mj.studies.tradeoff.settings import AnyEngine

SAME_TIME = 1e-9  # of the duration


class Ended(enum.Enum):
    """How a run ended."""

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
        run: all of it, what there is of it, or None.
    """

    ended: Ended
    reason: str
    run: Trajectory | None

    @property
    def motion(self) -> Motion | None:
        """Its nodes; None where it did not complete."""
        if self.run is None or self.ended is not Ended.COMPLETED:
            return None
        return Motion(self.run.time, self.run.nodes)


def attempt(experiment: Experiment, engine: AnyEngine, duration: float | None = None) -> Attempt:
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


def record(made: Attempt, engine: AnyEngine, reference: Motion | None) -> dict[str, Any]:
    """What is kept of an attempt: everything but `timing` is the same each time it is made.

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
