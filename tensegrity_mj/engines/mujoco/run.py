"""One run of the MuJoCo engine: the model stepped with the law inside its control callback, in whole or split steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import warn_caller
from tensegrity_mj.dynamics.native import slack
from tensegrity_mj.dynamics.native.actuation import set_rest_lengths
from tensegrity_mj.dynamics.native.law import FAILED, NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, integers
from tensegrity_mj.dynamics.native.resolution import DISCRETE, SEMI_IMPLICIT, STAGES
from tensegrity_mj.dynamics.native.slack import follows_law, look_at_end, look_at_start, look_at_trial
from tensegrity_mj.dynamics.native.strings import measure_strings
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines import continuing, driving, requirements
from tensegrity_mj.engines.mujoco import contact, implicit_forces, install, joints, prepared, run_view
from tensegrity_mj.engines.mujoco.callback import finish_row, read_nodes
from tensegrity_mj.engines.mujoco.install import finish
from tensegrity_mj.engines.mujoco.mjcf_tree import cheaper
from tensegrity_mj.engines.mujoco.motion import count_constraints, set_supports
from tensegrity_mj.engines.mujoco.run_view import RunView
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
            set_supports(scene, self.tree, self.model, plant, start)
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
        implicit_forces.set_implicit_forces(scene, self.tree, self.model, plant)
        if request.start is not None:
            request.start.put_back(plant, **self._own)
        self.counters[run_view.STEP], self.data.time = self.grid.first, request.begin

    @property
    def _own(self) -> dict[str, Array]:
        """Arrays that a continued run needs as well as its plant."""
        data = self.data
        return {"qpos": data.qpos, "qvel": data.qvel, "qacc_warmstart": data.qacc_warmstart, "work": self.plant["work"]}

    def run(self) -> Trajectory:
        """Make the run: once."""
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
        step, softer = f"reduce the time step (h = {self.options.timestep:g} s)", self.request.softer
        if self.options.integrator.value != "discrete":
            return f"{step}, {softer}or trade accuracy for stability with Integrator.DISCRETE"
        return f"{step}, or {softer.removesuffix(', ')}" if softer else step

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
        if note := cheaper(self.request.scene, self.tree):
            reports["cheaper"] = note
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


RK4_STAGES = 4
SEEN, UNSEEN = int(mujoco.mjtStage.mjSTAGE_VEL), int(mujoco.mjtStage.mjSTAGE_NONE)  # whether `_see` was called
UNKNOWN = -1.0  # what changed in a step, where it is not known what the strings do at its end

# Of what is saved of a state: where it is, how many numbers of 8 bytes, and where they are saved at the start of a step
# and at its end.
SOURCE, COUNT, AT_START, AT_END = range(4)


@borrowing
def copy_state(saved: Any, origin: int, goal: int) -> None:
    """Copy a state from one of `SOURCE`, `AT_START` and `AT_END` to another."""
    for i in range(len(saved)):
        source, target = integers(saved[i, origin], (saved[i, COUNT],)), integers(saved[i, goal], (saved[i, COUNT],))
        for k in range(len(source)):
            target[k] = source[k]


@borrowing
def after_first_stage(table: int, saved: Any, search: int, last: bool) -> None:
    """Keep the state at the start of a step or part, whose forces are known now, and what is known of the strings.

    Its powers [W] are kept with it, since their work counts with the length of the step.
    """
    finish_row(table)  # a trial begins after it, and knows its own tensions alone
    run = RunView(table)
    run.powers[2] += count_constraints(run, run.step / 6.0, False)
    copy_state(saved, SOURCE, AT_START)
    look_at_start(table, search, last)


@borrowing
def begin_trial(table: int, saved: Any, h: float) -> None:
    """Put the start of the step back, for one of h [s] with the same forces there."""
    copy_state(saved, AT_START, SOURCE)  # powers, works and length of that step among it
    run = RunView(table)
    work, powers = run.work, run.powers
    for k in range(3):
        work[k] += (h - run.step) / 6.0 * powers[k]
    run.step = h


@borrowing
def after_last_stage(table: int, t: float, h: float, search: int) -> float:
    """Return what to search for in a step or part of h [s] that ends at t, see `look_at_end`; or `UNKNOWN`.

    The last stage's work is counted.
    """
    run = RunView(table)
    count_constraints(run, run.step / 6.0, False)
    if follows_law(table) and not read_nodes(table):
        return UNKNOWN
    answer = set_rest_lengths(table, t)
    if answer > NO_SOLUTION:
        return UNKNOWN
    part = look_at_end(table, search, h)
    if part == 0.0 and follows_law(table):
        run.answered = 1 + answer
    return part


@borrowing
def after_trial(table: int, t: float, part: float, search: int) -> bool:
    """Return whether a search goes on, after a part of the step that ends at t. It counts the last stage's work."""
    run = RunView(table)
    count_constraints(run, run.step / 6.0, False)
    if not read_nodes(table):
        return look_at_trial(table, search, part, FAILED)
    measure_strings(table)
    return look_at_trial(table, search, part, set_rest_lengths(table, t))


