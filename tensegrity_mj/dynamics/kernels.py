"""The equations of motion of chapter 2, (2.45)-(2.49), compiled, for rods of every support and for point masses.

Rods in water have added mass, which answers the very accelerations that are requested: `added` has α of all rods, rows
(α_11, α_12, α_21, α_22) [kg], and the forces (N, 3) [N] of the added mass, which are written. It is None where rods are
dry, whose compiled code has nothing of it.

Vectors b and r are kept in world components; the bases E of (2.41) and B (planar rods, b = B β) of a rod's record
say which directions they may have. Forces reach a rod only through t_r (conjugate to r) and t_b (conjugate to b).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.lanes import any_of
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import (
    ZERO,
    add,
    apply,
    column_of,
    dot,
    minus,
    over,
    plus,
    put,
    row_of,
    times,
    vector,
)


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
def wet_rod_accelerations(rod: Any, b: Any, c: float, t_r: Any, t_b: Any, added: Any) -> tuple[Any, Any]:
    """Return r̈ and b̈ of one rod as `rod_accelerations` does, with the added mass F_i = -Σ_j α_ij P a_j at its ends.

    `added` is (α_11, α_12, α_21, α_22). With a_1 = r̈ - σℓ b̈, a_2 = r̈ + (1 - σ)ℓ b̈ the forces on r and b are
    -(α_rr P r̈ + α_rb P b̈) and -(α_br P r̈ + α_bb P b̈). What b may do across itself, P_B = B Bᵀ - b bᵀ/‖b‖², lies
    within P, so that b̈ = P_B (t_b - f_b r̈) / J' - c b with f_b = f + α_br and J' = J + α_bb, and

        Eᵀ (m I + α_rr P - f_r f_b / J' P_B) r̈ = Eᵀ (t_r - f_r / J' P_B t_b + f c b),  f_r = f + α_rb:

    symmetric for every α, of as many rows as r has directions.
    """
    back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
    first_b, second_b = ahead * added[1] - back * added[0], ahead * added[3] - back * added[2]
    a_rr, a_rb = added[0] + added[1] + added[2] + added[3], first_b + second_b
    a_br = ahead * (added[2] + added[3]) - back * (added[0] + added[1])
    per_J = 1.0 / (rod.J + ahead * second_b - back * first_b)
    f_r, f_b = rod.f + a_rb, rod.f + a_br
    per_square = 1.0 / dot(b, b)
    pull = across_rod(rod, b, per_square, t_b)
    r_acc = ZERO
    if rod.nz > 0:
        v = plus(minus(t_r, times(f_r * per_J, pull)), times(rod.f * c, b))
        r_acc = _held(rod, b, per_square, rod.mass, a_rr, f_r * f_b * per_J, v)
        pull = minus(pull, across_rod(rod, b, per_square, times(f_b, r_acc)))
    return r_acc, minus(times(per_J, pull), times(c, b))


@inlined
def _held(rod: Any, b: Any, per_square: float, mass: float, added: float, turning: float, v: Any) -> Any:
    """E (Eᵀ K E)⁻¹ Eᵀ v of K = m I + α P - κ P_B, by L D Lᵀ; directions that r has not are rows of one."""
    e1, e2, e3 = column_of(rod.E, 0), column_of(rod.E, 1), column_of(rod.E, 2)
    k1, k2, k3 = (
        _times_K(rod, b, per_square, mass, added, turning, e1),
        _times_K(rod, b, per_square, mass, added, turning, e2),
        _times_K(rod, b, per_square, mass, added, turning, e3),
    )
    d1, l21, l31 = dot(e1, k1), dot(e2, k1), dot(e3, k1)
    k22 = dot(e2, k2) if rod.nz > 1 else 1.0
    k33 = dot(e3, k3) if rod.nz > 2 else 1.0
    k32 = dot(e3, k2)
    l21, l31, top = l21 / d1, l31 / d1, (l21, l31)
    d2 = k22 - l21 * top[0]
    l32 = (k32 - l31 * top[0]) / d2
    d3 = k33 - l31 * top[1] - l32 * l32 * d2
    x1 = dot(e1, v)
    x2 = dot(e2, v) - l21 * x1
    x3 = (dot(e3, v) - l31 * x1 - l32 * x2) / d3
    x2 = x2 / d2 - l32 * x3
    x1 = x1 / d1 - l21 * x2 - l31 * x3
    return plus(plus(times(x1, e1), times(x2, e2)), times(x3, e3))


@inlined
def _times_K(rod: Any, b: Any, per_square: float, mass: float, added: float, turning: float, e: Any) -> Any:
    across = minus(e, times(dot(b, e) * per_square, b))
    return minus(plus(times(mass, e), times(added, across)), times(turning, across_rod(rod, b, per_square, e)))


@inlined
def accelerate_rod(rod: Any, row: int, b: Any, c: float, t_r: Any, t_b: Any, added: Any) -> tuple[Any, Any]:
    """r̈ and b̈ of the rod of a row, dry or wet."""
    if added is None:
        return rod_accelerations(rod, b, c, t_r, t_b)
    return wet_rod_accelerations(rod, b, c, t_r, t_b, own_mass(added, row))


@inlined
def in_plane(rod: Any, v: Any) -> Any:
    """B Bᵀ v."""
    inside = v
    if rod.nb == 2:
        first, second = column_of(rod.B, 0), column_of(rod.B, 1)
        inside = plus(times(dot(first, v), first), times(dot(second, v), second))
    return inside


@inlined
def across_rod(rod: Any, b: Any, per_square: float, v: Any) -> Any:
    """P v = (B Bᵀ - b bᵀ/‖b‖²) v."""
    return minus(in_plane(rod, v), times(dot(b, v) * per_square, b))


@inlined
def translated(start: Any, member: Any, nz: int, q: Any) -> tuple[float, float, float]:
    """start + E z of a rod or a point mass that has so many z in q."""
    out = start
    for p in range(nz):
        out = plus(out, times(q[member.q + p], column_of(member.E, p)))
    return out


@inlined
def write_translations(member: Any, nz: int, r: Any, out: Any) -> None:
    """Eᵀr into a rod's or a point mass' places of `out` (nq,), with as many z as it has there."""
    for p in range(nz):
        out[member.q + p] = dot(column_of(member.E, p), r)


@inlined
def place_ends(rod: Any, r: Any, b: Any, nodes: Any) -> None:
    """Write the places of a rod's nodes, or their rates or accelerations, of those of r and b."""
    put(nodes, rod.i, minus(r, times(rod.sigma * rod.length, b)))
    put(nodes, rod.j, plus(r, times((1.0 - rod.sigma) * rod.length, b)))


