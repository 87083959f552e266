"""A MuJoCo run by RK4 whose steps are split at the instants where strings begin or cease to pull.

MuJoCo's step is taken apart: forces at its start (`mj_forwardSkip`, with the control callback), the other three stages
(`mj_RungeKutta`), and the positions and velocities of its end, from which the strings there are known and which the
next step needs anyway. So a step without a change of the strings is bit for bit that of `mj_step`. Where strings
change, shorter steps are tried from the same start, whose state and forces were kept, until the instant is found
(`native.slack`); the rest of the step begins anew there. Rows, samples of the law and breaks stay at whole steps.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.dynamics.native.actuation import set_rest_lengths
from tensegrity_mj.dynamics.native.law import FAILED, NO_SOLUTION
from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, integers
from tensegrity_mj.dynamics.native.slack import (
    JUMP_WITHIN,
    MOST_SPLITS,
    begin_search,
    end_search,
    follows_law,
    look_at_end,
    look_at_start,
    look_at_trial,
    next_part,
    search_of,
)
from tensegrity_mj.dynamics.native.strings import measure_strings
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines.mujoco.callback import finish_row, read_nodes
from tensegrity_mj.engines.mujoco.motion import count_constraints
from tensegrity_mj.engines.mujoco.run import MuJoCoRun
from tensegrity_mj.engines.mujoco.run_view import ENDED, RUN, RUNNING, STAGE, STEP, RunView
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.engines.request import Request

STAGES = 4
SEEN, UNSEEN = int(mujoco.mjtStage.mjSTAGE_VEL), int(mujoco.mjtStage.mjSTAGE_NONE)  # whether `_see` was called
UNKNOWN = -1.0  # what changed in a step, where it is not known what the strings do at its end

# Of what is kept of a state: where it is, how many numbers of 8 bytes, and where they are kept at the start of a step
# and at its end.
SOURCE, COUNT, AT_START, AT_END = range(4)


@borrowing
def copy_state(kept: Any, origin: int, goal: int) -> None:
    """Copy a state from one of `SOURCE`, `AT_START` and `AT_END` to another."""
    for i in range(len(kept)):
        source, target = integers(kept[i, origin], (kept[i, COUNT],)), integers(kept[i, goal], (kept[i, COUNT],))
        for k in range(len(source)):
            target[k] = source[k]


@borrowing
def after_first_stage(table: int, kept: Any, search: int, last: bool) -> None:
    """Keep the state at the start of a step or part, whose forces are known now, and what is known of the strings.

    Its powers [W] are kept with it, since their work counts with the length of the step.
    """
    finish_row(table)  # a trial begins after it, and knows its own tensions alone
    run = RunView(table)
    run.powers[2] += count_constraints(run, run.step / 6.0, False)
    copy_state(kept, SOURCE, AT_START)
    look_at_start(table, search, last)


@borrowing
def begin_trial(table: int, kept: Any, h: float) -> None:
    """Put the start of the step back, for one of h [s] with the same forces there."""
    copy_state(kept, AT_START, SOURCE)  # powers, works and length of that step among it
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
    """One run whose steps are split.

    Raises:
        OptionError: for a scene with contact, whose forces jump at instants that no string shows.
    """

    def __init__(self, options: MuJoCo, request: Request) -> None:
        super().__init__(options, request)
        data, plant = self.data, self.plant
        self._evaluations = 0
        self._search = search_of(plant["string_count"], plant["curved"])
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
        self._kept = np.array(
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
        blank, search, kept = Table("blank", RUN), search_of(0), self._kept[:0]
        blank.set(counters=np.full(len(self.counters), -1), work=np.zeros(3), powers=np.zeros(3))
        table, at = blank.address, search.address
        after_first_stage(table, kept, at, False)
        after_last_stage(table, 0.0, 1.0, at)
        copy_state(kept, SOURCE, AT_END)
        begin_search(table, at, 1.0)
        next_part(table, at, 1.0)
        begin_trial(table, kept, 1.0)
        after_trial(table, 0.0, 1.0, at)
        end_search(table, at)

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
        return bool(self.counters[ENDED] == RUNNING)

    def _other_stages(self) -> bool:
        """Do the rest of the step; false where the run has ended."""
        mujoco.mj_RungeKutta(self.model, self.data, STAGES)
        self._evaluations += STAGES - 1
        return bool(self.counters[ENDED] == RUNNING)

    def _step(self, number: int) -> bool:
        """Make one whole step; false where the run has ended."""
        table, search, step = self.plant.address, self._search.address, self.options.timestep
        t, left, end = number * step, step, (number + 1) * step
        time = 0.0
        for split in range(MOST_SPLITS + 1):
            if not self._first_stage(UNSEEN if split else SEEN):
                # A law that fails at the start of a part leaves no row, as one that does within a step.
                self.counters[STAGE] = max(self.counters[STAGE], split > 0)
                return False
            after_first_stage(table, self._kept, search, split == MOST_SPLITS)
            if not self._other_stages():
                return False
            self._see()
            change = after_last_stage(table, end, left, search)
            if split == 0:
                time = self.data.time
            if change <= 0.0 or split == MOST_SPLITS:
                break
            copy_state(self._kept, SOURCE, AT_END)
            begin_search(table, search, change)
            self._try_parts(t, left)
            part = end_search(table, search)
            if self.counters[ENDED] != RUNNING:
                return False
            if part == 0.0:
                copy_state(self._kept, AT_END, SOURCE)
                self._see()
                break
            t += part * left
            left = end - t
            if left <= JUMP_WITHIN * step:
                self._see()
                break
            self.counters[STEP] = number
            self._set_part(t, left)
        if self.plant["part"]:
            self._whole_steps()
            self.data.time = time
        return True

    def _try_parts(self, t: float, h: float) -> None:
        """Take parts of a step of h [s] from t until the state is that just after the instant of a change."""
        table, search = self.plant.address, self._search.address
        while (part := next_part(table, search, h)) > 0.0:
            begin_trial(table, self._kept, part * h)
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
