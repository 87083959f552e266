"""What every engine does around its own dynamics: strings, the law, actuation, loads, in compiled code.

The parts live in arrays owned by a `Plant`; compiled code reaches them through one table of sizes and addresses,
so that an engine passes a single integer.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.law import FAILED, NO_SOLUTION, NOT_FINITE, SOLVED, Command, NativeLaw, Report
from tensegrity_mj.native.motion import PackedMotions, motion_at
from tensegrity_mj.native.pointers import (
    LOAD_FUNCTION,
    address_of,
    borrowing,
    call_law,
    call_load,
    copy,
    floats,
    integers,
    records_reader,
)
from tensegrity_mj.native.resistance import PackedResistance, resist
from tensegrity_mj.native.water import PackedWater, immerse
from tensegrity_mj.scene import Scene
from tensegrity_mj.strings import StringLaw
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]

LOAD = np.dtype([("node", "i8"), ("force", "f8", (3,)), ("frequency", "f8"), ("phase", "f8")], align=True)
_read_loads = records_reader(LOAD)

# Slots of the table: sizes, flags, and addresses of the arrays named after them.
NODE_COUNT, STRING_COUNT, STRING_NODES, STIFFNESS, DAMPING, CLIPPED, DAMPED = range(7)
MODE, RETURNS_LENGTHS, PASSIVE, LAW, LAW_CONTEXT, HOLDS_FORCE_DENSITY, STATUS = range(7, 14)
HELD, MEMORY, COMMAND, REPORT = range(14, 18)
LOAD_COUNT, LOADS, LOAD_FUNCTION_SLOT, LOADED = range(18, 22)
REST, LENGTH, RATE, TENSION, ELASTIC, FORCES, NODES, VELOCITIES = range(22, 30)
WINCH, SAMPLED_LENGTH = 30, 31
SUSPENDED = 32  # in the continuous mode: the law has no solution, the last admissible rest lengths are held
LIMITED, MAX_FORCE_DENSITY, MIN_REST_LENGTH, WINCH_REACH = range(33, 37)
BREAKING, BREAK_TIMES, BROKEN = range(37, 40)  # how many strings are still to break, when each does, whether it has
COMPLIANCE = 40  # 1/k
MOTION_COUNT, MOTIONS, MOVED = 41, 42, 43  # moved supports, their `PackedMotions`, and d, ḋ, d̈ of each (m, 3, 3)
RESISTANCE = 44  # the table of a `PackedResistance`, 0 for none
WATER = 45  # the table of a `PackedWater`, 0 for none
WATCHED = 46  # what `watch` counts
RESOLUTION, RESOLUTION_KIND = 47, 48  # what `resolution` adds up, and by which rule
ENGINE_SLOTS = 49  # an engine's own slots start here
TABLE_SIZE = 96

REPORT_SIZE = len(Report)
WATCHED_SIZE, RESOLUTION_SIZE = 6, 22  # numbers a string, a node

NO_LAW, CONTINUOUS, HOLD_FORCE_DENSITY, HOLD_REST_LENGTH = range(4)
_MODES = {
    Mode.CONTINUOUS: CONTINUOUS,
    Mode.HOLD_FORCE_DENSITY: HOLD_FORCE_DENSITY,
    Mode.HOLD_REST_LENGTH: HOLD_REST_LENGTH,
}


@borrowing
def measure_strings(table: Any) -> None:
    """Lengths and rates of the strings from the node positions and velocities."""
    N, M = table[NODE_COUNT], table[STRING_COUNT]
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    pairs = integers(table[STRING_NODES], (M, 2))
    lengths, rates = floats(table[LENGTH], (M,)), floats(table[RATE], (M,))
    for m in range(M):
        i, j = pairs[m, 0], pairs[m, 1]
        square, dot = 0.0, 0.0
        for x in range(3):
            s = nodes[j, x] - nodes[i, x]
            square += s * s
            dot += s * (velocities[j, x] - velocities[i, x])
        lengths[m] = np.sqrt(square)
        rates[m] = dot / lengths[m] if square > 0.0 else 0.0


@borrowing
def tighten_strings(table: Any) -> tuple[float, float]:
    """Tension and its elastic part from lengths, rates and rest lengths: the law of `strings`.

    Returns the powers Σ T_elastic dL/dt and Σ (T - T_elastic) dL/dt [W] of the elastic parts and of the dampers.
    """
    M, clipped = table[STRING_COUNT], table[CLIPPED]
    stiffness, damping = floats(table[STIFFNESS], (M,)), floats(table[DAMPING], (M,))
    lengths, rates = floats(table[LENGTH], (M,)), floats(table[RATE], (M,))
    rest, broken = floats(table[REST], (M,)), integers(table[BROKEN], (M,))
    tension, elastic = floats(table[TENSION], (M,)), floats(table[ELASTIC], (M,))
    stored, lost = 0.0, 0.0
    for m in range(M):
        stretch, pull, total = lengths[m] - rest[m], 0.0, 0.0
        if stretch > 0.0 and not broken[m]:
            pull = stiffness[m] * stretch
            total = pull + damping[m] * rates[m]
            if clipped:
                total = max(0.0, total)
        elastic[m], tension[m] = pull, total
        stored += pull * rates[m]
        lost += (total - pull) * rates[m]
    return stored, lost


@borrowing
def string_energy(table: Any) -> float:
    """Elastic energy of all strings at the current lengths and rest lengths."""
    M = table[STRING_COUNT]
    stiffness = floats(table[STIFFNESS], (M,))
    lengths, rest = floats(table[LENGTH], (M,)), floats(table[REST], (M,))
    broken = integers(table[BROKEN], (M,))
    total = 0.0
    for m in range(M):
        stretch = lengths[m] - rest[m]
        if stretch > 0.0 and not broken[m]:
            total += 0.5 * stiffness[m] * stretch * stretch
    return total


@borrowing
def add_string_forces(table: Any) -> None:
    """Add the strings' pull to the nodal forces."""
    N, M = table[NODE_COUNT], table[STRING_COUNT]
    nodes, forces = floats(table[NODES], (N, 3)), floats(table[FORCES], (N, 3))
    pairs = integers(table[STRING_NODES], (M, 2))
    lengths, tension = floats(table[LENGTH], (M,)), floats(table[TENSION], (M,))
    for m in range(M):
        if tension[m] != 0.0 and lengths[m] > 0.0:
            i, j = pairs[m, 0], pairs[m, 1]
            density = tension[m] / lengths[m]
            for x in range(3):
                pull = density * (nodes[j, x] - nodes[i, x])
                forces[i, x] += pull
                forces[j, x] -= pull