@borrowing
def place_points(q: Any, rates: Any, points: Any, nodes: Any, velocities: Any) -> None:
    """Positions and velocities of the point masses' nodes, for both formulations: they have z alone."""
    for a in range(len(points)):
        point = points[a]
        put(nodes, point.node, translated(vector(point.anchor), point, point.nz, q))
        put(velocities, point.node, translated(ZERO, point, point.nz, rates))


@borrowing
def accelerate_points(forces: Any, points: Any, gravity: Any, out: Any) -> None:
    """z̈ of the point masses for nodal forces (N, 3) [N]."""
    for a in range(len(points)):
        point = points[a]
        own = plus(over(row_of(forces, point.node), point.mass), vector(gravity))
        write_translations(point, point.nz, own, out)


@borrowing
def place_nodes(q: Any, rates: Any, rods: Any, points: Any, nodes: Any, velocities: Any) -> None:
    """vec(N) = Φ q + y (2.53) and its rate, written into (N, 3) arrays; fixed nodes are left as they are."""
    for a in range(len(rods)):
        rod = rods[a]
        at = rod.q + rod.nz
        place_ends(rod, translated(vector(rod.anchor), rod, rod.nz, q), direction_of(rod, q, at), nodes)
        place_ends(rod, translated(ZERO, rod, rod.nz, rates), direction_of(rod, rates, at), velocities)
    place_points(q, rates, points, nodes, velocities)


@inlined
def rod_forces(rod: Any, forces: Any, gravity: Any) -> tuple[Any, Any]:
    """t_r and t_b of nodal forces (N, 3), Φᵀ f of (2.55), and of the rod's weight."""
    return forces_on_rod(rod, row_of(forces, rod.i), row_of(forces, rod.j), vector(gravity))


@inlined
def forces_on_rod(rod: Any, first: Any, second: Any, g: Any) -> tuple[Any, Any]:
    """t_r and t_b of forces on its ends and of its weight."""
    t_r = plus(plus(first, second), times(rod.mass, g))
    t_b = plus(times(rod.length, minus(times(1.0 - rod.sigma, second), times(rod.sigma, first))), times(rod.f, g))
    return t_r, t_b


@inlined
def stretch_term(rod: Any, b: Any, b_rate: Any, kp: float, kd: float) -> float:
    """c of bᵀb̈ = -c bᵀb: (‖ḃ‖² + k_d bᵀḃ + k_p (bᵀb - 1)/2) / ‖b‖², (3.26); 0 of an elastic rod."""
    square = dot(b, b)
    return rod.rigid * (dot(b_rate, b_rate) + kd * dot(b, b_rate) + 0.5 * kp * (square - 1.0)) / square


@inlined
def multiplier(rod: Any, b: Any, c: Any, r_acc: Any, t_b: Any) -> Any:
    """λ of a rod, for c of `stretch_term`, its acceleration r̈ and the force t_b on b."""
    return c - dot(b, minus(times(rod.f, r_acc), t_b)) / (rod.J * dot(b, b))