class LocatedRun(MuJoCoRun):
    """One run by RK4 whose steps are split at the instants where strings begin or cease to pull.

    MuJoCo's step is taken apart: forces at its start (`mj_forwardSkip`, with the control callback), the other three
    stages (`mj_RungeKutta`), and the positions and velocities of its end, from which the strings there are known and
    which the next step needs anyway. So a step without a change of the strings is bit for bit that of `mj_step`. Where
    strings change, shorter steps are tried from the same start, whose state and forces were kept, until the instant is
    found (`native.slack`); the rest of the step begins anew there. Rows, samples of the law and breaks stay at whole
    steps.

    Raises:
        OptionError: for a scene with contact, whose forces jump at instants that no string shows.
    """

    def __init__(self, options: MuJoCo, request: Request) -> None:
        super().__init__(options, request)
        data, plant = self.data, self.plant
        self._evaluations = 0
        self._search = slack.search_of(plant["string_count"], plant["curved"])
        step = plant.place("step")
        own = (
            self.counters,
            plant["work"],
            plant.table[step : step + 1],
            plant["powers"],
            plant["resolution"].reshape(-1),
            plant.elements.states.reshape(-1),
        )
        sources = [one for one in (data.qpos, data.qvel, data.qacc, data.qacc_warmstart, *own) if len(one)]
        self._copies = [np.zeros((2, len(source)), source.dtype) for source in sources]
        self._saved = np.array(
            [
                (address_of(source), len(source), address_of(copies[0]), address_of(copies[1]))
                for source, copies in zip(sources, self._copies, strict=True)
            ],
            np.int64,
        )

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the forces so far, those of searches included."""
        return self._evaluations

    def _warm_up(self) -> None:
        super()._warm_up()
        blank, search, saved = Table("blank", run_view.RUN), slack.search_of(0), self._saved[:0]
        blank.set(counters=np.full(len(self.counters), -1), work=np.zeros(3), powers=np.zeros(3))
        table, at = blank.address, search.address
        after_first_stage(table, saved, at, False)
        after_last_stage(table, 0.0, 1.0, at)
        copy_state(saved, SOURCE, AT_END)
        slack.begin_search(table, at, 1.0)
        slack.next_part(table, at, 1.0)
        begin_trial(table, saved, 1.0)
        after_trial(table, 0.0, 1.0, at)
        slack.end_search(table, at)

    def _advance(self, first: int, count: int) -> None:
        if not self.plant["string_count"]:
            super()._advance(first, count)
            self._evaluations = super().evaluations
            return
        if first == self.grid.first:
            self._see()
        try:
            for number in range(first, first + count):
                if not self._step(number):
                    break
        finally:
            self._whole_steps()

    def _see(self) -> None:
        """Positions and velocities of the state, and the strings' lengths and rates."""
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)

    def _first_stage(self, seen: int) -> bool:
        """Forces of the state; false where the run has ended."""
        mujoco.mj_forwardSkip(self.model, self.data, seen, 1)
        self._evaluations += 1
        return bool(self.counters[run_view.ENDED] == run_view.RUNNING)

    def _other_stages(self) -> bool:
        """Do the rest of the step; false where the run has ended."""
        mujoco.mj_RungeKutta(self.model, self.data, RK4_STAGES)
        self._evaluations += RK4_STAGES - 1
        return bool(self.counters[run_view.ENDED] == run_view.RUNNING)

    def _step(self, number: int) -> bool:
        """Make one whole step; false where the run has ended."""
        table, search, step = self.plant.address, self._search.address, self.options.timestep
        t, left, end = number * step, step, (number + 1) * step
        time = 0.0
        for split in range(slack.MOST_SPLITS + 1):
            if not self._first_stage(UNSEEN if split else SEEN):
                # A law that fails at the start of a part leaves no row, as one that does within a step.
                self.counters[run_view.STAGE] = max(self.counters[run_view.STAGE], split > 0)
                return False
            after_first_stage(table, self._saved, search, split == slack.MOST_SPLITS)
            if not self._other_stages():
                return False
            self._see()
            change = after_last_stage(table, end, left, search)
            if split == 0:
                time = self.data.time
            if change <= 0.0 or split == slack.MOST_SPLITS:
                break
            copy_state(self._saved, SOURCE, AT_END)
            slack.begin_search(table, search, change)
            self._try_parts(t, left)
            part = slack.end_search(table, search)
            if self.counters[run_view.ENDED] != run_view.RUNNING:
                return False
            if part == 0.0:
                copy_state(self._saved, AT_END, SOURCE)
                self._see()
                break
            t += part * left
            left = end - t
            if left <= slack.JUMP_WITHIN * step:
                self._see()
                break
            self.counters[run_view.STEP] = number
            self._set_part(t, left)
        if self.plant["part"]:
            self._whole_steps()
            self.data.time = time
        return True

    def _try_parts(self, t: float, h: float) -> None:
        """Take parts of a step of h [s] from t until the state is that just after the instant of a change."""
        table, search = self.plant.address, self._search.address
        while (part := slack.next_part(table, search, h)) > 0.0:
            begin_trial(table, self._saved, part * h)
            self._set_part(t, part * h)
            if not self._other_stages():
                return
            # Where the nodes are and how they move, some third of what `_see` takes.
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_comVel(self.model, self.data)
            self._evaluations += follows_law(table)
            if not after_trial(table, t + part * h, part, search):
                return

    def _set_part(self, t: float, h: float) -> None:
        """Make the next step a part of a step: of h [s], from t."""
        self.plant.set(part=1, begins=t, step=h)
        self.model.opt.timestep = h

    def _whole_steps(self) -> None:
        self.plant.set(part=0, step=self.options.timestep)
        self.model.opt.timestep = self.options.timestep
