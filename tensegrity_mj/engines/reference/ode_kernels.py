"""The compiled equations of the minimal model, as the integrators call them, and where its coordinates end.

State y: q = (z, β) of every rod and point mass, q̇, the time where supports move, and the work integrals of the energy
ledger.

A rod whose support moves by d(t) is one at rest in a frame that moves so: its anchor is displaced, ḋ is added to the
velocities of its nodes, and -m d̈/2 acts on either of them, which is what a uniform rod's inertia amounts to.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.minimal import minimal_accelerations, node_accelerations, place_minimal
from tensegrity_mj.dynamics.native.compiling import c_function, njit
from tensegrity_mj.dynamics.native.elements import set_motions
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import floats, integers, records_reader
from tensegrity_mj.dynamics.native.slots import (
    ADDED,
    FORCES,
    HELD_MASS,
    MOTION_COUNT,
    MOVED,
    NODE_COUNT,
    NODES,
    TABLE_SIZE,
    VELOCITIES,
)
from tensegrity_mj.dynamics.records import POINT, ROD
from tensegrity_mj.dynamics.wet_minimal import wet_minimal_accelerations
from tensegrity_mj.engines.reference.equations import (
    MODEL_SLOTS,
    MULTIPLIERS,
    RATES_SIGNATURE,
    SINGULAR,
    STATE_SIGNATURE,
    STATE_SIZE,
    WORK,
    let_forces_act,
)

RODS, ROD_COUNT, POINTS, POINT_COUNT, Q_SIZE, CONSTANTS, LAST_SINGULAR, REASON = range(MODEL_SLOTS, MODEL_SLOTS + 8)
CARRIED, BASES = MODEL_SLOTS + 8, MODEL_SLOTS + 9  # (m, 2) of each motion: rod row or -1, node row or -1; (m, 3) places
_read_rods, _read_points = records_reader(ROD), records_reader(POINT)

# Constants: gravity (3,), the least sin φ, the fixed step [s] or 0.
GRAVITY, LEAST_SINE, STEP = 0, 3, 4
NEAR_POLE, ACROSS_POLE, TURNS_TOO_FAR = 1, 2, 3  # reasons
ACROSS = -1  # of `_before`, which has found no forces then

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
def _check(y: Any, table: Any, least_sine: float) -> int:
    nq = table[Q_SIZE]
    constants = floats(table[CONSTANTS], (5,))
    rods = _read_rods(table[RODS], table[ROD_COUNT])
    rod, reason = singular_rod(y[:nq], y[nq : 2 * nq], rods, least_sine, constants[STEP])
    if rod < 0:
        return SOLVED
    table[LAST_SINGULAR], table[REASON] = rod, reason
    return SINGULAR


@njit
def carry_nodes(t: float, table: Any) -> None:
    """Displace the anchors of the rods whose supports move, to where they are at time t."""
    set_motions(table, t)
    m = table[MOTION_COUNT]
    rods, carried = _read_rods(table[RODS], table[ROD_COUNT]), integers(table[CARRIED], (m, 2))
    bases, moved = floats(table[BASES], (m, 3)), floats(table[MOVED], (m, 3, 3))
    for a in range(m):
        if carried[a, 0] >= 0:
            for k in range(3):
                rods[carried[a, 0]].anchor[k] = bases[a, k] + moved[a, 0, k]


@njit
def carry_velocities(table: Any) -> None:
    """Add the supports' velocities to those of the nodes that they carry; place the fixed nodes that move."""
    N, m = table[NODE_COUNT], table[MOTION_COUNT]
    rods, carried = _read_rods(table[RODS], table[ROD_COUNT]), integers(table[CARRIED], (m, 2))
    bases, moved = floats(table[BASES], (m, 3)), floats(table[MOVED], (m, 3, 3))
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    for a in range(m):
        for k in range(3):
            if carried[a, 0] >= 0:
                velocities[rods[carried[a, 0]].i, k] += moved[a, 1, k]
                velocities[rods[carried[a, 0]].j, k] += moved[a, 1, k]
            else:
                nodes[carried[a, 1], k] = bases[a, k] + moved[a, 0, k]
                velocities[carried[a, 1], k] = moved[a, 1, k]


@njit
def add_inertia_of_supports(table: Any) -> None:
    """What the accelerations of the supports do to the rods that they carry, as forces on the nodes."""
    N, m = table[NODE_COUNT], table[MOTION_COUNT]
    rods, carried = _read_rods(table[RODS], table[ROD_COUNT]), integers(table[CARRIED], (m, 2))
    moved, forces = floats(table[MOVED], (m, 3, 3)), floats(table[FORCES], (N, 3))
    for a in range(m):
        if carried[a, 0] >= 0:
            rod = rods[carried[a, 0]]
            for k in range(3):
                forces[rod.i, k] -= 0.5 * rod.mass * moved[a, 2, k]
                forces[rod.j, k] -= 0.5 * rod.mass * moved[a, 2, k]


