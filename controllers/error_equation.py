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
from tensegrity_mj.dynamics.native.strings import share, string_length
from tensegrity_mj.dynamics.native.vectors import minus, row_of, times, vector
from tensegrity_mj.dynamics.target import Aim, point_target, rod_target

# Of K_p times a coordinate: a smaller error is no other than zero. Strings can only pull, so that at a target that
# needs none of them, noise of the wrong sign would have no solution.
ROUND_OFF = 8 * float(np.finfo(float).eps)
POLE = 1e-6  # sin φ below which (θ, φ) do not define where a rod points


@njit
def angles(rod: Any, b: Any, rate: Any, beta: Any, beta_rate: Any, P: Any, c: Any) -> bool:
    """β and β̇ of a direction b and its rate, and P (2, 3), c (2,) of β̈ = P b̈ + c; False at a pole.

    P = (WᵀW)⁻¹Wᵀ, c = -P Ẇβ̇ (§2.3). Planar rods have one angle, from the first of the plane's basis to the second.
    """
    if rod.nb == 2:
        x, y, x_rate, y_rate = 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            x += rod.B[k, 0] * b[k]
            y += rod.B[k, 1] * b[k]
            x_rate += rod.B[k, 0] * rate[k]
            y_rate += rod.B[k, 1] * rate[k]
        square = x * x + y * y
        beta[0] = np.arctan2(y, x)
        beta_rate[0] = (x * y_rate - y * x_rate) / square
        for k in range(3):
            P[0, k] = (x * rod.B[k, 1] - y * rod.B[k, 0]) / square
        c[0] = -2.0 * beta_rate[0] * (x * x_rate + y * y_rate) / square
        return True
    across = np.sqrt(b[0] * b[0] + b[1] * b[1])
    length = np.sqrt(across * across + b[2] * b[2])
    sin, cos = across / length, b[2] / length
    if not sin > POLE:
        return False
    sin_theta, cos_theta = b[1] / across, b[0] / across
    beta[0], beta[1] = np.arctan2(b[1], b[0]), np.arctan2(across, b[2])
    P[0, 0], P[0, 1], P[0, 2] = -sin_theta / across, cos_theta / across, 0.0
    P[1, 0], P[1, 1], P[1, 2] = cos * cos_theta / length, cos * sin_theta / length, -sin / length
    for p in range(2):
        beta_rate[p] = P[p, 0] * rate[0] + P[p, 1] * rate[1] + P[p, 2] * rate[2]
    c[0] = -2.0 * cos / sin * beta_rate[0] * beta_rate[1]
    c[1] = sin * cos * beta_rate[0] * beta_rate[0]
    return True


@njit
def _accelerations(rod: Any, b: Any, c: float, t_r: Any, t_b: Any, added: Any, effects: int) -> Any:
    return rod_accelerations(rod, b, c, t_r, t_b) if effects == 0 else wet_rod_accelerations(rod, b, c, t_r, t_b, added)


