"""One step of RK4, and one that is split at the instants where strings begin or cease to pull.

Within a step, a kink of the forces leaves an error of h², and a jump, as of a damped string that comes taut, one of h.
Between them motion is smooth. So the step is taken as it is; where a string pulls at one end of it and not at the
other, the instant of the change is found with shorter steps from the same start (`native.slack`), the first of them is
kept, and the rest of the step begins anew there. Without such strings nothing but their lengths is looked at, and the
step is bit for bit the plain one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tensegrity_mj.dynamics.native.actuation import set_rest_lengths
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.lanes import alone
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.pointers import copy
from tensegrity_mj.dynamics.native.resolution import NONE, resolve_stage, resolve_start
from tensegrity_mj.dynamics.native.slack import (
    JUMP_WITHIN,
    MOST_SPLITS,
    begin_search,
    end_search,
    follows_law,
    look_at_end,
    look_at_start,
    look_at_trial,
    next_part,
)
from tensegrity_mj.engines.reference.equations import ModelView, place, project, rates


class Room(NamedTuple):
    """Scratch arrays of a step, each (size,).

    Attributes:
        k1, k2, k3, k4: dy/dt at its stages.
        x: the state at its end.
        k_end: dy/dt there, where it is known.
        z: the state where a part of the step begins.
        found: that at the end of a part which is tried.
    """

    k1: Any
    k2: Any
    k3: Any
    k4: Any
    x: Any
    k_end: Any
    z: Any
    found: Any


@njit
def rk4_stages(table: int, t: float, h: float, y: Any, room: Room, x: Any) -> int:
    """x = y(t + h) by classical Runge-Kutta from y and k1 = dy/dt there; returns the worst that a stage answered."""
    k1, k2, k3, k4 = room.k1, room.k2, room.k3, room.k4
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
        for i in range(size):
            x[i] = y[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
    return worst


@njit
def _set_strings(table: int, t: float, x: Any, k: Any) -> tuple[int, int]:
    """Lengths, rates and rest lengths of strings at x; the answer, and how many evaluations that took. k is scratch."""
    if follows_law(table):
        return rates(t, x, k, table), 1
    place(x, table)
    set_rest_lengths(table, t)
    return SOLVED, 0


@alone((SOLVED, 0, False, SOLVED))
def located_step(table: int, number: int, h: float, y: Any, room: Room) -> tuple[int, int, bool, int]:
    """A step as `rk4_stages`, split where strings begin or cease to pull, and x put where the model can hold it.

    The table's strings are those of y at its start.

    Args:
        number: of the step, which ends at (number + 1) h.

    Returns:
        the worst that a stage answered; how many evaluations it took, without that of k1; whether k_end is known and
        the table's strings are those of x; what was answered there.
    """
    model = ModelView(table)
    t, end = number * h, (number + 1) * h
    if model.string_count == 0:
        worst = rk4_stages(table, t, h, y, room, room.x)
        if worst <= NO_SOLUTION:
            project(room.x, table)
        return worst, 3, False, SOLVED
    search, continuous = model.search, model.ratio == 0
    x, z = room.x, room.z
    copy(y, z)
    left, evaluations = h, 0
    for split in range(MOST_SPLITS + 1):
        look_at_start(table, search, split == MOST_SPLITS)
        worst = rk4_stages(table, t, left, z, room, x)
        evaluations += 3
        if worst > NO_SOLUTION:
            return worst, evaluations, False, SOLVED
        project(x, table)
        if continuous:  # the next step needs it
            answer, took = rates(end, x, room.k_end, table), 1
        else:
            answer, took = _set_strings(table, end, x, room.k_end)
        evaluations += took
        if answer > NO_SOLUTION:
            return worst, evaluations, False, SOLVED
        part = look_at_end(table, search, left)
        if part == 0.0 or split == MOST_SPLITS:
            return worst, evaluations, continuous, answer
        begin_search(table, search, part)
        kind, model.resolution_kind = model.resolution_kind, NONE  # the whole step's estimate counts, not the search's
        evaluations += _search(table, t, left, room)
        model.resolution_kind = kind
        part = end_search(table, search)
        if part == 0.0:
            return worst, evaluations, False, SOLVED
        t += part * left
        left = end - t
        copy(room.found, z)
        project(z, table)
        if left <= JUMP_WITHIN * h:
            copy(z, x)
            return worst, evaluations, False, SOLVED
        model.arrived = model.yielding
        worst = rates(t, z, room.k1, table)
        resolve_start(table, left)
        evaluations += 1
        if worst > NO_SOLUTION:
            return worst, evaluations, False, SOLVED
    return worst, evaluations, False, SOLVED


@njit
def _search(table: int, t: float, h: float, room: Room) -> int:
    """Take parts of a step from z until `found` is just after the instant at which a string changes; evaluations."""
    search, took = ModelView(table).search, 0
    while True:
        part = next_part(table, search, h)
        if part == 0.0:
            return took
        worst = rk4_stages(table, t, part * h, room.z, room, room.found)
        took += 3
        if worst <= NO_SOLUTION:
            worst, evaluated = _set_strings(table, t + part * h, room.found, room.k_end)
            took += evaluated
        if not look_at_trial(table, search, part, worst):
            return took
