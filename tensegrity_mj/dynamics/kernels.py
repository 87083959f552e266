"""The equations of motion of chapter 2, (2.45)-(2.49), compiled, for rods of every support and for point masses.

Vectors b and r are kept in world components; the bases E of (2.41) and B (planar rods, b = B β) of a rod's record
say which directions they may have. Forces reach a rod only through t_r (conjugate to r) and t_b (conjugate to b).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, apply, dot, minus, plus, row_of, times, vector


class Members(NamedTuple):
    """Rods and point masses as records, and what they are subject to.

    Attributes:
        rods, points: of `ROD` and `POINT`.
        gravity: (3,) [m/s²].
        kp, kd: Baumgarte's gains of (3.25), zero for none.
    """

    rods: Any
    points: Any
    gravity: Any
    kp: float = 0.0
    kd: float = 0.0


@njit
def solve_spd(n: int, A: Any, x: Any) -> None:
    """Solve A x = x in place for the leading n x n block, n <= 3, of a symmetric positive definite A (LDLᵀ)."""
    for k in range(n):
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(i, n):
                A[j, i] -= factor * A[j, k]
            x[i] -= factor * x[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            x[k] -= A[j, k] * x[j]
        x[k] /= A[k, k]


@inlined
def rod_accelerations(rod: Any, b: Any, c: float, t_r: Any, t_b: Any) -> tuple[Any, Any]:
    """r̈ and b̈ of one rod from its forces, (2.43) and (2.37); vectors are tuples of three.

    `c` is (‖ḃ‖/‖b‖)², plus what a stabilization adds. With c = 0 this applies A = M⁻¹ H of (2.45), which is
    symmetric: the laws use it so.

    With P = B Bᵀ - b bᵀ/‖b‖², the two equations are b̈ = P (t_b - f r̈)/J - c b and
    Eᵀ (m I - f²/J P) r̈ = Eᵀ v, v = t_r - f/J P t_b + f c b. The matrix is a constant plus κ b bᵀ, κ = f²/(J ‖b‖²),
    and W the inverse of the constant (`ROD`), so that r̈ = W v - κ bᵀWv/(1 + κ bᵀWb) W b (Sherman and Morrison). Of an
    elastic rod, whose length is free, P = B Bᵀ, κ = 0 and c = 0.
    """
    per_square, f, per_J = rod.rigid / dot(b, b), rod.f, rod.per_J
    pull = across_rod(rod, b, per_square, t_b)
    r_acc = ZERO
    if rod.nz > 0:
        v = plus(minus(t_r, times(f * per_J, pull)), times(f * c, b))
        r_acc, Wb = apply(rod.W, v), apply(rod.W, b)
        kappa = f * f * per_J * per_square
        r_acc = minus(r_acc, times(kappa * dot(b, r_acc) / (1.0 + kappa * dot(b, Wb)), Wb))
        pull = minus(pull, across_rod(rod, b, per_square, times(f, r_acc)))
    return r_acc, minus(times(per_J, pull), times(c, b))


@inlined
def across_rod(rod: Any, b: Any, per_square: float, v: Any) -> Any:
    """P v = (B Bᵀ - b bᵀ/‖b‖²) v."""
    inside = v
    if rod.nb == 2:
        B = rod.B
        p = B[0, 0] * v[0] + B[1, 0] * v[1] + B[2, 0] * v[2]
        q = B[0, 1] * v[0] + B[1, 1] * v[1] + B[2, 1] * v[2]
        inside = (B[0, 0] * p + B[0, 1] * q, B[1, 0] * p + B[1, 1] * q, B[2, 0] * p + B[2, 1] * q)
    return minus(inside, times(dot(b, v) * per_square, b))


@borrowing
def place_points(q: Any, rates: Any, points: Any, nodes: Any, velocities: Any) -> None:
    """Positions and velocities of the point masses' nodes, for both formulations: they have z alone."""
    for a in range(len(points)):
        point = points[a]
        for k in range(3):
            r, r_rate = point.anchor[k], 0.0
            for p in range(point.nz):
                r += point.E[k, p] * q[point.q + p]
                r_rate += point.E[k, p] * rates[point.q + p]
            nodes[point.node, k] = r
            velocities[point.node, k] = r_rate


@borrowing
def accelerate_points(forces: Any, points: Any, gravity: Any, out: Any) -> None:
    """z̈ of the point masses for nodal forces (N, 3) [N]."""
    for a in range(len(points)):
        point = points[a]
        for p in range(point.nz):
            total = 0.0
            for k in range(3):
                total += point.E[k, p] * (forces[point.node, k] / point.mass + gravity[k])
            out[point.q + p] = total


