"""The compiled loop of the fixed-step method: classical Runge-Kutta, with samples of the law, breaks and rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.actuation import remember, start_ledger
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS
from tensegrity_mj.dynamics.native.resolution import resolve_start
from tensegrity_mj.dynamics.native.watch import watch_strings
from tensegrity_mj.engines.reference.equations import (
    ModelView,
    break_due_strings,
    guard,
    observe,
    project,
    rates,
    sample_law,
)
from tensegrity_mj.engines.reference.located import Room, located_step, rk4_stages


@njit
def rk4_steps(table: int, y: Any, first: int, count: int) -> tuple[int, int, int]:
    """`count` classical Runge-Kutta steps from number `first`; returns (step reached, status, evaluations).

    Args:
        table: of the plant, with the grid of steps and the rows.
        y: the state, which is advanced.
        first, count: number of the first step, and how many to take.

    y is always a state that the model can hold: that of the step returned.
    """
    model, size, evaluations = ModelView(table), len(y), 0
    h, total, stride, ratio, rows = model.step, model.total, model.stride, model.ratio, model.rows
    k = np.empty((8, size))
    room = Room(k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7])
    known, answer = False, SOLVED  # whether k_end is dy/dt here, and what was answered
    begin = model.first_step
    row = (first - begin + stride - 1) // stride
    stop = first + count
    for n in range(first, stop + 1 if stop == total else stop):
        t, last = n * h, n == total
        status = SOLVED
        broke = break_due_strings(t, y, table)
        if ratio > 0 and n % ratio == 0:
            status = sample_law(t, y, table)
            if n == 0:
                start_ledger(table)
        model.arrived = model.yielding
        if known and not broke and not last and not model.yielding:
            room.k1[:] = room.k_end
        else:
            answer = rates(t, y, room.k1, table)
            evaluations += not last
        if answer > NO_SOLUTION:
            status = answer
        watch_strings(table, t, n % ratio == 0 and status == SOLVED if ratio else answer == SOLVED)
        resolve_start(table, h)
        if n == 0 and ratio == 0:
            start_ledger(table)
        if ratio == 0:
            status = answer
            if status == SOLVED and model.mode == CONTINUOUS:
                remember(table)
        if status > NO_SOLUTION or (status == NO_SOLUTION and not model.passive) or (model.status != 0 and not last):
            observe(y, table, rows[row])
            return n, max(status, model.status), evaluations
        if (n - begin) % stride == 0 or last:
            observe(y, table, rows[row])
            row += 1
        if last:
            return n, SOLVED, evaluations
        if model.search:
            worst, took, known, answer = located_step(table, n, h, y, room)
            evaluations += took
        else:
            worst = rk4_stages(table, t, h, y, room, room.x)
            evaluations += 3
            if worst <= NO_SOLUTION:
                project(room.x, table)
        if worst <= NO_SOLUTION:
            worst = guard(room.x, table)
        if worst > NO_SOLUTION:
            return n, worst, evaluations
        y[:] = room.x
    return stop, SOLVED, evaluations
