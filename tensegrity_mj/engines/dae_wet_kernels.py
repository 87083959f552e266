"""The compiled equations of the reference engine in water: `dae_kernels.dae_rates` with the rods' added mass."""

from __future__ import annotations

from tensegrity_mj.dynamics.kernels import place_nodes
from tensegrity_mj.dynamics.records import POINT, ROD
from tensegrity_mj.dynamics.wet_rods import wet_accelerations
from tensegrity_mj.engines.dae_kernels import CONSTANTS, POINT_COUNT, POINTS, Q_SIZE, ROD_COUNT, RODS
from tensegrity_mj.engines.integration_kernels import MULTIPLIERS, RATES_SIGNATURE, STATE_SIZE, pull_strings
from tensegrity_mj.native.compiling import c_function
from tensegrity_mj.native.plant import FORCES, NODE_COUNT, NODES, TABLE_SIZE, VELOCITIES, WATER, set_loads
from tensegrity_mj.native.pointers import floats, integers, records_reader
from tensegrity_mj.native.water import added_masses

read_rods, read_points = records_reader(ROD), records_reader(POINT)


@c_function(RATES_SIGNATURE)
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
