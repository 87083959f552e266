"""One step of RK4 that is split at the instants where strings begin or cease to pull.

Within a step, a kink of the forces leaves an error of h², and a jump, as of a damped string that comes taut, one of h.
Between them motion is smooth. So the step is taken as it is; where a string pulls at one end of it and not at the
other, the instant of the change is found with shorter steps from the same start (`native.slack`), the first of them is
kept, and the rest of the step begins anew there. Without such strings nothing but their lengths is looked at, and the
step is bit for bit the plain one.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.native.actuation import set_rest_lengths
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.plant import RESOLUTION_KIND
from tensegrity_mj.dynamics.native.resolution import resolve_stage, resolve_start
from tensegrity_mj.dynamics.native.slack import (
    ABOVE,
    HIGH,
    JUMP_WITHIN,
    MOST_SPLITS,
    NOW,
    START,
    TRIED,
    asks,
    begin_search,
    first_change,
    keep_slack,
    learn,
    let_go,
    look,
    next_part,
    note,
)
from tensegrity_mj.dynamics.native.slots import STRING_COUNT
from tensegrity_mj.engines.reference.equations import place, project, rates


@njit
def rk4_stages(table: Any, t: float, h: float, y: Any, k1: Any, k2: Any, k3: Any, k4: Any, x: Any) -> int:
    """x = y(t + h) by classical Runge-Kutta from y and k1 = dy/dt there; returns the worst that a stage answered."""
    size = len(y)
    for i in range(size):
        x[i] = y[i] + 0.5 * h * k1[i]
    worst = rates(t + 0.5 * h, x, k2, table)
    if worst <= NO_SOLUTION:
        resolve_stage(table, 1, h)
        for i in range(size):
            x[i] = y[i] + 0.5 * h * k2[i]
        worst = rates(t + 0.5 * h, x, k3, table)
    if worst <= NO_SOLUTION:
        resolve_stage(table, 2, h)
        for i in range(size):
            x[i] = y[i] + h * k3[i]
        worst = rates(t + h, x, k4, table)
    if worst <= NO_SOLUTION:
        resolve_stage(table, 3, h)
    if worst <= NO_SOLUTION:
        for i in range(size):
            x[i] = y[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
    return worst


@njit
def _look_at(table: Any, t: float, y: Any, k: Any, out: Any) -> tuple[int, int]:
    """`look` at a state; the worst answer, and how many evaluations that took. k is scratch, or dy/dt."""
    worst, took = SOLVED, 0
    if asks(table):
        worst, took = rates(t, y, k, table), 1
    else:
        place(y, table)
        set_rest_lengths(table, t)
    look(table, out)
    return worst, took


@njit
def located_step(
    table: Any,
    t: float,
    h: float,
    end: float,
    y: Any,
    k1: Any,
    k2: Any,
    k3: Any,
    k4: Any,
    x: Any,
    k_end: Any,
    reuse: bool,
    states: Any,
    strings: Any,
    flags: Any,
    search: Any,
) -> tuple[int, int, bool, int]:
    """As `rk4_stages`, split where strings begin or cease to pull, and x put where the model can hold it.

    The table's strings are those of y at t.

    Args:
        end: [s], t + h.
        k_end: where dy/dt at x goes.
        reuse: whether that is of use, so that it costs nothing to have it.
        states, strings, flags, search: (2, size), (SEARCHED, 3, M), (2, M) of booleans, (SEARCH_SIZE,), scratch.

    Returns:
        the worst that a stage answered; how many evaluations it took, beside that of k1; whether k_end is known and
        the table's strings are those of x; what was answered there.
    """
    if table[STRING_COUNT] == 0:
        worst = rk4_stages(table, t, h, y, k1, k2, k3, k4, x)
        if worst <= NO_SOLUTION:
            project(x, table)
        return worst, 3, False, SOLVED
    pulled, slack, z, found = flags[0], flags[1], states[0], states[1]
    z[:] = y
    left, evaluations = h, 0
    for split in range(MOST_SPLITS + 1):
        look(table, strings[START])
        note(strings[START], pulled, slack)
        worst = rk4_stages(table, t, left, z, k1, k2, k3, k4, x)
        evaluations += 3
        if worst > NO_SOLUTION:
            return worst, evaluations, False, SOLVED
        project(x, table)
        if reuse:
            answer, took = rates(end, x, k_end, table), 1
            look(table, strings[ABOVE])
        else:
            answer, took = _look_at(table, end, x, k_end, strings[ABOVE])
        evaluations += took
        if answer > NO_SOLUTION:
            return worst, evaluations, False, SOLVED
        part = first_change(table, strings, pulled, slack, left)
        if part == 0.0 or split == MOST_SPLITS:
            return worst, evaluations, reuse, answer
        keep_slack(table, slack)
        begin_search(strings, part, search)
        kind, table[RESOLUTION_KIND] = table[RESOLUTION_KIND], 0  # the whole step's estimate counts, not the search's
        part, took = _instant(table, t, left, z, k1, k2, k3, k4, found, k_end, strings, pulled, slack, search)
        table[RESOLUTION_KIND] = kind
        let_go(table)
        evaluations += took
        if part == 0.0:
            return worst, evaluations, False, SOLVED
        t += part * left
        left = end - t
        z[:] = found
        project(z, table)
        if left <= JUMP_WITHIN * h:
            x[:] = z
            return worst, evaluations, False, SOLVED
        worst = rates(t, z, k1, table)
        resolve_start(table, left)
        evaluations += 1
        if worst > NO_SOLUTION:
            return worst, evaluations, False, SOLVED
    return worst, evaluations, False, SOLVED


@njit
def _instant(
    table: Any,
    t: float,
    h: float,
    y: Any,
    k1: Any,
    k2: Any,
    k3: Any,
    k4: Any,
    x: Any,
    k: Any,
    strings: Any,
    pulled: Any,
    slack: Any,
    search: Any,
) -> tuple[float, int]:
    """Just after the first instant within a step at which a string changes: its part of the step, with x there.

    Args:
        table to x: as of `rk4_stages`.
        k: scratch.
        strings, pulled, slack, search: of a search that was begun.

    Returns:
        the part, 0 where none changes after all; the evaluations it took.
    """
    took = 0
    while True:
        part = next_part(table, h, strings, pulled, slack, search)
        if part == 0.0:
            return search[HIGH] if search[TRIED] != 0.0 else 0.0, took
        worst = rk4_stages(table, t, part * h, y, k1, k2, k3, k4, x)
        took += 3
        if worst > NO_SOLUTION:
            return 0.0, took
        worst, asked = _look_at(table, t + part * h, x, k, strings[NOW])
        took += asked
        if worst > NO_SOLUTION or not learn(strings, pulled, part, search):
            return 0.0, took
