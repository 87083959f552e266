"""The errors of minimal coordinates and the linear equation of feedback linearization for the strings, compiled.

`feedback_linearization` has the equations and their coordinates q = (z, β) of every rod.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.dynamics.kernels import rod_accelerations, wet_rod_accelerations
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.elements import known_forces
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import inlined
from tensegrity_mj.dynamics.native.strings import share, string_length
from tensegrity_mj.dynamics.native.vectors import ZERO, column_of, dot, minus, over, plus, row_of, times, vector
from tensegrity_mj.dynamics.target import Aim, point_target, rod_target

# Part of K_p times a coordinate: a smaller error counts as zero. Strings can only pull, so that at a target that
# needs none of them, noise of the wrong sign would have no solution.
ROUND_OFF = 8 * float(np.finfo(float).eps)
POLE = 1e-6  # sin φ below which (θ, φ) do not define where a rod points


class Angles(NamedTuple):
    """β of a rod with its rate, and P, c of β̈ = P b̈ + c, by angle; a planar rod uses the first.

    P = (WᵀW)⁻¹Wᵀ, c = -P Ẇβ̇ (§2.3); `defined` is False at a pole.
    """

    beta: Any
    rate: Any
    P: Any
    c: Any
    defined: bool


@njit
def angles(rod: Any, b: Any, b_rate: Any) -> Angles:
    """Compute the angles of a direction b and their rates; a planar rod has one, from basis vector 1 towards 2."""
    if rod.nb == 2:
        first, second = column_of(rod.B, 0), column_of(rod.B, 1)
        x, y, x_rate, y_rate = dot(first, b), dot(second, b), dot(first, b_rate), dot(second, b_rate)
        square = x * x + y * y
        rate = (x * y_rate - y * x_rate) / square
        P = over(minus(times(x, second), times(y, first)), square)
        c = -2.0 * rate * (x * x_rate + y * y_rate) / square
        return Angles((np.arctan2(y, x), 0.0), (rate, 0.0), (P, ZERO), (c, 0.0), True)
    across = np.sqrt(b[0] * b[0] + b[1] * b[1])
    length = np.sqrt(across * across + b[2] * b[2])
    sin, cos = across / length, b[2] / length
    if not sin > POLE:
        return Angles((0.0, 0.0), (0.0, 0.0), (ZERO, ZERO), (0.0, 0.0), False)
    sin_theta, cos_theta = b[1] / across, b[0] / across
    turn = (-sin_theta / across, cos_theta / across, 0.0)
    tilt = (cos * cos_theta / length, cos * sin_theta / length, -sin / length)
    theta_rate, phi_rate = dot(turn, b_rate), dot(tilt, b_rate)
    c = (-2.0 * cos / sin * theta_rate * phi_rate, sin * cos * theta_rate * theta_rate)
    beta = (np.arctan2(b[1], b[0]), np.arctan2(across, b[2]))
    return Angles(beta, (theta_rate, phi_rate), (turn, tilt), c, True)


@njit
def _accelerations(rod: Any, b: Any, c: float, t_r: Any, t_b: Any, added: Any, effects: int) -> Any:
    return rod_accelerations(rod, b, c, t_r, t_b) if effects == 0 else wet_rod_accelerations(rod, b, c, t_r, t_b, added)


class Known(NamedTuple):
    """Structure, target and surroundings as the law knows them, for compiled code.

    Attributes:
        rods, points: `StructureRecords`.
        segments, ranges: (S, 2) their nodes, and (M, 2) those of each string.
        target: address of an `Aim`.
        gravity: (3,) [m/s²].
        effects: address of what else acts, see `known_forces`; 0 for nothing.
        gains: (2, n): K_p and K_d.
    """

    rods: Any
    points: Any
    segments: Any
    ranges: Any
    target: int
    gravity: Any
    effects: int
    gains: Any


@inlined
def _size(E: Any, r: Any, aim: Any) -> float:
    """Σ |E_k| (|r_k| + |aim_k|): what Eᵀ(r - aim) is a difference of."""
    size = 0.0
    for k in range(3):
        size += abs(E[k]) * (abs(r[k]) + abs(aim[k]))
    return size


@inlined
def _set_error(i: int, error: float, rate: float, needed: float, size: float, gains: Any, e: Any, d: Any) -> None:
    """Write the error of a coordinate with its rate, and the q̈ that the strings must add."""
    e[0, i], e[1, i] = error, rate
    d[i] = needed - (gains[0, i] * error + gains[1, i] * rate)
    if abs(d[i]) <= ROUND_OFF * gains[0, i] * size:
        d[i] = 0.0


@njit
def error_equation(t: float, nodes: Any, velocities: Any, known: Known, A: Any, d: Any, e: Any) -> int:
    """(4.9) as A u = d, and the errors e (2, n) with their rates; A (n, M), d and e are written.

    Returns:
        -1, or the number of a rod whose b, or whose target's b, is at a pole; -2 where what is known of failed.
    """
    rods, points, target, gains = known.rods, known.points, Aim(known.target), known.gains
    gravity, effects, segments, ranges = known.gravity, known.effects, known.segments, known.ranges
    A[:] = 0.0
    count, g = len(rods), vector(gravity)
    pull = np.zeros((count, 2, 5, 3))  # q̈ of each rod for a force on its first and on its second node
    owner = np.full((len(nodes), 2), -1)  # which rod (or point mass, from `count` on) a node is of, and which end
    start = np.empty(count + len(points), np.int64)
    pushed, added = np.zeros((len(nodes), 3)), np.zeros((count, 4))
    if effects != 0 and known_forces(effects, t, nodes, velocities, pushed, added) != SOLVED:
        return -2
    at = 0
    for a in range(count):
        rod = rods[a]
        start[a] = at
        owner[rod.i, 0], owner[rod.i, 1] = a, 0
        owner[rod.j, 0], owner[rod.j, 1] = a, 1
        ahead, back = (1.0 - rod.sigma) * rod.length, rod.sigma * rod.length
        first, first_rate = row_of(nodes, rod.i), row_of(velocities, rod.i)
        b = over(minus(row_of(nodes, rod.j), first), rod.length)
        b_rate = over(minus(row_of(velocities, rod.j), first_rate), rod.length)
        r, r_rate = plus(first, times(back, b)), plus(first_rate, times(back, b_rate))
        push_i, push_j = row_of(pushed, rod.i), row_of(pushed, rod.j)
        t_r = plus(plus(times(rod.mass, g), push_i), push_j)
        t_b = minus(plus(times(rod.f, g), times(ahead, push_j)), times(back, push_i))
        r_aim, b_aim = rod_target(rod, t, target)
        now, aim = angles(rod, b, b_rate), angles(rod, b_aim[0], b_aim[1])
        if not (now.defined and aim.defined):
            return a
        # q̈ without strings, M⁻¹ g, weight and what is known of included.
        own = (0.0, 0.0, 0.0, 0.0)
        if effects != 0:
            own = (added[a, 0], added[a, 1], added[a, 2], added[a, 3])
        r_acc, b_acc = _accelerations(rod, b, dot(b_rate, b_rate) / dot(b, b), t_r, t_b, own, effects)
        for p in range(rod.nz):
            E, needed = column_of(rod.E, p), minus(r_aim[2], r_acc)
            error, rate = dot(E, minus(r, r_aim[0])), dot(E, minus(r_rate, r_aim[1]))
            _set_error(at + p, error, rate, dot(E, needed), _size(E, r, r_aim[0]), gains, e, d)
        for x in range(rod.nb - 1):
            error, rate = now.beta[x] - aim.beta[x], now.rate[x] - aim.rate[x]
            if x == 0:  # θ goes round
                error -= 2.0 * np.pi * np.round(error / (2.0 * np.pi))
            needed, size = aim.c[x] - now.c[x], 0.0
            for k in range(3):
                needed += aim.P[x][k] * b_aim[2][k] - now.P[x][k] * b_acc[k]
                size += abs(now.P[x][k]) + abs(aim.P[x][k])
            _set_error(at + rod.nz + x, error, rate, needed, size, gains, e, d)
        for end in range(2):
            lever = rod.length * (end - rod.sigma)
            for axis in range(3):
                unit = (1.0 if axis == 0 else 0.0, 1.0 if axis == 1 else 0.0, 1.0 if axis == 2 else 0.0)
                r_acc, b_acc = _accelerations(rod, b, 0.0, unit, times(lever, unit), own, effects)
                for p in range(rod.nz):
                    pull[a, end, p, axis] = dot(column_of(rod.E, p), r_acc)
                for x in range(rod.nb - 1):
                    pull[a, end, rod.nz + x, axis] = dot(now.P[x], b_acc)
        at += rod.nz + rod.nb - 1
    for a in range(len(points)):
        point = points[a]
        start[count + a] = at
        owner[point.node, 0] = count + a
        aim, aim_rate, aim_acc = point_target(point, t, target)
        r, r_rate = row_of(nodes, point.node), row_of(velocities, point.node)
        needed = minus(minus(aim_acc, g), over(row_of(pushed, point.node), point.mass))
        for p in range(point.nz):
            E = column_of(point.E, p)
            error, rate = dot(E, minus(r, aim)), dot(E, minus(r_rate, aim_rate))
            _set_error(at + p, error, rate, dot(E, needed), _size(E, r, aim), gains, e, d)
        at += point.nz
    for m in range(len(ranges)):
        length = string_length(nodes, segments, ranges[m])
        for s in range(ranges[m, 0], ranges[m, 1]):
            span = minus(row_of(nodes, segments[s, 1]), row_of(nodes, segments[s, 0]))
            span = times(share(length, span), span)
            for side in range(2):
                node, sign = segments[s, side], 1.0 - 2.0 * side
                a = owner[node, 0]
                if a < 0:
                    continue
                for k in range(3):
                    if a < count:
                        for p in range(rods[a].nz + rods[a].nb - 1):
                            A[start[a] + p, m] += sign * pull[a, owner[node, 1], p, k] * span[k]
                    else:
                        point = points[a - count]
                        for p in range(point.nz):
                            A[start[a] + p, m] += sign * point.E[k, p] * span[k] / point.mass
    return -1
