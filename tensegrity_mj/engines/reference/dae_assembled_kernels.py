"""The compiled equations of any structure as one system, as the integrators call them; q as in `dynamics.assembly`."""

from __future__ import annotations

from tensegrity_mj.dynamics.assembly_equations import assembled_accelerations, place_assembly, project_assembly
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import power_of, set_motions
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import TIMED
from tensegrity_mj.dynamics.native.views import changing_view, fields_of
from tensegrity_mj.engines.reference.equations import MODEL, halves

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
