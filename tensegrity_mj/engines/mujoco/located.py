"""A MuJoCo run by RK4 whose steps are split at the instants where strings begin or cease to pull.

MuJoCo's step is taken apart: forces at its start (`mj_forwardSkip`, with the control callback), the other three stages
(`mj_RungeKutta`), and the positions and velocities of its end, from which the strings there are known and which the
next step needs anyway. So a step without a change of the strings is bit for bit that of `mj_step`. Where strings
change, shorter steps are tried from the same start, whose state and forces were kept, until the instant is found
(`native.slack`); the rest of the step begins anew there. Rows, samples of the law and breaks stay at whole steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from tensegrity_mj.dynamics.native.actuation import set_rest_lengths
from tensegrity_mj.dynamics.native.law import NO_SOLUTION
from tensegrity_mj.dynamics.native.plant import RESOLUTION
from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, floats, integers
from tensegrity_mj.dynamics.native.slack import (
    ABOVE,
    HIGH,
    JUMP_WITHIN,
    MOST_SPLITS,
    NOW,
    SEARCH_SIZE,
    SEARCHED,
    START,
    TRIED,
    asks,
    begin_search,
    first_change,
    keep_slack,
    learn,
    let_go,
    look,
    next_part,
    note,
)
from tensegrity_mj.dynamics.native.slots import MODE, MOTION_COUNT, MOVED, NO_LAW, STRING_COUNT
from tensegrity_mj.dynamics.native.strings import measure_strings
from tensegrity_mj.engines.mujoco.callback import (
    ANSWERED,
    CONSTRAINED,
    CONSTRAINT_FORCE,
    COUNTERS,
    ENDED,
    PART,
    POWERS,
    RUNNING,
    STAGE,
    STEP,
    STEP_SIZE,
    SUPPORTS,
    WORK_INTEGRALS,
    finish_row,
    read_nodes,
)
from tensegrity_mj.engines.mujoco.motion import SUPPORTS_SIZE, constraint_work
from tensegrity_mj.engines.mujoco.run import MuJoCoRun
from tensegrity_mj.engines.request import Request

if TYPE_CHECKING:
    from tensegrity_mj.engines.mujoco.engine import MuJoCo


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
def after_first_stage(table: Any, kept: Any, powers: Any, strings: Any, pulled: Any, slack: Any) -> None:
    """Keep the state at the start of a step or part, whose forces are known now, and what is known of the strings.

    Its powers (3,) [W] are kept with it, since their work counts with the length of the step.
    """
    finish_row(table)  # a trial begins after it, and knows its own tensions alone
    if table[MOTION_COUNT] > 0:
        powers[2] += _count_constraints(table)
    copy_state(kept, SOURCE, AT_START)
    look(table, strings[START])
    note(strings[START], pulled, slack)


@borrowing
def _count_constraints(table: Any) -> float:
    """Count what constraints did to moved supports over the stage before, whose forces are known now: their power."""
    if not table[CONSTRAINED]:
        return 0.0
    supports = integers(table[SUPPORTS], (SUPPORTS_SIZE,))
    power = constraint_work(supports, table[MOVED], table[CONSTRAINT_FORCE], 1.0, False)
    floats(table[WORK_INTEGRALS], (3,))[2] += floats(table[STEP_SIZE], (1,))[0] / 6.0 * power
    return power


@borrowing
def begin_trial(table: Any, kept: Any, powers: Any, h: float) -> None:
    """Put the start of the step back, for one of h [s] with the same forces there."""
    copy_state(kept, AT_START, SOURCE)  # powers, works and length of that step among it
    size, work = floats(table[STEP_SIZE], (1,)), floats(table[WORK_INTEGRALS], (3,))
    for k in range(3):
        work[k] += (h - size[0]) / 6.0 * powers[k]
    size[0] = h


@borrowing
def after_last_stage(table: Any, t: float, h: float, strings: Any, pulled: Any, slack: Any) -> float:
    """What to search for in a step or part of h [s] that ends at t, see `first_change`; or `UNKNOWN`.

    The last stage's work is counted.
    """
    if table[MOTION_COUNT] > 0:
        _count_constraints(table)
    if asks(table) and not read_nodes(table):
        return UNKNOWN
    answer = set_rest_lengths(table, t)
    if answer > NO_SOLUTION:
        return UNKNOWN
    look(table, strings[ABOVE])
    part = first_change(table, strings, pulled, slack, h)
    if part == 0.0 and asks(table):
        table[ANSWERED] = 1 + answer
    return part


@borrowing
def after_trial(table: Any, t: float, part: float, strings: Any, pulled: Any, search: Any) -> bool:
    """Whether to go on with a search, after a part of the step that ends at t. The last stage's work is counted."""
    if table[MOTION_COUNT] > 0:
        _count_constraints(table)
    if not read_nodes(table):
        return False
    measure_strings(table)
    if set_rest_lengths(table, t) > NO_SOLUTION:
        return False
    look(table, strings[NOW])
    return learn(strings, pulled, part, search)


