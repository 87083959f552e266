"""The compiled loop of the fixed-step method: classical Runge-Kutta, with samples of the law, breaks and rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.actuation import remember, start_ledger
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.resolution import resolve_start
from tensegrity_mj.dynamics.native.slack import SEARCH_SIZE, SEARCHED
from tensegrity_mj.dynamics.native.slots import CONTINUOUS, MODE, PASSIVE, STATUS, STRING_COUNT
from tensegrity_mj.dynamics.native.watch import watch_strings
from tensegrity_mj.engines.reference.equations import break_due_strings, guard, observe, project, rates, sample_law
from tensegrity_mj.engines.reference.located import located_step, rk4_stages


@njit
def rk4_steps(
    table: Any, y: Any, h: float, first: int, count: int, total: int, stride: int, ratio: int, rows: Any, locate: bool
) -> tuple[int, int, int]:
    """`count` classical Runge-Kutta steps from number `first`; returns (step reached, status, evaluations).

    Args:
        table: of the plant.
        y: the state, which is advanced.
        h: step [s].
        first, count, total: number of the first step, how many to take, how many the run has.
        stride, ratio: steps between rows, and between samples of the law (0: it is not sampled).
        rows: what is recorded.
        locate: whether steps are split where strings begin or cease to pull.

    y is always a state that the model can hold: that of the step returned.
    """
    size, evaluations = len(y), 0
    k1, k2, k3, k4, k_end = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    x = np.empty(size)
    states, strings = np.empty((2, size)), np.empty((SEARCHED, 3, table[STRING_COUNT]))
    flags, search = np.empty((2, table[STRING_COUNT]), np.bool_), np.empty(SEARCH_SIZE)
    reuse = ratio == 0
    known, asked = False, SOLVED  # whether k_end is dy/dt here, and what was answered
    row = (first + stride - 1) // stride
    for n in range(first, first + count):
        t = n * h
        status = SOLVED
        broke = break_due_strings(t, y, table)
        if ratio > 0 and n % ratio == 0:
            status = sample_law(t, y, table)
            if n == 0:
                start_ledger(table)
        if known and not broke:
            k1[:] = k_end
        else:
            asked = rates(t, y, k1, table)
            evaluations += 1
        if asked > NO_SOLUTION:
            status = asked
        watch_strings(table, t, n % ratio == 0 and status == SOLVED if ratio else asked == SOLVED)
        resolve_start(table, h)
        if n == 0 and ratio == 0:
            start_ledger(table)
        if ratio == 0:
            status = asked
            if status == SOLVED and table[MODE] == CONTINUOUS:
                remember(table)
        if status > NO_SOLUTION or table[STATUS] != 0 or (status == NO_SOLUTION and not table[PASSIVE]):
            observe(y, table, rows[row])
            return n, max(status, table[STATUS]), evaluations
        if n % stride == 0:
            observe(y, table, rows[row])
            row += 1
        if locate:
            end = (n + 1) * h
            worst, took, known, asked = located_step(
                table, t, h, end, y, k1, k2, k3, k4, x, k_end, reuse, states, strings, flags, search
            )
            evaluations += took
        else:
            worst = rk4_stages(table, t, h, y, k1, k2, k3, k4, x)
            evaluations += 3
            if worst <= NO_SOLUTION:
                project(x, table)
        if worst <= NO_SOLUTION:
            worst = guard(x, table)
        if worst > NO_SOLUTION:
            return n, worst, evaluations
        y[:] = x
    n = first + count
    if n == total:
        t = n * h
        status = SOLVED
        break_due_strings(t, y, table)
        if ratio > 0 and n % ratio == 0:
            status = sample_law(t, y, table)
        asked = rates(t, y, k1, table)
        watch_strings(table, t, n % ratio == 0 and status == SOLVED if ratio else asked == SOLVED)
        resolve_start(table, h)
        if ratio == 0:
            status = asked
        observe(y, table, rows[len(rows) - 1])
        if status > NO_SOLUTION or (status == NO_SOLUTION and not table[PASSIVE]):
            return n, status, evaluations
    return n, SOLVED, evaluations
