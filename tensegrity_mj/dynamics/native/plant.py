"""What every engine does around its own dynamics: strings, the law, actuation, elements, in compiled code.

The parts live in arrays owned by a `Plant`; compiled code reaches them through one table of sizes and addresses,
so that an engine passes a single integer.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.actuation import winch_work
from tensegrity_mj.dynamics.native.elements import PackedElements
from tensegrity_mj.dynamics.native.law import FAILED, NOT_FINITE, Command, NativeLaw, Report
from tensegrity_mj.dynamics.native.motion import PackedMotions
from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, copy, floats
from tensegrity_mj.dynamics.native.slots import (
    BREAK_TIMES,
    BREAKING,
    BROKEN,
    CLIPPED,
    COMMAND,
    COMPLIANCE,
    CONTINUOUS,
    DAMPED,
    DAMPING,
    ELASTIC,
    ELEMENT_STATE_COUNT,
    ELEMENT_STATES,
    FORCES,
    HELD,
    HOLD_FORCE_DENSITY,
    HOLD_REST_LENGTH,
    LAW,
    LAW_CONTEXT,
    LENGTH,
    LIMITED,
    MAX_FORCE_DENSITY,
    MEMORY,
    MIN_REST_LENGTH,
    MODE,
    MOTION_COUNT,
    MOTIONS,
    MOVED,
    NO_LAW,
    NODE_COUNT,
    NODES,
    PASSIVE,
    RATE,
    REPORT,
    REPORT_SIZE,
    REST,
    RETURNS_LENGTHS,
    SAMPLED_LENGTH,
    STIFFNESS,
    STRING_COUNT,
    STRING_NODES,
    TABLE_SIZE,
    TENSION,
    VELOCITIES,
    WINCH,
    WINCH_REACH,
)
from tensegrity_mj.errors import ControllerError
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure

WATCHED = 46  # what `watch` counts
RESOLUTION, RESOLUTION_KIND = 47, 48  # what `resolution` adds up, and by which rule

WATCHED_SIZE, RESOLUTION_SIZE = 6, 22  # numbers a string, a node

_MODES = {
    Mode.CONTINUOUS: CONTINUOUS,
    Mode.HOLD_FORCE_DENSITY: HOLD_FORCE_DENSITY,
    Mode.HOLD_REST_LENGTH: HOLD_REST_LENGTH,
}


@borrowing
def row_width(table: Any) -> int:
    """Length of what `write_row` writes."""
    return 6 * table[NODE_COUNT] + 3 * table[STRING_COUNT] + 3 + table[ELEMENT_STATE_COUNT] + REPORT_SIZE


@borrowing
def write_row(table: Any, stored: float, lost: float, external: float, row: Any) -> None:
    """Nodes, velocities, L0, elastic tensions, tensions, winch work, dissipation, external work, the elements' states,
    the law's report."""
    N, M, S = table[NODE_COUNT], table[STRING_COUNT], table[ELEMENT_STATE_COUNT]
    copy(floats(table[NODES], (3 * N,)), row)
    copy(floats(table[VELOCITIES], (3 * N,)), row[3 * N :])
    at = 6 * N
    copy(floats(table[REST], (M,)), row[at:])
    copy(floats(table[ELASTIC], (M,)), row[at + M :])
    copy(floats(table[TENSION], (M,)), row[at + 2 * M :])
    at += 3 * M
    row[at] = winch_work(table, stored)
    row[at + 1], row[at + 2] = lost + floats(table[WINCH], (3,))[2], external
    copy(floats(table[ELEMENT_STATES], (S,)), row[at + 3 :])
    copy(floats(table[REPORT], (REPORT_SIZE,)), row[at + 3 + S :])


def break_times(scene: Scene) -> Array:
    """When each string breaks (M,) [s], ∞ for never."""
    times = {event.string: event.time for event in scene.breaks}
    return np.array([times.get(string.name, np.inf) for string in scene.structure.strings], float)