class LocatedRun(MuJoCoRun):
    """One run whose steps are split.

    Raises:
        OptionError: for a scene with contact, whose forces jump at instants that no string tells.
    """

    def __init__(self, options: MuJoCo, request: Request) -> None:
        super().__init__(options, request)
        data, table = self.data, self.plant.table
        M = int(table[STRING_COUNT])
        self._evaluations = 0
        self._strings, self._search = np.zeros((SEARCHED, 3, M)), np.zeros(SEARCH_SIZE)
        self._pulled, self._slack = np.zeros((2, M), np.bool_)
        self._powers, self._begins = np.zeros(3), np.zeros(1)  # [W], and [s] where a part of a step begins
        table[POWERS] = address_of(self._powers)
        own = (
            self.counters,
            self.keep[WORK_INTEGRALS],
            self.keep[STEP_SIZE],
            self._powers,
            self.plant[RESOLUTION].reshape(-1),
            self.plant.elements.states.reshape(-1),
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
        """Of the forces, up to now, those of searches included."""
        return self._evaluations

    def _warm_up(self) -> None:
        super()._warm_up()
        table, h = self.plant.table.copy(), float(self.options.timestep)
        table[MODE], kept = NO_LAW, self._kept[:0]
        strings = np.zeros((SEARCHED, 3, 0))
        none, search = np.zeros(0, np.bool_), np.zeros(SEARCH_SIZE)
        for slot in (STRING_COUNT, MOTION_COUNT):
            table[slot] = 0
        scratch, counters = np.zeros(3), np.full(len(self.counters), -1)
        table[WORK_INTEGRALS] = table[STEP_SIZE] = address_of(scratch)
        table[COUNTERS] = address_of(counters)
        after_first_stage(table, kept, np.zeros(3), strings, none, none)
        after_last_stage(table, 0.0, h, strings, none, none)
        copy_state(kept, SOURCE, AT_END)
        copy_state(kept, AT_END, SOURCE)
        keep_slack(table, none)
        let_go(table)
        begin_search(strings, 1.0, search)
        next_part(table, h, strings, none, none, search)
        begin_trial(table, kept, np.zeros(3), h)
        after_trial(table, 0.0, 1.0, strings, none, search)

    def _advance(self, first: int, count: int) -> None:
        if not len(self._pulled):
            super()._advance(first, count)
            self._evaluations = super().evaluations
            return
        if first == 0:
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
        """The rest of the step; false where the run has ended."""
        mujoco.mj_RungeKutta(self.model, self.data, STAGES)
        self._evaluations += STAGES - 1
        return bool(self.counters[ENDED] == RUNNING)

    def _step(self, number: int) -> bool:
        """One whole step; false where the run has ended."""
        table, strings, pulled, slack = self.plant.table, self._strings, self._pulled, self._slack
        step = self.options.timestep
        t, left, end = number * step, step, (number + 1) * step
        time = 0.0
        for split in range(MOST_SPLITS + 1):
            if not self._first_stage(UNSEEN if split else SEEN):
                # A law that fails at the start of a part leaves no row, as one that does within a step.
                self.counters[STAGE] = max(self.counters[STAGE], split > 0)
                return False
            after_first_stage(table, self._kept, self._powers, strings, pulled, slack)
            if not self._other_stages():
                return False
            self._see()
            change = after_last_stage(table, end, left, strings, pulled, slack)
            if split == 0:
                time = self.data.time
            if change <= 0.0 or split == MOST_SPLITS:
                break
            copy_state(self._kept, SOURCE, AT_END)
            keep_slack(table, slack)
            begin_search(strings, change, self._search)
            part = self._instant(t, left)
            let_go(table)
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
        if table[PART]:
            self._whole_steps()
            self.data.time = time
        return True

    def _instant(self, t: float, h: float) -> float:
        """Bring the state just after the first instant at which a string changes, in a step of h [s] from t.

        Returns:
            its part of the step; 0 where none changes after all, or the run has ended.
        """
        table, strings, pulled, search = self.plant.table, self._strings, self._pulled, self._search
        while True:
            part = next_part(table, h, strings, pulled, self._slack, search)
            if part == 0.0:
                return float(search[HIGH]) if search[TRIED] else 0.0
            begin_trial(table, self._kept, self._powers, part * h)
            self._set_part(t, part * h)
            if not self._other_stages():
                return 0.0
            # Where the nodes are and how they move, some third of what `_see` takes.
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_comVel(self.model, self.data)
            self._evaluations += asks(table)
            if not after_trial(table, t + part * h, part, strings, pulled, search):
                return 0.0

    def _set_part(self, t: float, h: float) -> None:
        """What is taken next is a part of a step: of h [s], from t."""
        self._begins[0] = t
        self.plant.table[PART] = address_of(self._begins)
        self.keep[STEP_SIZE][0] = self.model.opt.timestep = h

    def _whole_steps(self) -> None:
        self.plant.table[PART] = 0
        self.keep[STEP_SIZE][0] = self.model.opt.timestep = self.options.timestep
