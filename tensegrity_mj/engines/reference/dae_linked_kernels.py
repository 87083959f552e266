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
from tensegrity_mj.dynamics.native.elements import power_of, set_motions
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import borrowing, floats, inlined
from tensegrity_mj.dynamics.native.views import Fields, changing_view
from tensegrity_mj.dynamics.tree_equations import dense_accelerations, full_accelerations
from tensegrity_mj.engines.reference.equations import MODEL, RATES_SIGNATURE, STATE_SIGNATURE, WORK, let_forces_act

LINKED: Fields = (
    *MODEL,
    ("coordinates", "size"),
    ("linked", "size"),  # addresses of a `Linked`, a `Joints` and a `Tree`
    ("joints", "size"),
    ("tree", "size"),
    ("gravity", ("f8", 3)),
    ("kp", "real"),  # Baumgarte's gains of (3.25) for lengths and closures, or zero
    ("kd", "real"),
    ("closure_count", "size"),
)
_LinkedView = changing_view("Linked", LINKED)


@borrowing
def place_at(t: float, y: Any, table: int) -> None:
    """Motions, nodes and velocities of a state at a time."""
    own = _LinkedView(table)
    nq = own.coordinates
    set_motions(table, t)
    place_linked(own.linked, y[:nq], y[nq : 2 * nq], own.nodes, own.velocities)


@borrowing
def before(t: float, y: Any, dy: Any, table: int) -> int:
    """Everything but the accelerations; the law's answer."""
    own = _LinkedView(table)
    nq, work = own.coordinates, len(y) - WORK
    place_at(t, y, table)
    status = let_forces_act(t, dy[work : work + 3], table)
    for k in range(nq):
        dy[k] = y[nq + k]
    if own.motion_count > 0:
        dy[2 * nq] = 1.0
    return status


@borrowing
def after(dy: Any, power: float, table: int) -> None:
    """The power of what moves supports, and the gaps of closures behind λ."""
    own = _LinkedView(table)
    dy[len(dy) - 1] += power
    if own.closure_count > 0:
        R, observed = own.rod_count, own.multipliers
        observed[R], observed[R + 1] = largest_gap(own.linked, 0), largest_gap(own.linked, 1)


@inlined
def given(own: Any, y: Any, dy: Any) -> Any:
    """What the accelerations are found from, and where they go: the last arguments of `joint_accelerations`."""
    nq = own.coordinates
    return y[:nq], y[nq : 2 * nq], dy[nq : 2 * nq]


@inlined
def mass(own: Any) -> Any:
    """α of the rods, and where the forces of the added mass go."""
    return own.added, own.held_mass


@c_function(RATES_SIGNATURE, "the equations of the DAE for rods that share nodes")
def linked_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """By joint forces, in O(K)."""
    own = _LinkedView(table)
    y, dy = floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = before(t, y, dy, table)
    after(dy, joint_accelerations(own, None, *given(own, y, dy)), table)
    return status


@c_function(RATES_SIGNATURE, "the equations of the DAE in water for rods that share nodes")
def linked_wet_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """By joint forces, with added mass."""
    own = _LinkedView(table)
    y, dy = floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = before(t, y, dy, table)
    after(dy, joint_accelerations(own, mass(own), *given(own, y, dy)), table)
    dy[len(dy) - 1] += power_of(own.held_mass, own.velocities)
    return status


@c_function(RATES_SIGNATURE, "the equations (3.19) to (3.22) of the DAE")
def dense_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """By (3.19)-(3.22)."""
    own = _LinkedView(table)
    y, dy = floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = before(t, y, dy, table)
    after(dy, dense_accelerations(own, *given(own, y, dy)), table)
    return status


@c_function(RATES_SIGNATURE, "the equations (3.17) of the DAE")
def full_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """By (3.17)."""
    own = _LinkedView(table)
    y, dy = floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = before(t, y, dy, table)
    after(dy, full_accelerations(own, None, *given(own, y, dy)), table)
    return status


@c_function(RATES_SIGNATURE, "the equations (3.17) of the DAE in water")
def full_wet_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """By (3.17), with added mass."""
    own = _LinkedView(table)
    y, dy = floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = before(t, y, dy, table)
    after(dy, full_accelerations(own, mass(own), *given(own, y, dy)), table)
    dy[len(dy) - 1] += power_of(own.held_mass, own.velocities)
    return status


@c_function(STATE_SIGNATURE, "places of nodes in the DAE for rods that share nodes")
def linked_place(y_at, table):  # type: ignore[no-untyped-def]
    own = _LinkedView(table)
    y = floats(y_at, own.state_size)
    place_at(y[2 * own.coordinates], y, table)
    return SOLVED


@c_function(STATE_SIGNATURE, "joints kept closed by the DAE")
def linked_project(y_at, table):  # type: ignore[no-untyped-def]
    """Lengths and closures of a state."""
    own = _LinkedView(table)
    nq, y = own.coordinates, floats(y_at, own.state_size)
    set_motions(table, y[2 * nq])
    project_linked(own.linked, own.joints, y[:nq], y[nq : 2 * nq], own.nodes, own.velocities)
    return SOLVED
