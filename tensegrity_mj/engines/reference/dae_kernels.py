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
    accelerations(own, *halves(own, y_at), own.forces, halves(own, dy_at)[1], own.multipliers, None)
    return SOLVED


@c_function(TIMED, "the equations of the DAE in water")
def dae_wet_accelerate(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """With added mass."""
    own = _RodsView(table)
    added = (own.added, own.held_mass)
    q, rates = halves(own, y_at)
    own.given += accelerations(own, q, rates, own.forces, halves(own, dy_at)[1], own.multipliers, added)
    return SOLVED


@c_function(TIMED, "lengths kept by the DAE")
def dae_normalize(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """(3.23)-(3.24) on the state."""
    own = _RodsView(table)
    normalize(*halves(own, y_at), own.rods)
    return SOLVED