class Known(NamedTuple):
    """What the law has of structure, target and surroundings, as compiled code reads it.

    Attributes:
        rods, points: `StructureRecords`.
        segments, ranges: (S, 2) their nodes, and (M, 2) those of each string.
        target: address of an `Aim`.
        gravity: (3,) [m/s²].
        effects: address of what acts besides, see `known_forces`; 0 for nothing.
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


@njit
def error_equation(t: float, nodes: Any, velocities: Any, known: Known, A: Any, d: Any, e: Any) -> int:
    """(4.9) as A u = d, and the errors e (2, n) with their rates; A (n, M), d and e are written.

    Returns:
        -1, or the number of a rod whose b, or whose target's b, is at a pole; -2 where what is known of failed.
    """
    rods, points, target, gains = known.rods, known.points, Aim(known.target), known.gains
    gravity, effects, segments, ranges = known.gravity, known.effects, known.segments, known.ranges
    A[:] = 0.0
    count = len(rods)
    pull = np.zeros((count, 2, 5, 3))  # q̈ of each rod for a force on its first and on its second node
    owner = np.full((len(nodes), 2), -1)  # which rod (or point mass, from `count` on) a node is of, and which end
    start = np.empty(count + len(points), np.int64)
    work = np.empty((18, 3))
    r_aim, b_aim = work[:3], work[3:6]
    b, b_rate, r, r_rate, t_r, t_b = work[6], work[7], work[8], work[9], work[10], work[11]
    c, aim_c = work[12], work[13]
    beta, beta_rate, aim, aim_rate = work[14], work[15], work[16], work[17]
    P, aim_P = np.empty((2, 3)), np.empty((2, 3))
    pushed, added = np.zeros((len(nodes), 3)), np.zeros((count, 4))
    if effects != 0 and known_forces(effects, t, nodes, velocities, pushed, added) != SOLVED:
        return -2
    at = 0
    for a in range(count):
        rod = rods[a]
        start[a] = at
        owner[rod.i, 0], owner[rod.i, 1] = a, 0
        owner[rod.j, 0], owner[rod.j, 1] = a, 1
        square, rate2 = 0.0, 0.0
        for k in range(3):
            b[k] = (nodes[rod.j, k] - nodes[rod.i, k]) / rod.length
            b_rate[k] = (velocities[rod.j, k] - velocities[rod.i, k]) / rod.length
            r[k] = nodes[rod.i, k] + rod.sigma * rod.length * b[k]
            r_rate[k] = velocities[rod.i, k] + rod.sigma * rod.length * b_rate[k]
            square += b[k] * b[k]
            rate2 += b_rate[k] * b_rate[k]
            ahead, back = (1.0 - rod.sigma) * rod.length, rod.sigma * rod.length
            t_r[k] = rod.mass * gravity[k] + pushed[rod.i, k] + pushed[rod.j, k]
            t_b[k] = rod.f * gravity[k] + ahead * pushed[rod.j, k] - back * pushed[rod.i, k]
        rod_target(rod, t, target, r_aim, b_aim)
        if not angles(rod, b, b_rate, beta, beta_rate, P, c):
            return a
        if not angles(rod, b_aim[0], b_aim[1], aim, aim_rate, aim_P, aim_c):
            return a
        # q̈ without strings, M⁻¹ g, weight and what is known of included.
        own = (0.0, 0.0, 0.0, 0.0)
        if effects != 0:
            own = (added[a, 0], added[a, 1], added[a, 2], added[a, 3])
        r_acc, b_acc = _accelerations(rod, vector(b), rate2 / square, vector(t_r), vector(t_b), own, effects)
        turns = rod.nb - 1
        for p in range(rod.nz + turns):
            i = at + p
            size = 0.0
            if p < rod.nz:
                e[0, i], e[1, i], d[i] = 0.0, 0.0, 0.0
                for k in range(3):
                    size += abs(rod.E[k, p]) * (abs(r[k]) + abs(r_aim[0, k]))
                    e[0, i] += rod.E[k, p] * (r[k] - r_aim[0, k])
                    e[1, i] += rod.E[k, p] * (r_rate[k] - r_aim[1, k])
                    d[i] += rod.E[k, p] * (r_aim[2, k] - r_acc[k])
            else:
                x = p - rod.nz
                for k in range(3):
                    size += abs(P[x, k]) + abs(aim_P[x, k])
                e[0, i] = beta[x] - aim[x]
                if x == 0:  # θ goes round
                    e[0, i] -= 2.0 * np.pi * np.round(e[0, i] / (2.0 * np.pi))
                e[1, i] = beta_rate[x] - aim_rate[x]
                d[i] = aim_c[x] - c[x]
                for k in range(3):
                    d[i] += aim_P[x, k] * b_aim[2, k] - P[x, k] * b_acc[k]
            d[i] -= gains[0, i] * e[0, i] + gains[1, i] * e[1, i]
            if abs(d[i]) <= ROUND_OFF * gains[0, i] * size:
                d[i] = 0.0
        for end in range(2):
            lever = rod.length * (end - rod.sigma)
            for axis in range(3):
                for k in range(3):
                    t_r[k] = 1.0 if k == axis else 0.0
                    t_b[k] = lever * t_r[k]
                r_acc, b_acc = _accelerations(rod, vector(b), 0.0, vector(t_r), vector(t_b), own, effects)
                for p in range(rod.nz + turns):
                    for k in range(3):
                        if p < rod.nz:
                            pull[a, end, p, axis] += rod.E[k, p] * r_acc[k]
                        else:
                            pull[a, end, p, axis] += P[p - rod.nz, k] * b_acc[k]
        at += rod.nz + turns
    for a in range(len(points)):
        point = points[a]
        start[count + a] = at
        owner[point.node, 0] = count + a
        point_target(point, t, target, r_aim)
        for p in range(point.nz):
            i = at + p
            size = 0.0
            e[0, i], e[1, i], d[i] = 0.0, 0.0, 0.0
            for k in range(3):
                size += abs(point.E[k, p]) * (abs(nodes[point.node, k]) + abs(r_aim[0, k]))
                e[0, i] += point.E[k, p] * (nodes[point.node, k] - r_aim[0, k])
                e[1, i] += point.E[k, p] * (velocities[point.node, k] - r_aim[1, k])
                d[i] += point.E[k, p] * (r_aim[2, k] - gravity[k] - pushed[point.node, k] / point.mass)
            d[i] -= gains[0, i] * e[0, i] + gains[1, i] * e[1, i]
            if abs(d[i]) <= ROUND_OFF * gains[0, i] * size:
                d[i] = 0.0
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
