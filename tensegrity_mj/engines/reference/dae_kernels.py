"""The compiled equations of the reference engine, as the integrators call them.

State y: q = (z, b) of every rod and point mass, q̇, and the work integrals of the energy ledger.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.kernels import accelerations, normalize, place_nodes
from tensegrity_mj.dynamics.native.compiling import c_function, njit
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import floats
from tensegrity_mj.dynamics.native.views import Fields, changing_view
from tensegrity_mj.dynamics.records import POINT, ROD
from tensegrity_mj.dynamics.wet_rods import wet_accelerations
from tensegrity_mj.engines.reference.equations import MODEL, RATES_SIGNATURE, STATE_SIGNATURE, let_forces_act

RODS: Fields = (
    *MODEL,
    ("coordinates", "size"),
    ("rods", (ROD, "rod_count")),
    ("point_count", "size"),
    ("points", (POINT, "point_count")),
    ("gravity", ("f8", 3)),
    ("kp", "real"),  # Baumgarte's gains of (3.25), or zero
    ("kd", "real"),
)
_RodsView = changing_view("Rods", RODS)


@njit
def _before(t: float, y: Any, dy: Any, table: int) -> int:
    """Everything but the accelerations; the law's answer."""
    own = _RodsView(table)
    nq = own.coordinates
    place_nodes(y[:nq], y[nq : 2 * nq], own.rods, own.points, own.nodes, own.velocities)
    dy[:nq] = y[nq : 2 * nq]
    return let_forces_act(t, dy[2 * nq : 2 * nq + 3], table)


@c_function(RATES_SIGNATURE, "the equations of the DAE")
def dae_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _RodsView(table)
    nq, y, dy = own.coordinates, floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = _before(t, y, dy, table)
    accelerations(own, y[:nq], y[nq : 2 * nq], own.forces, dy[nq : 2 * nq], own.multipliers)
    return status


@c_function(RATES_SIGNATURE, "the equations of the DAE in water")
def dae_wet_rates(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """With added mass."""
    own = _RodsView(table)
    nq, y, dy = own.coordinates, floats(y_at, own.state_size), floats(dy_at, own.state_size)
    status = _before(t, y, dy, table)
    q, rates, out = y[:nq], y[nq : 2 * nq], dy[nq : 2 * nq]
    dy[2 * nq + 2] += wet_accelerations(own, q, rates, own.forces, own.added, out, own.multipliers)
    return status


@c_function(STATE_SIGNATURE, "places of nodes in the DAE")
def dae_place(y_at, table):  # type: ignore[no-untyped-def]
    own = _RodsView(table)
    nq, y = own.coordinates, floats(y_at, own.state_size)
    place_nodes(y[:nq], y[nq : 2 * nq], own.rods, own.points, own.nodes, own.velocities)
    return SOLVED


@c_function(STATE_SIGNATURE, "lengths kept by the DAE")
def dae_normalize(y_at, table):  # type: ignore[no-untyped-def]
    """(3.23)-(3.24) on the state."""
    own = _RodsView(table)
    nq, y = own.coordinates, floats(y_at, own.state_size)
    normalize(y[:nq], y[nq : 2 * nq], own.rods)
    return SOLVED