class Plant:
    """The arrays behind the table: strings, law, actuation and elements of one run.

    Attributes:
        table: (TABLE_SIZE,) int64, see the slots above.
        arrays: slot -> array, kept alive here.
        elements: what acts on the nodes besides.
    """

    def __init__(self, scene: Scene, law: NativeLaw, actuation: Actuation, on_infeasible: OnInfeasible) -> None:
        structure = scene.structure
        N, M = len(structure.nodes), len(structure.strings)
        self.scene, self.law = scene, law
        self.arrays: dict[int, Any] = {
            STRING_NODES: np.array(structure.string_nodes),
            STIFFNESS: np.array(structure.stiffness),
            COMPLIANCE: 1.0 / np.array(structure.stiffness),
            DAMPING: np.array(structure.damping),
            HELD: np.array(structure.rest_lengths),
            MEMORY: np.array(structure.rest_lengths),
            REST: np.array(structure.rest_lengths),
            NODES: np.array(scene.nodes0),
            VELOCITIES: np.array(scene.velocities0),
            FORCES: np.zeros((N, 3)),
            REPORT: np.full(REPORT_SIZE, np.nan),
            WINCH: np.zeros(3),  # work of the jumps so far, energy at the start, energy set free by breaking strings
            BREAK_TIMES: break_times(scene),
            BROKEN: np.zeros(M, np.int64),
            MOVED: np.zeros((len(scene.motions), 3, 3)),
            WATCHED: np.zeros((M, WATCHED_SIZE)),
            RESOLUTION: np.zeros((N, RESOLUTION_SIZE)),
            **{slot: np.zeros(M) for slot in (COMMAND, LENGTH, RATE, TENSION, ELASTIC, SAMPLED_LENGTH)},
        }
        self.table = np.zeros(TABLE_SIZE, np.int64)
        for slot, array in self.arrays.items():
            self.table[slot] = address_of(array)
        self.table[NODE_COUNT], self.table[STRING_COUNT] = N, M
        self.table[CLIPPED] = structure.string_law is StringLaw.CLIPPED
        self.table[DAMPED] = bool(np.any(structure.damping > 0))
        self.table[RETURNS_LENGTHS] = law.command is Command.REST_LENGTH
        self.table[PASSIVE] = on_infeasible is OnInfeasible.PASSIVE
        self.table[LAW], self.table[LAW_CONTEXT] = law.address, law.context
        self.table[MODE] = _MODES[actuation.mode] if law.address else NO_LAW
        self.table[BREAKING] = len(scene.breaks)
        self.motions = PackedMotions(scene.motions)
        self.table[MOTION_COUNT], self.table[MOTIONS] = len(scene.motions), self.motions.address
        self._set_limits(structure, actuation)
        self.elements = PackedElements(scene, self.table)

    def _set_limits(self, structure: Structure, actuation: Actuation) -> None:
        # A winch that holds rest lengths from sample to sample moves them once a period.
        reach = structure.limits("winch_speed") * (actuation.period or np.inf)
        limits = (structure.limits("max_force_density"), structure.limits("min_rest_length"), reach)
        for slot, values in zip((MAX_FORCE_DENSITY, MIN_REST_LENGTH, WINCH_REACH), limits, strict=True):
            self.arrays[slot] = values
            self.table[slot] = address_of(values)
            self.table[LIMITED] |= bool(np.any(np.isfinite(values)))

    @property
    def address(self) -> int:
        """Of the table."""
        return address_of(self.table)

    def __getitem__(self, slot: int) -> Any:
        return self.arrays[slot]

    def raise_if_failed(self, status: int, time: float) -> None:
        """Raise what a law or an element did wrong.

        Raises:
            ControllerError: with the time, and the exception or the offending value.
            ElementError: with the element that failed; OptionError, SceneError: what a function of loads or of a
                support's motion did wrong.
        """
        if self.motions.failure:
            raise self.motions.failure[0]
        self.elements.raise_if_failed(time)
        if status == FAILED:
            cause = self.law.failure[0] if self.law.failure else None
            if cause is not None and not isinstance(cause, Exception):
                raise cause  # KeyboardInterrupt within a Python law
            detail = f"{type(cause).__name__}: {cause}" if cause is not None else "no reason given"
            raise ControllerError(
                f"the law failed near t = {time:.6g} s: {detail}; it must return {len(self.arrays[COMMAND])} finite "
                "numbers at every state, or raise InfeasibleError"
            ) from cause
        if status == NOT_FINITE:
            command = self.arrays[COMMAND]
            number = int(np.argmin(np.isfinite(command)))
            name = self.scene.structure.strings[number].name
            raise ControllerError(
                f"the law returned {command[number]} for string '{name}' near t = {time:.6g} s; "
                "it must return a finite number for every string"
            )

    def infeasible_message(self, time: float) -> str:
        """What a run stopped by an infeasible law says."""
        text = f"the law has no admissible solution at t = {time:.6g} s"
        margin = float(self.arrays[REPORT][Report.FEASIBILITY_MARGIN])
        if self.law.reason:
            text += f": {self.law.reason[0]}"
        elif not np.isnan(margin):
            # Where the moment is located, the last margin is the smallest positive one.
            text += f": its margin max(v/α) (5.18) is {margin:.3g}" if margin <= 0 else ": its margin falls to 0 (5.18)"
        return text + "; change the target or the options of the law, or choose OnInfeasible.PASSIVE"