@njit
def power_of_supports(q: Any, rates: Any, accelerations: Any, table: Any) -> float:
    """Power [W] of what moves the supports, with the forces and accelerations of the moving frames."""
    N, m = table[NODE_COUNT], table[MOTION_COUNT]
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    carried, moved = integers(table[CARRIED], (m, 2)), floats(table[MOVED], (m, 3, 3))
    forces, gravity = floats(table[FORCES], (N, 3)), floats(table[CONSTANTS], (3,))
    nodes = np.zeros((N, 3))
    node_accelerations(q, rates, accelerations, rods, points, nodes)
    power = 0.0
    for a in range(m):
        for k in range(3):
            if carried[a, 0] >= 0:
                rod = rods[carried[a, 0]]
                need = rod.mass * (0.5 * (nodes[rod.i, k] + nodes[rod.j, k]) - gravity[k])
                power += (need - forces[rod.i, k] - forces[rod.j, k]) * moved[a, 1, k]
            else:
                power -= forces[carried[a, 1], k] * moved[a, 1, k]
    return power


@njit
def _before(t: float, y: Any, dy: Any, table: Any) -> int:
    """Everything but the accelerations; the answer.

    A fixed step cannot shorten itself: there every stage is held to what `ode_guard` asks of whole steps.
    """
    N, nq, work = table[NODE_COUNT], table[Q_SIZE], len(y) - WORK
    constants = floats(table[CONSTANTS], (5,))
    singular = _check(y, table, constants[LEAST_SINE] if constants[STEP] > 0.0 else 1e-300)
    if singular == SINGULAR and table[REASON] == ACROSS_POLE:
        return ACROSS
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    moves = table[MOTION_COUNT] > 0
    if moves:
        carry_nodes(t, table)
    place_minimal(y[:nq], y[nq : 2 * nq], rods, points, nodes, velocities)
    if moves:
        carry_velocities(table)
    status = let_forces_act(t, dy[work : work + 3], table)
    if moves:
        add_inertia_of_supports(table)
    dy[:nq] = y[nq : 2 * nq]
    return max(status, singular)


@njit
def _after(y: Any, dy: Any, table: Any) -> None:
    """Time, and what moves the supports."""
    nq = table[Q_SIZE]
    if table[MOTION_COUNT] > 0:
        dy[2 * nq] = 1.0
        dy[len(y) - 1] += power_of_supports(y[:nq], y[nq : 2 * nq], dy[nq : 2 * nq], table)


@c_function(RATES_SIGNATURE, "the equations of the ODE")
def ode_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    N, nq, size = table[NODE_COUNT], table[Q_SIZE], table[STATE_SIZE]
    y, dy = floats(y_at, (size,)), floats(dy_at, (size,))
    status = _before(t, y, dy, table)
    if status == ACROSS:
        return SINGULAR
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    minimal_accelerations(
        y[:nq],
        y[nq : 2 * nq],
        floats(table[FORCES], (N, 3)),
        rods,
        points,
        floats(table[CONSTANTS], (5,)),
        dy[nq : 2 * nq],
        floats(table[MULTIPLIERS], (len(rods),)),
    )
    _after(y, dy, table)
    return status


@c_function(RATES_SIGNATURE, "the equations of the ODE in water")
def ode_wet_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """With added mass, whose forces join those on the nodes once they are known."""
    table = integers(table_at, (TABLE_SIZE,))
    N, nq, size = table[NODE_COUNT], table[Q_SIZE], table[STATE_SIZE]
    y, dy = floats(y_at, (size,)), floats(dy_at, (size,))
    status = _before(t, y, dy, table)
    if status == ACROSS:
        return SINGULAR
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    R, m = len(rods), table[MOTION_COUNT]
    drives, carried = np.zeros((R, 3)), integers(table[CARRIED], (m, 2))
    moved = floats(table[MOVED], (m, 3, 3))
    for a in range(m):
        if carried[a, 0] >= 0:
            drives[carried[a, 0]] = moved[a, 2]
    forces, velocities = floats(table[FORCES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    held = floats(table[HELD_MASS], (N, 3))
    wet_minimal_accelerations(
        y[:nq],
        y[nq : 2 * nq],
        forces,
        rods,
        points,
        floats(table[CONSTANTS], (5,)),
        (floats(table[ADDED], (R, 4)), drives),
        (held, floats(table[MULTIPLIERS], (R,))),
        dy[nq : 2 * nq],
    )
    for n in range(N):
        for k in range(3):
            forces[n, k] += held[n, k]
            dy[size - 1] += held[n, k] * velocities[n, k]
    _after(y, dy, table)
    return status


@c_function(STATE_SIGNATURE, "places of nodes in the ODE")
def ode_place(y_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    N, nq = table[NODE_COUNT], table[Q_SIZE]
    y = floats(y_at, (table[STATE_SIZE],))
    rods, points = _read_rods(table[RODS], table[ROD_COUNT]), _read_points(table[POINTS], table[POINT_COUNT])
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    if table[MOTION_COUNT] > 0:
        carry_nodes(y[2 * nq], table)
    place_minimal(y[:nq], y[nq : 2 * nq], rods, points, nodes, velocities)
    if table[MOTION_COUNT] > 0:
        carry_velocities(table)
    return SOLVED


@c_function(STATE_SIGNATURE, "poles of the ODE's angles")
def ode_guard(y_at, table_at):  # type: ignore[no-untyped-def]
    table = integers(table_at, (TABLE_SIZE,))
    y = floats(y_at, (2 * table[Q_SIZE],))
    return _check(y, table, floats(table[CONSTANTS], (5,))[LEAST_SINE])