@borrowing
def place_nodes(q: Any, rates: Any, rods: Any, points: Any, nodes: Any, velocities: Any) -> None:
    """vec(N) = Φ q + y (2.53) and its rate, written into (N, 3) arrays; fixed nodes are left as they are."""
    for a in range(len(rods)):
        rod = rods[a]
        iz, ib = rod.q, rod.q + rod.nz
        for k in range(3):
            r, r_rate, b, b_rate = rod.anchor[k], 0.0, 0.0, 0.0
            for p in range(rod.nz):
                r += rod.E[k, p] * q[iz + p]
                r_rate += rod.E[k, p] * rates[iz + p]
            for p in range(rod.nb):
                b += rod.B[k, p] * q[ib + p]
                b_rate += rod.B[k, p] * rates[ib + p]
            back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
            nodes[rod.i, k] = r - back * b
            nodes[rod.j, k] = r + ahead * b
            velocities[rod.i, k] = r_rate - back * b_rate
            velocities[rod.j, k] = r_rate + ahead * b_rate
    place_points(q, rates, points, nodes, velocities)


@inlined
def rod_forces(rod: Any, forces: Any, gravity: Any) -> tuple[Any, Any]:
    """t_r and t_b of nodal forces (N, 3), Φᵀ f of (2.55), and of the rod's weight."""
    fi, fj, g = row_of(forces, rod.i), row_of(forces, rod.j), vector(gravity)
    t_r = plus(plus(fi, fj), times(rod.mass, g))
    t_b = plus(times(rod.length, minus(times(1.0 - rod.sigma, fj), times(rod.sigma, fi))), times(rod.f, g))
    return t_r, t_b


@borrowing
def accelerations(members: Any, q: Any, rates: Any, forces: Any, out: Any, multipliers: Any) -> None:
    """q̈ (nq,) and λ (R,) of `Members`, or what has such fields, for nodal forces (N, 3) [N]."""
    rods, gravity, kp, kd = members.rods, members.gravity, members.kp, members.kd
    for a in range(len(rods)):
        rod = rods[a]
        iz, ib = rod.q, rod.q + rod.nz
        b, b_rate = direction_of(rod, q, ib), direction_of(rod, rates, ib)
        square = dot(b, b)
        t_r, t_b = rod_forces(rod, forces, gravity)
        # bᵀb̈ + ‖ḃ‖² = -k_d bᵀḃ - k_p (bᵀb - 1)/2, (3.26).
        c = rod.rigid * (dot(b_rate, b_rate) + kd * dot(b, b_rate) + 0.5 * kp * (square - 1.0)) / square
        r_acc, b_acc = rod_accelerations(rod, b, c, t_r, t_b)
        multipliers[a] = c - dot(b, minus(times(rod.f, r_acc), t_b)) / (rod.J * square)
        for p in range(rod.nz):
            out[iz + p] = rod.E[0, p] * r_acc[0] + rod.E[1, p] * r_acc[1] + rod.E[2, p] * r_acc[2]
        for p in range(rod.nb):
            out[ib + p] = rod.B[0, p] * b_acc[0] + rod.B[1, p] * b_acc[1] + rod.B[2, p] * b_acc[2]
    accelerate_points(forces, members.points, gravity, out)


@inlined
def direction_of(rod: Any, q: Any, at: int) -> Any:
    """b = B β in world components, β from place `at` of q on."""
    B = rod.B
    if rod.nb == 3:
        return q[at], q[at + 1], q[at + 2]
    x, y = q[at], q[at + 1]
    return B[0, 0] * x + B[0, 1] * y, B[1, 0] * x + B[1, 1] * y, B[2, 0] * x + B[2, 1] * y


@borrowing
def normalize(q: Any, rates: Any, rods: Any) -> None:
    """(3.23)-(3.24) for every rod."""
    for a in range(len(rods)):
        normalize_direction(rods[a], q, rates, rods[a].q + rods[a].nz)


@inlined
def normalize_direction(rod: Any, q: Any, rates: Any, at: int) -> None:
    """(3.23)-(3.24): the b of a rigid rod, from place `at` of q on, to unit length, ḃ orthogonal to it."""
    if rod.rigid == 0.0:
        return
    nb, square, along = rod.nb, 0.0, 0.0
    for p in range(at, at + nb):
        square += q[p] * q[p]
    norm = np.sqrt(square)
    for p in range(at, at + nb):
        q[p] /= norm
        along += q[p] * rates[p]
    for p in range(at, at + nb):
        rates[p] -= along * q[p]


@borrowing
def solve_with_pivots(A: Any, n: int, right: int) -> None:
    """Solve the n x n equations in A for its columns from `right` on, the right-hand sides, in place, with pivots."""
    columns = range(right, A.shape[1])
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        if best != k:
            for x in range(k, n):
                A[k, x], A[best, x] = A[best, x], A[k, x]
            for c in columns:
                A[k, c], A[best, c] = A[best, c], A[k, c]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            if factor != 0.0:
                for x in range(k, n):
                    A[i, x] -= factor * A[k, x]
                for c in columns:
                    A[i, c] -= factor * A[k, c]
    for k in range(n - 1, -1, -1):
        for c in columns:
            for x in range(k + 1, n):
                A[k, c] -= A[k, x] * A[x, c]
            A[k, c] /= A[k, k]
