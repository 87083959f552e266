"""The compiled equations of rods that share nodes and of moved supports, as the integrators call them.

State y: q and q̇ of `dynamics.linked`, the time where supports move (so that a state alone says where its nodes are),
and the work integrals of the energy ledger, of which the last counts what moves the supports, too.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.closures import largest_gap, project_linked
from tensegrity_mj.dynamics.joint_forces import joint_accelerations
from tensegrity_mj.dynamics.linked import place_linked
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import set_motions
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import borrowing, floats, inlined, integers
from tensegrity_mj.dynamics.native.slots import (
    ADDED,
    FORCES,
    HELD_MASS,
    MOTION_COUNT,
    NODE_COUNT,
    NODES,
    TABLE_SIZE,
    VELOCITIES,
)
from tensegrity_mj.dynamics.tree_equations import dense_accelerations, full_accelerations
from tensegrity_mj.engines.reference.equations import (
    MODEL_SLOTS,
    MULTIPLIERS,
    RATES_SIGNATURE,
    STATE_SIGNATURE,
    STATE_SIZE,
    WORK,
    let_forces_act,
)

LINKED, JOINTS, TREE, Q_SIZE, CONSTANTS, ROD_COUNT, CLOSURE_COUNT = range(MODEL_SLOTS, MODEL_SLOTS + 7)
EXTRA = 2  # behind λ where there are closures: the largest gap [m] and its rate [m/s]


@borrowing
def place_at(t: float, y: Any, table: Any) -> None:
    """Motions, nodes and velocities of a state at a time."""
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    if table[MOTION_COUNT] > 0:
        set_motions(table, t)
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    place_linked(table[LINKED], y[:nq], y[nq : 2 * nq], nodes, velocities)


@borrowing
def before(t: float, y: Any, dy: Any, table: Any) -> int:
    """Everything but the accelerations; the law's answer."""
    nq, work = table[Q_SIZE], len(y) - WORK
    place_at(t, y, table)
    status = let_forces_act(t, dy[work : work + 3], table)
    for k in range(nq):
        dy[k] = y[nq + k]
    if table[MOTION_COUNT] > 0:
        dy[2 * nq] = 1.0
    return status


@borrowing
def after(table: Any) -> None:
    """The gaps of closures behind λ."""
    if table[CLOSURE_COUNT] > 0:
        R = table[ROD_COUNT]
        observed = floats(table[MULTIPLIERS], (R + EXTRA,))
        observed[R], observed[R + 1] = largest_gap(table[LINKED], 0), largest_gap(table[LINKED], 1)


@inlined
def given(y: Any, dy: Any, table: Any) -> Any:
    """What the accelerations are found from, and where they and λ go: the last arguments of `joint_accelerations`."""
    nq = table[Q_SIZE]
    return (
        y[:nq],
        y[nq : 2 * nq],
        floats(table[FORCES], (table[NODE_COUNT], 3)),
        floats(table[CONSTANTS], (5,)),
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (table[ROD_COUNT],)),
    )


@inlined
def mass(table: Any) -> Any:
    """α of the rods, and where the forces of the added mass go."""
    return floats(table[ADDED], (table[ROD_COUNT], 4)), floats(table[HELD_MASS], (table[NODE_COUNT], 3))


@borrowing
def power_of_mass(table: Any) -> float:
    """[W] of the forces of the added mass."""
    size, power = 3 * table[NODE_COUNT], 0.0
    held, velocities = floats(table[HELD_MASS], (size,)), floats(table[VELOCITIES], (size,))
    for x in range(size):
        power += held[x] * velocities[x]
    return power


@c_function(RATES_SIGNATURE, "the equations of the DAE for rods that share nodes")
def linked_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By joint forces, in O(K)."""
    table = integers(table_at, (TABLE_SIZE,))
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = before(t, y, dy, table)
    dy[len(dy) - 1] += joint_accelerations(table[LINKED : TREE + 1], None, *given(y, dy, table))
    after(table)
    return status


@c_function(STATE_SIGNATURE, "places of nodes in the DAE for rods that share nodes")
def linked_place(y_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    y = floats(y_at, (table[STATE_SIZE],))
    place_at(y[2 * table[Q_SIZE]], y, table)
    return SOLVED


@c_function(STATE_SIGNATURE, "joints kept closed by the DAE")
def linked_project(y_at, table_at):  # type: ignore[no-untyped-def]
    """Lengths and closures of a state."""
    table = integers(table_at, (TABLE_SIZE,))
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    y = floats(y_at, (table[STATE_SIZE],))
    if table[MOTION_COUNT] > 0:
        set_motions(table, y[2 * nq])
    project_linked(
        table[LINKED],
        table[JOINTS],
        y[:nq],
        y[nq : 2 * nq],
        floats(table[NODES], (N, 3)),
        floats(table[VELOCITIES], (N, 3)),
    )
    return SOLVED


@c_function(RATES_SIGNATURE, "the equations (3.19) to (3.22) of the DAE")
def dense_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By (3.19)-(3.22)."""
    table = integers(table_at, (TABLE_SIZE,))
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = before(t, y, dy, table)
    dy[len(dy) - 1] += dense_accelerations(table[LINKED : TREE + 1], *given(y, dy, table))
    after(table)
    return status


@c_function(RATES_SIGNATURE, "the equations (3.17) of the DAE")
def full_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By (3.17)."""
    table = integers(table_at, (TABLE_SIZE,))
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = before(t, y, dy, table)
    dy[len(dy) - 1] += full_accelerations(table[LINKED : TREE + 1], None, *given(y, dy, table))
    after(table)
    return status


@c_function(RATES_SIGNATURE, "the equations of the DAE in water for rods that share nodes")
def linked_wet_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By joint forces, with added mass."""
    table = integers(table_at, (TABLE_SIZE,))
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = before(t, y, dy, table)
    dy[len(dy) - 1] += joint_accelerations(table[LINKED : TREE + 1], mass(table), *given(y, dy, table))
    dy[len(dy) - 1] += power_of_mass(table)
    after(table)
    return status


@c_function(RATES_SIGNATURE, "the equations (3.17) of the DAE in water")
def full_wet_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By (3.17), with added mass."""
    table = integers(table_at, (TABLE_SIZE,))
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = before(t, y, dy, table)
    dy[len(dy) - 1] += full_accelerations(table[LINKED : TREE + 1], mass(table), *given(y, dy, table))
    dy[len(dy) - 1] += power_of_mass(table)
    after(table)
    return status
