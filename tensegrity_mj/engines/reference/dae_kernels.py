"""The compiled equations of rods alone and point masses, as the integrators call them: q = (z, b) of every one."""

from __future__ import annotations

from tensegrity_mj.dynamics.kernels import accelerations, normalize, place_nodes
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import TIMED
from tensegrity_mj.dynamics.native.views import changing_view
from tensegrity_mj.engines.reference.equations import RODS, halves

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
