"""What every engine does around its own dynamics: strings, the law, actuation, loads, in compiled code.

The parts live in arrays owned by a `Plant`; compiled code reaches them through one table of sizes and addresses,
so that an engine passes a single integer.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.actuation import winch_work
from tensegrity_mj.dynamics.native.elements import LOAD
from tensegrity_mj.dynamics.native.law import FAILED, NOT_FINITE, Command, NativeLaw, Report
from tensegrity_mj.dynamics.native.motion import PackedMotions
from tensegrity_mj.dynamics.native.pointers import (
    LOAD_FUNCTION,
    address_of,
    borrowing,
    copy,
    floats,
)
from tensegrity_mj.dynamics.native.resistance import PackedResistance
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
    FORCES,
    HELD,
    HOLD_FORCE_DENSITY,
    HOLD_REST_LENGTH,
    LAW,
    LAW_CONTEXT,
    LENGTH,
    LIMITED,
    LOAD_COUNT,
    LOAD_FUNCTION_SLOT,
    LOADED,
    LOADS,
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
    RESISTANCE,
    REST,
    RETURNS_LENGTHS,
    SAMPLED_LENGTH,
    STIFFNESS,
    STRING_COUNT,
    STRING_NODES,
    TABLE_SIZE,
    TENSION,
    VELOCITIES,
    WATER,
    WINCH,
    WINCH_REACH,
)
from tensegrity_mj.dynamics.native.water import PackedWater
from tensegrity_mj.errors import ControllerError, OptionError
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
    return 6 * table[NODE_COUNT] + 3 * table[STRING_COUNT] + 3 + REPORT_SIZE


@borrowing
def write_row(table: Any, stored: float, lost: float, external: float, row: Any) -> None:
    """Nodes, velocities, L0, elastic tensions, tensions, winch work, dissipation, external work, the law's report."""
    N, M = table[NODE_COUNT], table[STRING_COUNT]
    copy(floats(table[NODES], (3 * N,)), row)
    copy(floats(table[VELOCITIES], (3 * N,)), row[3 * N :])
    at = 6 * N
    copy(floats(table[REST], (M,)), row[at:])
    copy(floats(table[ELASTIC], (M,)), row[at + M :])
    copy(floats(table[TENSION], (M,)), row[at + 2 * M :])
    at += 3 * M
    row[at] = winch_work(table, stored)
    row[at + 1], row[at + 2] = lost + floats(table[WINCH], (3,))[2], external
    copy(floats(table[REPORT], (REPORT_SIZE,)), row[at + 3 :])


def break_times(scene: Scene) -> Array:
    """When each string breaks (M,) [s], ∞ for never."""
    times = {event.string: event.time for event in scene.breaks}
    return np.array([times.get(string.name, np.inf) for string in scene.structure.strings], float)


class Plant:
    """The arrays behind the table: strings, law, actuation and loads of one run.

    Attributes:
        table: (TABLE_SIZE,) int64, see the slots above.
        arrays: slot -> array, kept alive here.
    """

    def __init__(self, scene: Scene, law: NativeLaw, actuation: Actuation, on_infeasible: OnInfeasible) -> None:
        structure = scene.structure
        N, M = len(structure.nodes), len(structure.strings)
        self.scene, self.law = scene, law
        self.load_failure: list[BaseException] = []
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
        self._set_loads(scene)
        self.resistance = None
        if scene.resistance is not None:
            self.resistance = PackedResistance(scene)
            self.table[RESISTANCE], self.table[LOADED] = self.resistance.address, 1
        self.water = None
        if scene.water is not None:
            self.water = PackedWater(scene)
            self.table[WATER], self.table[LOADED] = self.water.address, 1

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

    def _set_loads(self, scene: Scene) -> None:
        if callable(scene.loads):
            shape = (len(scene.structure.nodes), 3)
            function = scene.loads

            def call(time: float, out: int) -> int:
                try:
                    value = np.asarray(function(time), float)
                    if value.shape != shape or not np.all(np.isfinite(value)):
                        raise ValueError(f"it returned shape {value.shape}; it must return finite {shape} [N]")
                    buffer = (ctypes.c_double * value.size).from_address(out)
                    np.ctypeslib.as_array(buffer)[:] = value.ravel()
                except BaseException as error:
                    if not self.load_failure:
                        self.load_failure.append(error)
                    return 1
                return 0

            self._load_function = LOAD_FUNCTION(call)
            pointer = ctypes.cast(self._load_function, ctypes.c_void_p).value
            self.table[LOAD_FUNCTION_SLOT] = pointer or 0
            self.table[LOADED] = 1
        elif scene.loads:
            records = np.zeros(len(scene.loads), LOAD)
            for record, load in zip(records, scene.loads, strict=True):
                record["node"] = scene.structure.node_index[load.node]
                record["force"] = load.force
                record["frequency"], record["phase"] = load.angular_frequency, load.phase
            self.arrays[LOADS] = records
            self.table[LOADS], self.table[LOAD_COUNT], self.table[LOADED] = address_of(records), len(records), 1

    def raise_if_failed(self, status: int, time: float) -> None:
        """Raise what a law or a load function did wrong.

        Raises:
            ControllerError: with the time, and the exception or the offending value.
            OptionError, SceneError: what a function of loads or of a support's motion did wrong.
        """
        if self.motions.failure:
            raise self.motions.failure[0]
        if self.load_failure:
            error = self.load_failure[0]
            if not isinstance(error, Exception):
                raise error
            raise OptionError(
                f"loads: the function failed near t = {time:.6g} s: {type(error).__name__}: {error}"
            ) from error
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
