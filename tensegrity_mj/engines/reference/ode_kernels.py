"""The compiled equations of the minimal model, as the integrators call them, and where its coordinates end.

q = (z, β) of every rod and point mass. A rod whose support moves by d(t) is one at rest in a frame that moves so: its
anchor is displaced, ḋ is added to the velocities of its nodes, and -d̈ times its share of the mass acts on either of
them: what its inertia amounts to.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.minimal import (
    minimal_accelerations,
    node_accelerations,
    place_minimal,
    wet_minimal_accelerations,
)
from tensegrity_mj.dynamics.native.compiling import c_function, njit
from tensegrity_mj.dynamics.native.elements import set_motions
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import TIMED
from tensegrity_mj.dynamics.native.vectors import add, plus, put, row_of, times
from tensegrity_mj.dynamics.native.views import changing_view, fields_of
from tensegrity_mj.engines.reference.equations import OUTSIDE, RODS, SINGULAR, halves

MINIMAL = fields_of(
    RODS,
    least_sine="real",
    last_singular="state",  # the rod, and one of the reasons below
    reason="state",
    carried=("i8", "motion_count", 2),  # of each motion: row of its rod or -1, row of its node or -1
    bases=("f8", "motion_count", 3),  # where they are without it
)
_MinimalView = changing_view("Minimal", MINIMAL)

NEAR_POLE, ACROSS_POLE, TURNS_TOO_FAR = 1, 2, 3  # reasons

# θ turns the frame (e_θ, e_φ) about b by θ̇ cos φ a second, which is the rod's own ω cot φ near a pole. A fixed step h
# errs there by (h θ̇)⁴ instead of (h ω)⁴: it is refused where a step turns the frame by more than MAX_TURN (1e-4 to the
# fourth power) although the rod itself turns OWN_PART of that at most.
MAX_TURN = 0.1  # rad
OWN_PART = 1.0 / 3.0


@njit
def singular_rod(q: Any, rates: Any, rods: Any, least_sine: float, step: float) -> tuple[int, int]:
    """The first rod whose angles are beyond a pole, at one, or turn too far in a step, and why; (-1, 0) for none."""
    for a in range(len(rods)):
        rod = rods[a]
        if rod.nb == 2:
            continue
        at = rod.q + rod.nz
        phi, turn, tilt = q[at + 1], rates[at], rates[at + 1]
        if phi < 0.0 or phi > np.pi:
            return a, ACROSS_POLE
        sine = np.sin(phi)
        if sine < least_sine:
            return a, NEAR_POLE
        if step > 0.0:
            frame = abs(turn * np.cos(phi))
            own = np.hypot(sine * turn, tilt)
            if frame * step > MAX_TURN and own < OWN_PART * frame:
                return a, TURNS_TOO_FAR
    return -1, 0


@njit
def _check(q: Any, rates: Any, table: int, least_sine: float) -> int:
    own = _MinimalView(table)
    rod, reason = singular_rod(q, rates, own.rods, least_sine, own.step)
    if rod < 0:
        return SOLVED
    own.last_singular, own.reason = rod, reason
    return SINGULAR


@njit
def carry_nodes(t: float, table: int) -> None:
    """Displace the anchors of the rods whose supports move, to where they are at time t."""
    set_motions(table, t)
    own = _MinimalView(table)
    rods, carried, bases, moved = own.rods, own.carried, own.bases, own.moved
    for a in range(len(carried)):
        if carried[a, 0] >= 0:
            rods[carried[a, 0]].anchor[:] = bases[a] + moved[a, 0]


@njit
def carry_velocities(table: int) -> None:
    """Add the supports' velocities to those of the nodes that they carry; place the fixed nodes that move."""
    own = _MinimalView(table)
    rods, carried, bases, moved = own.rods, own.carried, own.bases, own.moved
    nodes, velocities = own.nodes, own.velocities
    for a in range(len(carried)):
        rate = row_of(moved[a], 1)
        if carried[a, 0] >= 0:
            add(velocities, rods[carried[a, 0]].i, rate)
            add(velocities, rods[carried[a, 0]].j, rate)
        else:
            put(nodes, carried[a, 1], plus(row_of(bases, a), row_of(moved[a], 0)))
            put(velocities, carried[a, 1], rate)


