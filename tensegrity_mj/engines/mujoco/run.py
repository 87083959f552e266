"""One run of the MuJoCo engine: the model stepped with the law inside its control callback."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import warn_caller
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.resolution import DISCRETE, SEMI_IMPLICIT, STAGES
from tensegrity_mj.engines import continuing, driving, requirements
from tensegrity_mj.engines.mujoco import answers, contact, install, joints, motion, prepared, run_view
from tensegrity_mj.engines.mujoco.install import finish
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.engines.recording import Account, RodMotion, allocate_rows, make_trajectory
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import DivergenceError, TensegrityError
from tensegrity_mj.model.elements.elastic_rods import carried
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.energy import BEYOND, blame_divergence, check_energy
from tensegrity_mj.runs.trajectory import Status, Trajectory

# MuJoCo's warnings about states that are no longer physical; it only warns, so we stop.
_WARNINGS = {
    "a bad position": int(mujoco.mjtWarning.mjWARN_BADQPOS),
    "a bad velocity": int(mujoco.mjtWarning.mjWARN_BADQVEL),
    "a bad acceleration": int(mujoco.mjtWarning.mjWARN_BADQACC),
    "a bad control": int(mujoco.mjtWarning.mjWARN_BADCTRL),
}


# Rules of `native.resolution`.
KINDS = {"rk4": STAGES, "discrete": DISCRETE}


def causes_of(counts: Any, finite: bool, made: int, steps: int) -> list[str]:
    """Causes of a divergence: counted warnings of MuJoCo, a state that is not finite, lost steps."""
    causes = [f"MuJoCo warned of {name}" for name, number in _WARNINGS.items() if counts[number]]
    causes += [] if finite else ["the state is no longer finite"]
    return causes + ([] if made == steps else [f"{made} steps were made, not {steps}"])


class MuJoCoRun:
    """One run: model, data, plant, and what is made of the recorded rows.

    A run that is one of many (`many`) shares the model, and the data that it is set up with: `ready`, and `start`, the
    scene that it was made from, if another.
    """

    def __init__(
        self,
        options: MuJoCo,
        request: Request,
        ready: prepared.Prepared | None = None,
        start: Scene | None = None,
    ) -> None:
        self.options, self.request = options, request
        scene, structure = request.scene, request.scene.structure
        requirements.require(options, scene)
        self.grid = driving.Grid.of(request, options.timestep)
        self.ready = ready = prepared.lent(scene, options.timestep, options.word) if ready is None else ready
        self.model, self.tree, self.data = ready.model, ready.tree, ready.data
        self.data.qvel[:] = ready.velocities  # positions are the model's own
        self.cause = ""  # of an end that the callback does not see
        self.plant = plant = Plant(
            scene, request.law, request.actuation, request.on_infeasible, run_view.RUN, carried(scene)
        )
        self.times = self.grid.times
        self.width = plant["row_width"]
        plant.take(ready.table)
        self.contacts = None if scene.contact is None else contact.Contacts(structure, self.model, plant)
        if scene.motions:
            motion.set_supports(scene, self.tree, self.model, plant, start)
        self.joints = joints.JointForces(scene, self.tree, self.model, plant) if structure.class_number > 1 else None
        more = 3 * len(structure.rods) + sum(part.width for part in (self.joints, self.contacts) if part)
        more += len(structure.constraints)
        # One row more than the grid has, for where a law stops the run.
        self.rows = allocate_rows(len(self.times) + 1, self.width + more)
        self.grid.describe(plant, self.rows)
        self.counters = np.array([0, 0, 0, -1, run_view.RUNNING, 0], np.int64)
        plant.set(
            designed=np.array(structure.rest_lengths),
            stages=options.stages,
            counters=self.counters,
            work=np.zeros(3),
            powers=np.zeros(3),
            resets=True,
            writes_state=self.joints is not None,
            constrained=scene.contact is not None or bool(scene.motions and self.tree.forest.closures),
            resolution_kind=KINDS.get(options.integrator.value, SEMI_IMPLICIT),
        )
        answers.set_answering(scene, self.tree, self.model, plant)
        if request.start is not None:
            request.start.put_back(plant, **self._own)
        self.counters[run_view.STEP], self.data.time = self.grid.first, request.begin

    @property
    def _own(self) -> dict[str, Array]:
        """Arrays that a continued run needs as well as its plant."""
        data = self.data
        return {"qpos": data.qpos, "qvel": data.qvel, "qacc_warmstart": data.qacc_warmstart, "work": self.plant["work"]}

    def run(self) -> Trajectory:
        counters, begin, end = self.counters, self.grid.first, {}
        with install.installed(self.plant) as texts:
            self._warm_up()
            clock = driving.Stopwatch(self.request)

            def advance(first: int, count: int) -> int:
                self._advance(begin + first, count)
                if counters[run_view.ENDED] == run_view.RUNNING:
                    self._check(begin + first + count, clock.seconds)
                return int(counters[run_view.STEP]) - begin

            if driving.drive(self.grid, self.request, f"MuJoCo {self.options.integrator.value}", advance):
                end = continuing.saved_state(self.options, self.plant, **self._own)
                mujoco.mj_forward(self.model, self.data)  # the last row
            seconds = clock.seconds
            if counters[run_view.ENDED] != run_view.RUNNING:
                finish(self.plant.address)
        found = self.conclude(seconds, texts)
        if end and not self.options.locate_slack:
            found.provenance["end"] = end
        return found

    def _advance(self, first: int, count: int) -> None:
        """Make `count` steps from number `first`."""
        mujoco.mj_step(self.model, self.data, count)

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the forces so far."""
        return (int(self.counters[run_view.STEP]) - self.grid.first) * self.plant["stages"]

    @property
    def ended_early(self) -> float | None:
        """The time [s] at which it ended before its time, or None."""
        ended = int(self.counters[run_view.ENDED])
        if ended == run_view.FINISHED:
            return None
        step = self.counters[run_view.STEP if ended == run_view.RUNNING else run_view.END_STEP]
        return float(step * self.options.timestep)

    def conclude(self, seconds: float, texts: Sequence[str] = ()) -> Trajectory:
        """Return the run's trajectory, or raise the error that it ended with."""
        options, counters = self.options, self.counters
        ended, step = int(counters[run_view.ENDED]), int(counters[run_view.END_STEP])
        if ended == run_view.RUNNING:
            self._diverged(self.cause, seconds, int(counters[run_view.STEP]) * options.timestep)
        if ended == run_view.FINISHED:
            self.plant.raise_if_failed(SOLVED, self.times[-1])  # a load, at the very end
            run = self._finish(len(self.times), Status.COMPLETED, "", seconds)
            check_energy(run, self._remedy(), self.options.is_explicit)
            for text in texts:
                warn_caller(f"MuJoCo: {text}", RuntimeWarning)
            return run
        time, count = step * options.timestep, int(counters[run_view.NEXT_ROW])
        if counters[run_view.STAGE] == 0 and not self.plant["status"]:
            self.times = np.append(self.times[: count - 1], time)  # the law stopped it at a step's start: a row more
        if ended == run_view.LOST:
            self._diverged(f"positions or velocities are beyond {BEYOND:g} m or m/s", seconds, time)
        if ended == run_view.LOST_CONTROL:
            self._diverged(f"rest lengths are beyond {BEYOND:g} m, where MuJoCo ignores them", seconds, time)
        blame = (self.plant, time, self._remedy(), self.options.is_explicit)
        try:
            self.plant.raise_if_failed(ended, time)
        except TensegrityError:
            blame_divergence(self._partial(seconds), *blame)
            raise
        assert ended == NO_SOLUTION, ended
        blame_divergence(self._partial(seconds), *blame)
        return self._finish(count, Status.INFEASIBLE, self.plant.infeasible_message(time), seconds)

    def _warm_up(self) -> None:
        """Compile what a run calls from Python, so that no clock counts it; the callback is installed already."""
        _ = finish.address

    def _check(self, steps: int, seconds: float) -> None:
        """Raise if MuJoCo warned, stopped counting steps, or has a value that is infinite or NaN."""
        data = self.data
        finite = bool(np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all())
        if causes := causes_of(data.warning.number, finite, int(self.counters[run_view.STEP]), steps):
            self._diverged(", ".join(causes), seconds, steps * self.options.timestep)

    def _diverged(self, cause: str, seconds: float, time: float) -> NoReturn:
        partial = self._partial(seconds)
        check_energy(partial, self._remedy(), self.options.is_explicit)  # it may know better when and why
        raise DivergenceError(f"diverged by t = {time:.6g} s: {cause}; {self._remedy()}", time, partial)

    def _partial(self, seconds: float) -> Trajectory:
        """Trajectory so far: the rows that have their accelerations."""
        rows = int(self.counters[run_view.NEXT_ROW]) - int(self.counters[run_view.WAITING] >= 0)
        if self.plant["status"]:  # a load that failed has no value at the last row
            rows -= 1
        return self._finish(max(1, min(rows, len(self.times))), Status.DIVERGED, "diverged", seconds)

    def _remedy(self) -> str:
        text = f"reduce the time step (h = {self.options.timestep:g} s)"
        if self.options.integrator.value != "discrete":
            text += ", or trade accuracy for stability with Integrator.DISCRETE"
        return text

    def _finish(self, count: int, status: Status, message: str, seconds: float) -> Trajectory:
        structure = self.request.scene.structure
        R, rows = len(structure.rods), self.rows[:count]
        states = self.width + 3 * R
        reports: dict[str, Any] = {}
        forces: Array | None = None
        pushes: Array | None = None
        if self.contacts is not None:
            own = rows[:, states + (self.joints.width if self.joints else 0) :]
            pushes, forces, reports["contact"] = self.contacts.forces(own)
        constraint_forces = rows[:, rows.shape[1] - len(structure.constraints) :].copy()
        if structure.constraints:
            forces = (constraint_forces @ structure.constraint_rows).reshape(count, -1, 3)
        rod: Array | RodMotion = RodMotion(rows[:, self.width : states].reshape(count, R, 3), forces)
        if self.joints is not None:
            rod, found = self.joints.multipliers(self.times[:count], rows[:, : states + self.joints.width], pushes)
            reports |= found
        cost = {
            "wall_time": seconds,
            "steps": int(self.counters[run_view.STEP]) - self.grid.first,
            "evaluations": self.evaluations,
        }
        engine = {
            "name": "MuJoCo",
            "timestep": self.options.timestep,
            "integrator": self.options.integrator.value,
            **({"locate_slack": True} if self.options.locate_slack else {}),
        }
        return make_trajectory(
            self.request,
            self.options,
            self.plant,
            self.times[:count],
            rows[:, : self.width],
            rod,
            Account(status, message, cost, engine, reports, constraint_forces),
        )
