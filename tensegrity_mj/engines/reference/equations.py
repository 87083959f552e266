"""What the integrators know of a model: four compiled functions, reached through addresses in the plant's table.

    int64 rates(double t, int64 y, int64 dy, int64 table)   dy/dt; leaves nodes, strings and λ of the state in the table
    int64 place(int64 y, int64 table)                       node positions and velocities of a state, nothing else
    int64 project(int64 y, int64 table)                     puts a state back onto the model's constraints (0: none)
    int64 guard(int64 y, int64 table)                       whether the model can hold a state (0: it always can)

The integers are addresses: of the state y (STATE_SIZE,), of its derivative, of the plant's table. They return SOLVED,
what the law returned, or SINGULAR. The last three numbers of y are the work integrals of the energy ledger. So one
compiled loop serves every model, and is cached for all of them.

Where elements have states, these are integrated behind all that (`element_states`), and no model knows of it.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.native.actuation import break_strings, set_rest_lengths, take_sample
from tensegrity_mj.dynamics.native.compiling import intrinsic, njit
from tensegrity_mj.dynamics.native.elements import let_act
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.plant import row_width, write_row
from tensegrity_mj.dynamics.native.pointers import call_by_address, floats
from tensegrity_mj.dynamics.native.slots import BREAKING, ENGINE_SLOTS, STRING_COUNT
from tensegrity_mj.dynamics.native.strings import add_string_forces, measure_strings, tighten_strings

RATES, PLACE, PROJECT, GUARD, STATE_SIZE, MULTIPLIERS, MULTIPLIER_COUNT = range(ENGINE_SLOTS, ENGINE_SLOTS + 7)
MODEL_RATES = ENGINE_SLOTS + 7  # where elements have states: RATES of the model alone
MODEL_SLOTS = ENGINE_SLOTS + 8  # a model's own slots start here

WORK = 3  # work integrals at the end of y: elastic string work ∫ Σ T dL, dissipation, external work
SINGULAR = 4  # beside the law's answers: the model's coordinates cannot hold this state

RATES_SIGNATURE = "int64(float64, int64, int64, int64)"
STATE_SIGNATURE = "int64(int64, int64)"


@intrinsic
def call_rates(typingctx: Any, function: Any, time: Any, y: Any, dy: Any, table: Any) -> Any:
    return call_by_address("diii")


@intrinsic
def _call_on_state(typingctx: Any, function: Any, y: Any, table: Any) -> Any:
    return call_by_address("ii")


@njit
def rates(t: float, y: Any, dy: Any, table: Any) -> int:
    """dy/dt of the model, and its answer."""
    return call_rates(table[RATES], t, y.ctypes.data, dy.ctypes.data, table.ctypes.data)


@njit
def place(y: Any, table: Any) -> int:
    """Place the nodes of a state and measure the strings."""
    status = _call_on_state(table[PLACE], y.ctypes.data, table.ctypes.data)
    measure_strings(table)
    return status


@njit
def project(y: Any, table: Any) -> int:
    """Put a state back onto the model's constraints, where it does so."""
    if table[PROJECT] == 0:
        return SOLVED
    return _call_on_state(table[PROJECT], y.ctypes.data, table.ctypes.data)


@njit
def guard(y: Any, table: Any) -> int:
    """SINGULAR where the model's coordinates cannot hold a state."""
    if table[GUARD] == 0:
        return SOLVED
    return _call_on_state(table[GUARD], y.ctypes.data, table.ctypes.data)


@njit
def let_forces_act(t: float, dwork: Any, table: Any) -> int:
    """Forces of elements and strings on the nodes at their current places, for the rates of a model.

    Writes into dwork (3,) the powers of elastic tensions, of what is lost, and of what is given from outside but for
    what answers accelerations; returns the law's answer.
    """
    dwork[0] = 0.0
    dwork[2], dwork[1] = let_act(table, t)
    if table[STRING_COUNT] == 0:
        return SOLVED
    measure_strings(table)
    status = set_rest_lengths(table, t)
    dwork[0], damped = tighten_strings(table)
    dwork[1] += damped
    add_string_forces(table)
    return status


@njit
def observe(y: Any, table: Any, row: Any) -> None:
    """Write the state that `rates` saw last as a row, λ behind it."""
    work, count = table[STATE_SIZE] - WORK, table[MULTIPLIER_COUNT]
    write_row(table, y[work], y[work + 1], y[work + 2], row)
    width = row_width(table)
    row[width : width + count] = floats(table[MULTIPLIERS], (count,))


@njit
def sample_law(t: float, y: Any, table: Any) -> int:
    """Sample the law at a state."""
    place(y, table)
    return take_sample(table, t)


@njit
def break_due_strings(t: float, y: Any, table: Any) -> bool:
    """Break the strings whose time has come; whether any was there."""
    if table[BREAKING] <= 0:
        return False
    place(y, table)
    return break_strings(table, t)
