"""The compiled equations of the reference engine, as the integrators call them.

State y: q = (z, b) of every rod and point mass, q̇, and the work integrals of the energy ledger.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.kernels import accelerations, normalize, place_nodes
from tensegrity_mj.dynamics.native.compiling import c_function, njit
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import floats, integers, records_reader
from tensegrity_mj.dynamics.native.slots import ADDED, FORCES, NODE_COUNT, NODES, TABLE_SIZE, VELOCITIES
from tensegrity_mj.dynamics.records import POINT, ROD
from tensegrity_mj.dynamics.wet_rods import wet_accelerations
from tensegrity_mj.engines.reference.equations import (
    MODEL_SLOTS,
    MULTIPLIERS,
    RATES_SIGNATURE,
    STATE_SIGNATURE,
    STATE_SIZE,
    let_forces_act,
)

RODS, ROD_COUNT, POINTS, POINT_COUNT, Q_SIZE, CONSTANTS = range(MODEL_SLOTS, MODEL_SLOTS + 6)
_read_rods, _read_points = records_reader(ROD), records_reader(POINT)


@njit
def _before(t: float, y: Any, dy: Any, table: Any) -> int:
    """Everything but the accelerations; the law's answer."""
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    place_nodes(y[:nq], y[nq : 2 * nq], rods, points, nodes, velocities)
    dy[:nq] = y[nq : 2 * nq]
    return let_forces_act(t, dy[2 * nq : 2 * nq + 3], table)


@c_function(RATES_SIGNATURE, "the equations of the DAE")
def dae_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = _before(t, y, dy, table)
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    constants = floats(table[CONSTANTS], (5,))
    accelerations(
        y[:nq],
        y[nq : 2 * nq],
        floats(table[FORCES], (N, 3)),
        rods,
        points,
        constants,
        constants[3],
        constants[4],
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (len(rods),)),
    )
    return status


@c_function(RATES_SIGNATURE, "the equations of the DAE in water")
def dae_wet_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """With added mass."""
    table = integers(table_at, (TABLE_SIZE,))
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = _before(t, y, dy, table)
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    constants = floats(table[CONSTANTS], (5,))
    dy[2 * nq + 2] += wet_accelerations(
        y[:nq],
        y[nq : 2 * nq],
        floats(table[FORCES], (N, 3)),
        rods,
        points,
        floats(table[ADDED], (len(rods), 4)),
        constants,
        constants[3],
        constants[4],
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (len(rods),)),
    )
    return status


@c_function(STATE_SIGNATURE, "places of nodes in the DAE")
def dae_place(y_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    y = floats(y_at, (2 * nq,))
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    place_nodes(y[:nq], y[nq:], rods, points, nodes, velocities)
    return SOLVED


@c_function(STATE_SIGNATURE, "lengths kept by the DAE")
def dae_normalize(y_at, table_at):  # type: ignore[no-untyped-def]
    """(3.23)-(3.24) on the state."""
    table = integers(table_at, (TABLE_SIZE,))
    nq = table[Q_SIZE]
    y = floats(y_at, (2 * nq,))
    normalize(y[:nq], y[nq:], _read_rods(table[RODS], table[ROD_COUNT]))
    return SOLVED