@njit
def add_inertia_of_supports(table: int) -> None:
    """Add the inertia forces that accelerated supports cause in the rods that they carry to those on the nodes."""
    own = _MinimalView(table)
    rods, carried, moved, forces = own.rods, own.carried, own.moved, own.forces
    for a in range(len(carried)):
        if carried[a, 0] >= 0:
            rod, acceleration = rods[carried[a, 0]], row_of(moved[a], 2)
            add(forces, rod.i, times(-(1.0 - rod.center) * rod.mass, acceleration))
            add(forces, rod.j, times(-rod.center * rod.mass, acceleration))


@njit
def power_of_supports(q: Any, rates: Any, accelerations: Any, table: int) -> float:
    """Power [W] of what moves the supports, with the forces and accelerations of the moving frames."""
    own = _MinimalView(table)
    rods, carried, moved, forces, gravity = own.rods, own.carried, own.moved, own.forces, own.gravity
    nodes = np.zeros((own.node_count, 3))
    node_accelerations(q, rates, accelerations, rods, own.points, nodes)
    power = 0.0
    for a in range(len(carried)):
        for k in range(3):
            if carried[a, 0] >= 0:
                rod = rods[carried[a, 0]]
                middle = (1.0 - rod.center) * nodes[rod.i, k] + rod.center * nodes[rod.j, k]
                need = rod.mass * (middle - gravity[k])
                power += (need - forces[rod.i, k] - forces[rod.j, k]) * moved[a, 1, k]
            else:
                power -= forces[carried[a, 1], k] * moved[a, 1, k]
    return power


@c_function(TIMED, "places of nodes in the ODE")
def ode_place(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """Place the nodes of a state; return OUTSIDE where a stage is beyond a pole.

    A fixed step cannot shorten itself: there every stage is held to what `ode_guard` requires of whole steps.
    """
    own = _MinimalView(table)
    q, rates = halves(own, y_at)
    found = _check(q, rates, table, own.least_sine if own.step > 0.0 else 1e-300)
    if own.motion_count > 0:
        carry_nodes(t, table)
    place_minimal(q, rates, own.rods, own.points, own.nodes, own.velocities)
    if own.motion_count > 0:
        carry_velocities(table)
    return OUTSIDE if found == SINGULAR and own.reason == ACROSS_POLE else found


@c_function(TIMED, "the equations of the ODE")
def ode_accelerate(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """Forces of added mass join those on the nodes once they are known."""
    own = _MinimalView(table)
    (q, rates), out = halves(own, y_at), halves(own, dy_at)[1]
    if own.motion_count > 0:
        add_inertia_of_supports(table)
    if own.wet_rods > 0:
        drives, carried, moved = np.zeros((own.rod_count, 3)), own.carried, own.moved
        for a in range(len(carried)):
            if carried[a, 0] >= 0:
                drives[carried[a, 0]] = moved[a, 2]
        wet_minimal_accelerations(own, q, rates, drives, out)
        forces, velocities, held = own.forces, own.velocities, own.held_mass
        for n in range(len(forces)):
            for k in range(3):
                forces[n, k] += held[n, k]
                own.given += held[n, k] * velocities[n, k]
    else:
        minimal_accelerations(own, q, rates, out)
    if own.motion_count > 0:
        own.given += power_of_supports(q, rates, out, table)
    return SOLVED


@c_function(TIMED, "poles of the ODE's angles")
def ode_guard(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    own = _MinimalView(table)
    q, rates = halves(own, y_at)
    return _check(q, rates, table, own.least_sine)