@borrowing
def set_loads(table: Any, t: float) -> float:
    """Set the nodal forces to the external ones, those of the resistance and those of water at time t.

    Returns the power [W] of the external ones, of the wind, and of water. What answers the rods' accelerations is
    not among the forces: the engine adds it.
    """
    N = table[NODE_COUNT]
    forces, velocities = floats(table[FORCES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    for n in range(N):
        for x in range(3):
            forces[n, x] = 0.0
    if not table[LOADED]:
        return 0.0
    if table[LOAD_FUNCTION_SLOT]:
        if call_load(table[LOAD_FUNCTION_SLOT], t, table[FORCES]) != 0:
            table[STATUS] = FAILED
    else:
        loads = _read_loads(table[LOADS], table[LOAD_COUNT])
        for a in range(len(loads)):
            load = loads[a]
            scale = np.cos(load.frequency * t + load.phase)
            for x in range(3):
                forces[load.node, x] += scale * load.force[x]
    power = 0.0
    for n in range(N):
        for x in range(3):
            power += forces[n, x] * velocities[n, x]
    if table[RESISTANCE]:
        power += resist(table[RESISTANCE], floats(table[NODES], (N, 3)), velocities, forces)
    if table[WATER]:
        power += immerse(table[WATER], t, floats(table[NODES], (N, 3)), velocities, forces)
    return power


@borrowing
def set_motions(table: Any, t: float) -> None:
    """Where the moved supports are at time t, with their velocities and accelerations."""
    for number in range(table[MOTION_COUNT]):
        if motion_at(table[MOTIONS], number, t, table[MOVED] + 72 * number) != 0:
            table[STATUS] = FAILED


@borrowing
def _limit_command(table: Any) -> None:
    """Keep the command within the largest force densities and the smallest rest lengths of the strings."""
    M = table[STRING_COUNT]
    command, lengths = floats(table[COMMAND], (M,)), floats(table[LENGTH], (M,))
    stiffness, most = floats(table[STIFFNESS], (M,)), floats(table[MAX_FORCE_DENSITY], (M,))
    least = floats(table[MIN_REST_LENGTH], (M,))
    for m in range(M):
        if table[RETURNS_LENGTHS]:
            command[m] = max(command[m], least[m], lengths[m] * (1.0 - most[m] / stiffness[m]))
        else:
            command[m] = min(command[m], most[m], stiffness[m] * (1.0 - least[m] / lengths[m]))


@borrowing
def ask_law(table: Any, t: float) -> int:
    """Evaluate the law at the current nodes into the command; SOLVED, NO_SOLUTION, FAILED or NOT_FINITE."""
    M = table[STRING_COUNT]
    asked = floats(table[COMMAND], (M,))
    for m in range(M):
        asked[m] = np.nan  # what is left unwritten, as where an interrupt kills a law in Python, is no answer
    status = call_law(table[LAW], t, table[NODES], table[VELOCITIES], table[LAW_CONTEXT], table[COMMAND], table[REPORT])
    if status == SOLVED:
        command, finite = floats(table[COMMAND], (M,)), True
        for m in range(M):
            finite &= np.isfinite(command[m])
        if not finite:
            return NOT_FINITE
        if table[LIMITED]:
            _limit_command(table)
    elif status != NO_SOLUTION:
        return FAILED
    return status


@borrowing
def command_as_lengths(table: Any, out: Any) -> None:
    """Write the rest lengths that the command asks for at the current lengths."""
    M = table[STRING_COUNT]
    command = floats(table[COMMAND], (M,))
    if table[RETURNS_LENGTHS]:
        copy(command, out)
    else:
        compliance, lengths = floats(table[COMPLIANCE], (M,)), floats(table[LENGTH], (M,))
        for m in range(M):
            out[m] = lengths[m] * (1.0 - command[m] * compliance[m])


@borrowing
def set_rest_lengths(table: Any, t: float) -> int:
    """Rest lengths at this stage, from the law or from what is held; returns the law's status if it was asked."""
    M = table[STRING_COUNT]
    rest, held = floats(table[REST], (M,)), floats(table[HELD], (M,))
    if table[MODE] == CONTINUOUS and not table[SUSPENDED]:
        status = ask_law(table, t)
        if status == SOLVED:
            command_as_lengths(table, rest)
        else:
            copy(floats(table[MEMORY], (M,)), rest)
        return status
    if table[HOLDS_FORCE_DENSITY]:
        stiffness, lengths = floats(table[STIFFNESS], (M,)), floats(table[LENGTH], (M,))
        for m in range(M):
            rest[m] = lengths[m] * (1.0 - held[m] / stiffness[m])
    elif table[SUSPENDED]:
        copy(floats(table[MEMORY], (M,)), rest)
    else:
        copy(held, rest)
    return SOLVED


@borrowing
def remember(table: Any) -> None:
    """Keep the current rest lengths as the last admissible ones."""
    M = table[STRING_COUNT]
    copy(floats(table[REST], (M,)), floats(table[MEMORY], (M,)))


@borrowing
def start_ledger(table: Any) -> None:
    """Count winch work from here on, at the current lengths and rest lengths."""
    winch = floats(table[WINCH], (3,))
    winch[0], winch[1], winch[2] = 0.0, string_energy(table), 0.0
    M = table[STRING_COUNT]
    copy(floats(table[LENGTH], (M,)), floats(table[SAMPLED_LENGTH], (M,)))


@borrowing
def winch_work(table: Any, stored: float) -> float:
    """-∫ T dL0 up to now [J], T the elastic tension; `stored` is ∫ Σ T dL, integrated beside the state.

    Continuous: by parts, since L0 = L - T/k: -∫ T dL0 = Δ(T²/2k) - ∫ T dL (so the string energy drops out of the
    balance in this mode, which tests the rest of it). Sampled: the energy step at each jump of
    L0, and where the force density u is held, -∫ u L d(L (1 - u/k)) = -u (1 - u/k) Δ(L²)/2 between the jumps.
    """
    winch = floats(table[WINCH], (3,))
    if table[MODE] == NO_LAW:
        return 0.0
    if table[MODE] == CONTINUOUS:
        return string_energy(table) + winch[2] - winch[1] - stored
    total = winch[0]
    if table[HOLDS_FORCE_DENSITY]:
        M = table[STRING_COUNT]
        held, stiffness = floats(table[HELD], (M,)), floats(table[STIFFNESS], (M,))
        lengths, start = floats(table[LENGTH], (M,)), floats(table[SAMPLED_LENGTH], (M,))
        broken = integers(table[BROKEN], (M,))
        for m in range(M):
            if held[m] > 0.0 and not broken[m]:
                square = lengths[m] * lengths[m] - start[m] * start[m]
                total -= 0.5 * held[m] * (1.0 - held[m] / stiffness[m]) * square
    return total


@borrowing
def take_sample(table: Any, t: float) -> int:
    """Sample the law: renew what is held. Where it has no solution, the rest lengths of this moment are held."""
    M = table[STRING_COUNT]
    held, rest = floats(table[HELD], (M,)), floats(table[REST], (M,))
    set_rest_lengths(table, t)  # those in force until now
    work, before = winch_work(table, 0.0), string_energy(table)
    status = ask_law(table, t)
    if status != SOLVED:
        copy(rest, held)
        table[HOLDS_FORCE_DENSITY] = 0
    elif table[MODE] == HOLD_FORCE_DENSITY:
        command = floats(table[COMMAND], (M,))
        stiffness, lengths = floats(table[STIFFNESS], (M,)), floats(table[LENGTH], (M,))
        for m in range(M):
            held[m] = stiffness[m] * (1.0 - command[m] / lengths[m]) if table[RETURNS_LENGTHS] else command[m]
        table[HOLDS_FORCE_DENSITY] = 1
    else:
        command_as_lengths(table, held)
        if table[LIMITED]:
            reach = floats(table[WINCH_REACH], (M,))
            for m in range(M):
                held[m] = min(max(held[m], rest[m] - reach[m]), rest[m] + reach[m])
    set_rest_lengths(table, t)
    floats(table[WINCH], (3,))[0] = work + string_energy(table) - before
    copy(floats(table[LENGTH], (M,)), floats(table[SAMPLED_LENGTH], (M,)))
    return status


@borrowing
def break_strings(table: Any, t: float) -> bool:
    """Break the strings whose time has come; to be called at the start of a step. Their energy is lost."""
    M = table[STRING_COUNT]
    times, broken = floats(table[BREAK_TIMES], (M,)), integers(table[BROKEN], (M,))
    due = False
    for m in range(M):
        # Break times are multiples of fixed steps, up to round-off.
        due |= not broken[m] and times[m] <= t * (1.0 + 1e-12)
    if not due:
        return False
    set_rest_lengths(table, t)
    winch = floats(table[WINCH], (3,))
    work, before = winch_work(table, 0.0), string_energy(table)
    for m in range(M):
        if not broken[m] and times[m] <= t * (1.0 + 1e-12):
            broken[m] = 1
            table[BREAKING] -= 1
    winch[2] += before - string_energy(table)
    if table[MODE] != CONTINUOUS:
        winch[0] = work
        copy(floats(table[LENGTH], (M,)), floats(table[SAMPLED_LENGTH], (M,)))
    return True


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
