"""The compiled equations of the DAE, as the integrators call them.

Rods alone and point masses have q = (z, b) of every one; rods that share nodes, and moved supports, that of
`dynamics.linked`; any structure as one system that of `dynamics.assembly`. Where joints close loops, how far they are
open is behind λ.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.assembly_equations import assembled_accelerations, place_assembly, project_assembly
from tensegrity_mj.dynamics.crowded import crowded_accelerations
from tensegrity_mj.dynamics.joint_forces import joint_accelerations, largest_gap, project_linked
from tensegrity_mj.dynamics.kernels import accelerations, normalize, place_nodes
from tensegrity_mj.dynamics.linked import place_linked
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import power_of, set_motions
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import TIMED, borrowing
from tensegrity_mj.dynamics.native.views import changing_view, fields_of
from tensegrity_mj.dynamics.touching import touching_accelerations
from tensegrity_mj.engines.reference.equations import MODEL, RODS, halves

_RodsView = changing_view("Rods", RODS)


@c_function(TIMED, "places of nodes in the DAE")
def dae_place(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _RodsView(table)
    place_nodes(*halves(own, y_at), own.rods, own.points, own.nodes, own.velocities)
    return SOLVED


@c_function(TIMED, "the equations of the DAE")
def dae_accelerate(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _RodsView(table)
    (q, rates), out = halves(own, y_at), halves(own, dy_at)[1]
    if own.wet_rods > 0:
        own.given += accelerations(own, q, rates, out, (own.added, own.held_mass))
    else:
        accelerations(own, q, rates, out, None)
    return SOLVED


@c_function(TIMED, "lengths kept by the DAE")
def dae_normalize(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """(3.23)-(3.24) on the state."""
    own = _RodsView(table)
    normalize(*halves(own, y_at), own.rods)
    return SOLVED


TOUCHING = fields_of(  # of rods and point masses that touch a floor
    RODS,
    floor="size",  # address of a `dynamics.contact.Floor`
)
_TouchingView = changing_view("Touching", TOUCHING)


@c_function(TIMED, "the equations of the DAE with contact")
def touching_accelerate(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _TouchingView(table)
    (q, rates), out = halves(own, y_at), halves(own, dy_at)[1]
    own.given += touching_accelerations(own, q, rates, out)
    return SOLVED


@c_function(TIMED, "the equations of the DAE with contact of rods")
def crowded_accelerate(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _TouchingView(table)
    (q, rates), out = halves(own, y_at), halves(own, dy_at)[1]
    own.given += crowded_accelerations(own, q, rates, out)
    return SOLVED


LINKED = fields_of(
    MODEL,
    linked="size",  # addresses of a `Linked` and a `Joints`
    joints="size",
    closure_count="size",
)
_LinkedView = changing_view("Linked", LINKED)


@borrowing
def report_gaps(own: Any) -> None:
    """Write how far closures are open behind the multipliers."""
    if own.closure_count > 0:
        R, observed = own.rod_count, own.multipliers
        observed[R], observed[R + 1] = largest_gap(own.linked, 0), largest_gap(own.linked, 1)


@c_function(TIMED, "places of nodes in the DAE for rods that share nodes")
def linked_place(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _LinkedView(table)
    set_motions(table, t)
    place_linked(own.linked, *halves(own, y_at), own.nodes, own.velocities)
    return SOLVED


@c_function(TIMED, "the equations of the DAE for rods that share nodes")
def linked_accelerate(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """Compute accelerations by joint forces, in O(K)."""
    own = _LinkedView(table)
    (q, rates), out = halves(own, y_at), halves(own, dy_at)[1]
    if own.wet_rods > 0:
        own.given += joint_accelerations(own, (own.added, own.held_mass), q, rates, out)
        own.given += power_of(own.held_mass, own.velocities)
    else:
        own.given += joint_accelerations(own, None, q, rates, out)
    report_gaps(own)
    return SOLVED


@c_function(TIMED, "joints kept closed by the DAE")
def linked_project(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """Lengths and closures of a state."""
    own = _LinkedView(table)
    q, rates = halves(own, y_at)
    set_motions(table, t)
    project_linked(own.linked, own.joints, q, rates, own.nodes, own.velocities)
    return SOLVED


ASSEMBLED = fields_of(
    MODEL,
    assembly="size",  # address of an `Assembly`
    constraint_count="size",
)
_AssembledView = changing_view("Assembled", ASSEMBLED)


@c_function(TIMED, "places of nodes in the DAE for any structure")
def assembled_place(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _AssembledView(table)
    set_motions(table, t)
    place_assembly(own.assembly, own.moved, *halves(own, y_at), own.nodes, own.velocities)
    return SOLVED


@c_function(TIMED, "the equations of the DAE for any structure")
def assembled_accelerate(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _AssembledView(table)
    (q, rates), out = halves(own, y_at), halves(own, dy_at)[1]
    if own.wet_rods > 0:
        power = assembled_accelerations(own, (own.added, own.held_mass), q, rates, out)
        own.given += power + power_of(own.held_mass, own.velocities)
    else:
        own.given += assembled_accelerations(own, None, q, rates, out)
    return SOLVED


@c_function(TIMED, "constraints kept by the DAE for any structure")
def assembled_project(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _AssembledView(table)
    set_motions(table, t)
    project_assembly(own.assembly, own.moved, *halves(own, y_at))
    return SOLVED
