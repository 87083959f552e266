"""The compiled equations of the reference engine, as the integrators call them.

State y: q = (z, b) of every rod and point mass, q̇, and the work integrals of the energy ledger.
"""

from __future__ import annotations

from tensegrity_mj.dynamics.kernels import accelerations, normalize, place_nodes
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import set_loads
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import floats, integers, records_reader
from tensegrity_mj.dynamics.native.slots import FORCES, NODE_COUNT, NODES, TABLE_SIZE, VELOCITIES, WATER
from tensegrity_mj.dynamics.native.water import added_masses
from tensegrity_mj.dynamics.records import POINT, ROD
from tensegrity_mj.dynamics.wet_rods import wet_accelerations
from tensegrity_mj.engines.reference.equations import (
    MODEL_SLOTS,
    MULTIPLIERS,
    RATES_SIGNATURE,
    STATE_SIGNATURE,
    STATE_SIZE,
    pull_strings,
)

RODS, ROD_COUNT, POINTS, POINT_COUNT, Q_SIZE, CONSTANTS = range(MODEL_SLOTS, MODEL_SLOTS + 6)
_read_rods, _read_points = records_reader(ROD), records_reader(POINT)


@c_function(RATES_SIGNATURE, "the equations of the DAE")
def dae_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    N, nq, size = table[NODE_COUNT], table[Q_SIZE], table[STATE_SIZE]
    y, dy = floats(y_at, (size,)), floats(dy_at, (size,))
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    q, q_rates = y[:nq], y[nq : 2 * nq]
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    place_nodes(q, q_rates, rods, points, nodes, velocities)
    dy[2 * nq + 2] = set_loads(table, t)
    status = pull_strings(t, dy[2 * nq : 2 * nq + 2], table)
    constants = floats(table[CONSTANTS], (5,))
    accelerations(
        q,
        q_rates,
        floats(table[FORCES], (N, 3)),
        rods,
        points,
        constants,
        constants[3],
        constants[4],
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (len(rods),)),
    )
    dy[:nq] = q_rates
    return status


@c_function(STATE_SIGNATURE)
def dae_place(y_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    y = floats(y_at, (2 * nq,))
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    place_nodes(y[:nq], y[nq:], rods, points, nodes, velocities)
    return SOLVED


@c_function(STATE_SIGNATURE)
def dae_normalize(y_at, table_at):  # type: ignore[no-untyped-def]
    """(3.23)-(3.24) on the state."""
    table = integers(table_at, (TABLE_SIZE,))
    nq = table[Q_SIZE]
    y = floats(y_at, (2 * nq,))
    normalize(y[:nq], y[nq:], _read_rods(table[RODS], table[ROD_COUNT]))
    return SOLVED


read_rods, read_points = records_reader(ROD), records_reader(POINT)


@c_function(RATES_SIGNATURE, "the equations of the DAE")
def dae_wet_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    N, nq, size = table[NODE_COUNT], table[Q_SIZE], table[STATE_SIZE]
    y, dy = floats(y_at, (size,)), floats(dy_at, (size,))
    rods, points = read_rods(table[RODS], table[ROD_COUNT]), read_points(table[POINTS], table[POINT_COUNT])
    q, q_rates = y[:nq], y[nq : 2 * nq]
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    place_nodes(q, q_rates, rods, points, nodes, velocities)
    dy[2 * nq + 2] = set_loads(table, t)
    status = pull_strings(t, dy[2 * nq : 2 * nq + 2], table)
    constants = floats(table[CONSTANTS], (5,))
    dy[2 * nq + 2] += wet_accelerations(
        q,
        q_rates,
        floats(table[FORCES], (N, 3)),
        rods,
        points,
        floats(added_masses(table[WATER]), (len(rods), 4)),
        constants,
        constants[3],
        constants[4],
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (len(rods),)),
    )
    dy[:nq] = q_rates
    return status
