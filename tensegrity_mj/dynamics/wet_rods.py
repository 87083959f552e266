"""Rods in water: (2.45)-(2.49) with added mass, which answers the very accelerations that are requested."""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.kernels import accelerate_points, across_rod, direction_of, rod_forces
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, dot, minus, plus, times


@inlined
def wet_rod_accelerations(rod: Any, b: Any, c: float, t_r: Any, t_b: Any, added: Any) -> tuple[Any, Any]:
    """r̈ and b̈ of one rod whose ends feel F_i = -Σ_j α_ij P a_j besides; else as `kernels.rod_accelerations`.

    `added` is (α_11, α_12, α_21, α_22). With a_1 = r̈ - σℓ b̈, a_2 = r̈ + (1 - σ)ℓ b̈ the forces on r and b are
    -(α_rr P r̈ + α_rb P b̈) and -(α_br P r̈ + α_bb P b̈). What b may do across itself, P_B = B Bᵀ - b bᵀ/‖b‖², lies
    within P, so that b̈ = P_B (t_b - f_b r̈) / J' - c b with f_b = f + α_br and J' = J + α_bb, and

        Eᵀ (m I + α_rr P - f_r f_b / J' P_B) r̈ = Eᵀ (t_r - f_r / J' P_B t_b + f c b),  f_r = f + α_rb:

    symmetric whatever α is, of as many rows as r has directions.
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
    E = rod.E
    e1, e2, e3 = (E[0, 0], E[1, 0], E[2, 0]), (E[0, 1], E[1, 1], E[2, 1]), (E[0, 2], E[1, 2], E[2, 2])
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


@borrowing
def wet_accelerations(members: Any, q: Any, rates: Any, forces: Any, added: Any, out: Any, multipliers: Any) -> float:
    """As `kernels.accelerations`, with α (R, 4) of the rods; returns the power [W] of the added mass."""
    rods, gravity, kp, kd, power = members.rods, members.gravity, members.kp, members.kd, 0.0
    for a in range(len(rods)):
        rod = rods[a]
        iz, ib = rod.q, rod.q + rod.nz
        b, b_rate = direction_of(rod, q, ib), direction_of(rod, rates, ib)
        square = dot(b, b)
        t_r, t_b = rod_forces(rod, forces, gravity)
        c = (dot(b_rate, b_rate) + kd * dot(b, b_rate) + 0.5 * kp * (square - 1.0)) / square
        own = (added[a, 0], added[a, 1], added[a, 2], added[a, 3])
        r_acc, b_acc = wet_rod_accelerations(rod, b, c, t_r, t_b, own)
        # Added mass acts across the rod, so that it has no part in λ.
        multipliers[a] = c - dot(b, minus(times(rod.f, r_acc), t_b)) / (rod.J * square)
        r_rate = ZERO
        for p in range(rod.nz):
            axis = (rod.E[0, p], rod.E[1, p], rod.E[2, p])
            out[iz + p] = dot(axis, r_acc)
            r_rate = plus(r_rate, times(rates[iz + p], axis))
        for p in range(rod.nb):
            out[ib + p] = rod.B[0, p] * b_acc[0] + rod.B[1, p] * b_acc[1] + rod.B[2, p] * b_acc[2]
        power += _power(rod, b, own, r_acc, b_acc, r_rate, b_rate)
    accelerate_points(forces, members.points, gravity, out)
    return power


@inlined
def _power(rod: Any, b: Any, added: Any, r_acc: Any, b_acc: Any, r_rate: Any, b_rate: Any) -> float:
    """-Σ_ij α_ij v_i · P a_j."""
    back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
    a1, a2 = minus(r_acc, times(back, b_acc)), plus(r_acc, times(ahead, b_acc))
    v1, v2 = minus(r_rate, times(back, b_rate)), plus(r_rate, times(ahead, b_rate))
    force1 = plus(times(added[0], a1), times(added[1], a2))
    force2 = plus(times(added[2], a1), times(added[3], a2))
    per_square = 1.0 / dot(b, b)
    force1 = minus(force1, times(dot(b, force1) * per_square, b))
    force2 = minus(force2, times(dot(b, force2) * per_square, b))
    return -dot(force1, v1) - dot(force2, v2)


@inlined
def own_mass(added: Any, rod: int) -> Any:
    """(α_11, α_12, α_21, α_22) of a rod."""
    return added[0][rod, 0], added[0][rod, 1], added[0][rod, 2], added[0][rod, 3]


@borrowing
def answer_of_wet_rod(rod: Any, b: Any, c: float, ends: Any, g: Any, drive: Any, own: Any) -> Any:
    """r̈ at σ, b̈ and Jλ, as `joint_forces.answer_of_rod`; r̈ and g are seen from a support that accelerates by `drive`.

    Added mass feels the whole acceleration, and acts across the rod, so that it has no part in λ.
    """
    across = minus(drive, times(dot(b, drive) / dot(b, b), b))
    first, second = minus(ends[0], times(own[0] + own[1], across)), minus(ends[1], times(own[2] + own[3], across))
    t_r = plus(plus(first, second), times(rod.mass, g))
    t_b = plus(times(rod.length, minus(times(1.0 - rod.sigma, second), times(rod.sigma, first))), times(rod.f, g))
    r_acc, b_acc = wet_rod_accelerations(rod, b, c, t_r, t_b, own)
    return r_acc, b_acc, rod.J * c - dot(b, minus(times(rod.f, r_acc), t_b)) / dot(b, b)


@borrowing
def wet_compliance(rod: Any, b: Any, own: Any, A: Any) -> None:
    """(3, 3) blocks of how the ends answer forces at the ends, as `joint_forces._compliance`: symmetric where α is."""
    back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
    for y in range(3):
        unit = (1.0 if y == 0 else 0.0, 1.0 if y == 1 else 0.0, 1.0 if y == 2 else 0.0)
        r_acc, b_acc = wet_rod_accelerations(rod, b, 0.0, unit, times(-back, unit), own)
        first = minus(r_acc, times(back, b_acc))
        r_acc, b_acc = wet_rod_accelerations(rod, b, 0.0, unit, times(ahead, unit), own)
        other, second = minus(r_acc, times(back, b_acc)), plus(r_acc, times(ahead, b_acc))
        A[0, 0, y], A[0, 1, y], A[0, 2, y] = first[0], first[1], first[2]
        A[1, 0, y], A[1, 1, y], A[1, 2, y] = other[0], other[1], other[2]
        A[2, 0, y], A[2, 1, y], A[2, 2, y] = second[0], second[1], second[2]


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
    for x in range(3):
        held[rod.i, x] += pair[0][x]
        held[rod.j, x] += pair[1][x]
