"""The thesis' own forms of the equations, as the integrators call them; see `dynamics.tree_equations`."""

from __future__ import annotations

import numba

from tensegrity_mj.dynamics.tree_equations import dense_accelerations, full_accelerations
from tensegrity_mj.engines.dae_linked_kernels import (
    CONSTANTS,
    JOINTS,
    LINKED,
    Q_SIZE,
    ROD_COUNT,
    TREE,
    after,
    before,
)
from tensegrity_mj.engines.integration_kernels import MULTIPLIERS, RATES_SIGNATURE, STATE_SIZE
from tensegrity_mj.native.plant import FORCES, NODE_COUNT, TABLE_SIZE
from tensegrity_mj.native.pointers import floats, integers


@numba.cfunc(RATES_SIGNATURE, cache=True, error_model="numpy")
def dense_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By (3.19)-(3.22)."""
    table = integers(table_at, (TABLE_SIZE,))
    N, nq, size = table[NODE_COUNT], table[Q_SIZE], table[STATE_SIZE]
    y, dy = floats(y_at, (size,)), floats(dy_at, (size,))
    status = before(t, y, dy, table)
    constants = floats(table[CONSTANTS], (5,))
    dy[size - 1] += dense_accelerations(
        table[LINKED],
        table[JOINTS],
        table[TREE],
        y[:nq],
        y[nq : 2 * nq],
        floats(table[FORCES], (N, 3)),
        constants,
        constants[3],
        constants[4],
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (table[ROD_COUNT],)),
    )
    after(table)
    return status


@numba.cfunc(RATES_SIGNATURE, cache=True, error_model="numpy")
def full_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By (3.17)."""
    table = integers(table_at, (TABLE_SIZE,))
    N, nq, size = table[NODE_COUNT], table[Q_SIZE], table[STATE_SIZE]
    y, dy = floats(y_at, (size,)), floats(dy_at, (size,))
    status = before(t, y, dy, table)
    constants = floats(table[CONSTANTS], (5,))
    dy[size - 1] += full_accelerations(
        table[LINKED],
        table[JOINTS],
        table[TREE],
        y[:nq],
        y[nq : 2 * nq],
        floats(table[FORCES], (N, 3)),
        constants,
        constants[3],
        constants[4],
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (table[ROD_COUNT],)),
    )
    after(table)
    return status
