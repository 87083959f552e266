"""The compiled equations of any structure as one system, as the integrators call them.

State y: q and q̇ of `dynamics.assembly`, the time where supports move, and the work integrals of the energy ledger.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.assembly_equations import (
    assembled_accelerations,
    place_assembly,
    project_assembly,
)
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import power_of, set_motions
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import floats, owning
from tensegrity_mj.dynamics.native.views import Fields, changing_view
from tensegrity_mj.engines.reference.equations import MODEL, RATES_SIGNATURE, STATE_SIGNATURE, WORK, let_forces_act

ASSEMBLED: Fields = (
    *MODEL,
    ("coordinates", "size"),
    ("assembly", "size"),  # address of an `Assembly`
    ("constraint_count", "size"),
    ("gravity", ("f8", 3)),
    ("kp", "real"),  # Baumgarte's gains of (3.25), for all constraints, or zero
    ("kd", "real"),
)
_AssembledView = changing_view("Assembled", ASSEMBLED)


@owning
def _place(t: float, y: Any, table: int) -> None:
    own = _AssembledView(table)
    nq = own.coordinates
    set_motions(table, t)
    place_assembly(own.assembly, own.moved, y[:nq], y[nq : 2 * nq], own.nodes, own.velocities)


@owning
def _before(t: float, y: Any, dy: Any, table: int) -> int:
    """Everything but the accelerations; the law's answer."""
    own = _AssembledView(table)
    nq, work = own.coordinates, len(y) - WORK
    _place(t, y, table)
    dy[:nq] = y[nq : 2 * nq]
    if own.motion_count > 0:
        dy[2 * nq] = 1.0
    return let_forces_act(t, dy[work:], table)


@c_function(RATES_SIGNATURE, "the equations of the DAE for any structure")
def assembled_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _AssembledView(table)
    nq, y, dy = own.coordinates, floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = _before(t, y, dy, table)
    dy[len(dy) - 1] += assembled_accelerations(own, None, y[:nq], y[nq : 2 * nq], dy[nq : 2 * nq])
    return status


@c_function(RATES_SIGNATURE, "the equations of the DAE in water for any structure")
def assembled_wet_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """With added mass."""
    own = _AssembledView(table)
    nq, y, dy = own.coordinates, floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = _before(t, y, dy, table)
    added = (own.added, own.held_mass)
    power = assembled_accelerations(own, added, y[:nq], y[nq : 2 * nq], dy[nq : 2 * nq])
    dy[len(dy) - 1] += power + power_of(own.held_mass, own.velocities)
    return status


@c_function(STATE_SIGNATURE, "places of nodes in the DAE for any structure")
def assembled_place(y_at, table):  # type: ignore[no-untyped-def]
    own = _AssembledView(table)
    y = floats(y_at, own.state_size)
    _place(y[2 * own.coordinates], y, table)
    return SOLVED


@c_function(STATE_SIGNATURE, "constraints kept by the DAE for any structure")
def assembled_project(y_at, table):  # type: ignore[no-untyped-def]
    own = _AssembledView(table)
    nq, y = own.coordinates, floats(y_at, own.state_size)
    set_motions(table, y[2 * nq])
    project_assembly(own.assembly, own.moved, y[:nq], y[nq : 2 * nq])
    return SOLVED