@inlined
def write_coordinates(rod: Any, nz: int, r: Any, b: Any, out: Any) -> None:
    """Eᵀr and Bᵀb into a rod's places of `out` (nq,), with as many z as it has there."""
    write_translations(rod, nz, r, out)
    for p in range(rod.nb):
        out[rod.q + nz + p] = dot(column_of(rod.B, p), b)


@borrowing
def accelerations(members: Any, q: Any, rates: Any, out: Any, added: Any = None) -> float:
    """q̈ (nq,) and λ (R,) for nodal forces (N, 3) [N].

    `members` has records of `ROD` and `POINT`, gravity [m/s²], Baumgarte's gains of (3.25), zero for none, the forces,
    and λ, which are written: `rods`, `points`, `gravity`, `kp`, `kd`, `forces` and `multipliers`.
    Returns the power [W] of added mass, whose forces are not written. With it, `members` also has nodes' `velocities`.
    """
    rods, gravity, kp, kd, power = members.rods, members.gravity, members.kp, members.kd, 0.0
    forces, multipliers = members.forces, members.multipliers
    for a in range(len(rods)):
        rod = rods[a]
        b, b_rate = direction_of(rod, q, rod.q + rod.nz), direction_of(rod, rates, rod.q + rod.nz)
        t_r, t_b = rod_forces(rod, forces, gravity)
        c = stretch_term(rod, b, b_rate, kp, kd)
        r_acc, b_acc = accelerate_rod(rod, a, b, c, t_r, t_b, added)
        # Added mass acts across the rod, so that it has no part in λ.
        multipliers[a] = multiplier(rod, b, c, r_acc, t_b)
        write_coordinates(rod, rod.nz, r_acc, b_acc, out)
        if added is not None:
            first, second = row_of(members.velocities, rod.i), row_of(members.velocities, rod.j)
            power += _power(rod, b, own_mass(added, a), (r_acc, b_acc), first, second)
    accelerate_points(forces, members.points, gravity, out)
    return power


@inlined
def _power(rod: Any, b: Any, own: Any, accelerations: Any, v1: Any, v2: Any) -> float:
    """-Σ_ij α_ij v_i · P a_j."""
    (r_acc, b_acc), back, ahead = accelerations, rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
    a1, a2, per_square = minus(r_acc, times(back, b_acc)), plus(r_acc, times(ahead, b_acc)), 1.0 / dot(b, b)
    first, second = plus(times(own[0], a1), times(own[1], a2)), plus(times(own[2], a1), times(own[3], a2))
    first = minus(first, times(dot(b, first) * per_square, b))
    second = minus(second, times(dot(b, second) * per_square, b))
    return -dot(first, v1) - dot(second, v2)


@inlined
def own_mass(added: Any, rod: int) -> Any:
    """α of a rod."""
    return added[0][rod, 0], added[0][rod, 1], added[0][rod, 2], added[0][rod, 3]


@borrowing
def added_forces(rod: Any, b: Any, own: Any, r_acc: Any, b_acc: Any) -> Any:
    """-Σ_j α_ij P a_j on both ends, for the whole r̈ and b̈."""
    a1 = minus(r_acc, times(rod.sigma * rod.length, b_acc))
    return forces_of_ends(b, own, a1, plus(a1, times(rod.length, b_acc)))


@inlined
def forces_of_ends(b: Any, own: Any, a1: Any, a2: Any) -> Any:
    """-Σ_j α_ij P a_j on both ends, for the accelerations of the ends."""
    per_square = 1.0 / dot(b, b)
    p1, p2 = minus(times(dot(b, a1) * per_square, b), a1), minus(times(dot(b, a2) * per_square, b), a2)
    return plus(times(own[0], p1), times(own[1], p2)), plus(times(own[2], p1), times(own[3], p2))


@inlined
def hold(rod: Any, pair: Any, held: Any) -> None:
    """Add the forces of a rod's ends to those on the nodes (N, 3)."""
    add(held, rod.i, pair[0])
    add(held, rod.j, pair[1])


@inlined
def direction_of(rod: Any, q: Any, at: int) -> Any:
    """b = B β in world components, β from place `at` of q on."""
    if rod.nb == 3:
        return q[at], q[at + 1], q[at + 2]
    return plus(times(q[at], column_of(rod.B, 0)), times(q[at + 1], column_of(rod.B, 1)))


@borrowing
def normalize(q: Any, rates: Any, rods: Any) -> None:
    """(3.23)-(3.24) for every rod."""
    for a in range(len(rods)):
        normalize_direction(rods[a], q, rates, rods[a].q + rods[a].nz)


@inlined
def normalize_direction(rod: Any, q: Any, rates: Any, at: int) -> None:
    """(3.23)-(3.24): the b of a rigid rod, from place `at` of q on, to unit length, ḃ orthogonal to it."""
    if any_of(rod.rigid == 0.0):
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
