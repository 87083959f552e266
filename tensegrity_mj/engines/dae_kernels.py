"""The compiled right-hand side of the reference engine, and its fixed-step Runge-Kutta method.

State y: q = (z, b) of every rod and point mass, q̇, and the work integrals of the energy ledger.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from tensegrity_mj.dynamics.kernels import accelerations, normalize, place_nodes
from tensegrity_mj.dynamics.records import POINT, ROD
from tensegrity_mj.law import NO_SOLUTION, SOLVED
from tensegrity_mj.native.plant import (
    CONTINUOUS,
    ENGINE_SLOTS,
    FORCES,
    MODE,
    NODE_COUNT,
    NODES,
    PASSIVE,
    STATUS,
    STRING_COUNT,
    VELOCITIES,
    add_string_forces,
    measure_strings,
    remember,
    row_width,
    set_loads,
    set_rest_lengths,
    start_ledger,
    string_power,
    take_sample,
    tighten_strings,
    write_row,
)
from tensegrity_mj.native.pointers import floats, records_reader

njit = numba.njit(cache=True, error_model="numpy")

RODS, ROD_COUNT, POINTS, POINT_COUNT, Q_SIZE, CONSTANTS, MULTIPLIERS = range(ENGINE_SLOTS, ENGINE_SLOTS + 7)
_read_rods, _read_points = records_reader(ROD), records_reader(POINT)

WORK = 3  # work integrals behind q and q̇: elastic string work ∫ Σ T dL, dissipation, external work


@njit
def dae_rhs(t: float, y: Any, dy: Any, table: Any) -> int:
    """dy/dt, and the law's status where it was asked. Leaves nodes, strings and λ of this state in the table."""
    N, M, nq = table[NODE_COUNT], table[STRING_COUNT], table[Q_SIZE]
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    q, rates = y[:nq], y[nq : 2 * nq]
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    place_nodes(q, rates, rods, points, nodes, velocities)
    dy[2 * nq + 2] = set_loads(table, t)
    status, stored, lost = SOLVED, 0.0, 0.0
    if M > 0:
        measure_strings(table)
        status = set_rest_lengths(table, t)
        tighten_strings(table)
        stored, lost = string_power(table)
        add_string_forces(table)
    dy[2 * nq], dy[2 * nq + 1] = stored, lost
    constants = floats(table[CONSTANTS], (5,))
    accelerations(
        q,
        rates,
        floats(table[FORCES], (N, 3)),
        rods,
        points,
        constants,
        constants[3],
        constants[4],
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (len(rods),)),
    )
    dy[:nq] = rates
    return status


@njit
def observe(y: Any, table: Any, row: Any) -> None:
    """Write the state that `dae_rhs` saw last as a row, λ behind it."""
    nq, count = table[Q_SIZE], table[ROD_COUNT]
    write_row(table, y[2 * nq], y[2 * nq + 1], y[2 * nq + 2], row)
    width = row_width(table)
    row[width : width + count] = floats(table[MULTIPLIERS], (count,))


@njit
def sample_law(t: float, y: Any, table: Any) -> int:
    """Place the nodes of this state and sample the law there."""
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    place_nodes(y[:nq], y[nq : 2 * nq], rods, points, nodes, velocities)
    measure_strings(table)
    return take_sample(table, t)


@njit
def renormalize(y: Any, table: Any) -> None:
    """(3.23)-(3.24) on the state."""
    nq = table[Q_SIZE]
    normalize(y[:nq], y[nq : 2 * nq], _read_rods(table[RODS], table[ROD_COUNT]))


@njit
def rk4_steps(
    table: Any, y: Any, h: float, first: int, count: int, total: int, stride: int, ratio: int, fix: bool, rows: Any
) -> tuple[int, int]:
    """`count` classical Runge-Kutta steps from number `first`; returns (step reached, status)."""
    size = len(y)
    k1, k2, k3, k4, x = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    row = (first + stride - 1) // stride
    for n in range(first, first + count):
        t = n * h
        status = SOLVED
        if ratio > 0 and n % ratio == 0:
            status = sample_law(t, y, table)
            if n == 0:
                start_ledger(table)
        asked = dae_rhs(t, y, k1, table)
        if n == 0 and ratio == 0:
            start_ledger(table)
        if ratio == 0:
            status = asked
            if status == SOLVED and table[MODE] == CONTINUOUS:
                remember(table)
        if status > NO_SOLUTION or table[STATUS] != 0 or (status == NO_SOLUTION and not table[PASSIVE]):
            observe(y, table, rows[row])
            return n, max(status, table[STATUS])
        if n % stride == 0:
            observe(y, table, rows[row])
            row += 1
        for i in range(size):
            x[i] = y[i] + 0.5 * h * k1[i]
        worst = dae_rhs(t + 0.5 * h, x, k2, table)
        for i in range(size):
            x[i] = y[i] + 0.5 * h * k2[i]
        worst = max(worst, dae_rhs(t + 0.5 * h, x, k3, table))
        for i in range(size):
            x[i] = y[i] + h * k3[i]
        worst = max(worst, dae_rhs(t + h, x, k4, table))
        if worst > NO_SOLUTION:
            return n, worst
        for i in range(size):
            y[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        if fix:
            renormalize(y, table)
    n = first + count
    if n == total:
        t = n * h
        status = SOLVED
        if ratio > 0 and n % ratio == 0:
            status = sample_law(t, y, table)
        asked = dae_rhs(t, y, k1, table)
        if ratio == 0:
            status = asked
        observe(y, table, rows[len(rows) - 1])
        if status > NO_SOLUTION or (status == NO_SOLUTION and not table[PASSIVE]):
            return n, status
    return n, SOLVED
