"""The minimal model of chapter 2.3: q = (z, β) of each rod, β = (θ, φ) in space and one angle in a plane.

In space b = (cos θ sin φ, sin θ sin φ, cos φ) (2.67); in a plane b = B (cos β, sin β), B being the support's
`rotation_basis`. Point masses have z alone. With W = ∂b/∂β and f, J of (2.30), Lagrange's equations of a rod are (the
thesis' with the corrections of its misprints, derived anew)

    m z̈ + f Eᵀ W β̈ = g_z + t_z,          g_z = -f Eᵀ Ẇ β̇,      t_z = Eᵀ t_r
    f Wᵀ E z̈ + J WᵀW β̈ = g_β + t_β,      g_β = -J Wᵀ Ẇ β̇,      t_β = Wᵀ t_b

and with β̈ eliminated from the first, M(q) q̈ = H(q) (g + Φᵀ f) with M block lower triangular, (2.81)-(2.85), (2.89).

W has orthogonal columns, W = U diag(s) with unit vectors U, s = (sin φ, 1) in space and s = 1 in a plane. Hence
W (WᵀW)⁻¹ = U diag(1/s), and all that is singular at φ = 0, π is one division, of θ̈ by sin φ: z̈ and λ stay finite.

With added mass, z and the angles of a rod are solved together. With J_i the derivatives of its end i to its coordinates
and a_i⁰ what the end accelerates by without any q̈, added mass α and P, which takes what is across the rod, enter as

    (M + Σ_ij α_ij J_iᵀ P J_j) q̈ = Q - Σ_ij α_ij J_iᵀ P a_j⁰
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.kernels import (
    accelerate_points,
    hold,
    place_ends,
    place_points,
    rod_forces,
    solve_spd,
    solve_with_pivots,
    translated,
    write_translations,
)
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.pointers import inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, column_of, dot, minus, over, plus, put, row_of, times, vector
from tensegrity_mj.dynamics.records import Records, StructureRecords
from tensegrity_mj.model.capabilities import require_class_1
from tensegrity_mj.model.structure import Structure


@dataclass(frozen=True, eq=False)
class MinimalRecords:
    """Rods and point masses as records (see `records`) whose `q` counts minimal coordinates.

    Attributes:
        rods, points: record arrays of `ROD` and `POINT`. A rod has `nz` translations and `nb` - 1 angles.
        nq: number of coordinates.
    """

    structure: Structure
    rods: Records
    points: Records
    nq: int

    @classmethod
    def of(cls, structure: Structure) -> MinimalRecords:
        """The records of a structure.

        Raises:
            StructureError: where rods share nodes.
        """
        require_class_1(structure, "minimal coordinates are")
        records = StructureRecords.of(structure)
        rods, points = records.rods.copy(), records.points.copy()
        rods["q"] -= np.arange(len(rods))  # every rod has a coordinate less
        points["q"] -= len(rods)
        return cls(structure, rods, points, records.nq - len(rods))

    def state(self, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """q (nq,) and q̇ (nq,) of node positions and velocities (N, 3).

        At a pole, where θ is not defined, it is chosen so that b moves along φ; elsewhere θ is within (-π, π].
        """
        q, rates = np.zeros(self.nq), np.zeros(self.nq)
        state_of_nodes(np.asarray(nodes, float), np.asarray(velocities, float), self.rods, self.points, q, rates)
        return q, rates


@njit
def state_of_nodes(nodes: Any, velocities: Any, rods: Any, points: Any, q: Any, rates: Any) -> None:
    """Minimal q and q̇ (nq,) of node positions and velocities (N, 3)."""
    for a in range(len(rods)):
        rod = rods[a]
        r, b = _place_and_direction(rod, nodes)
        r_rate, b_rate = _place_and_direction(rod, velocities)
        write_translations(rod, rod.nz, r, q)
        write_translations(rod, rod.nz, r_rate, rates)
        at = rod.q + rod.nz
        if rod.nb == 2:
            q[at] = np.arctan2(dot(column_of(rod.B, 1), b), dot(column_of(rod.B, 0), b))
        else:
            across = np.hypot(b[0], b[1])
            q[at + 1] = np.arctan2(across, b[2])
            if across > 0.0:
                q[at] = np.arctan2(b[1], b[0])
            else:
                q[at] = np.arctan2(b[2] * b_rate[1], b[2] * b_rate[0])
        turning = direction(rod, q, rates)
        for c in range(rod.nb - 1):
            rates[at + c] = dot(turning.U[c], b_rate)
        if rod.nb == 3:
            rates[at] = rates[at] / turning.sine if turning.sine > 0.0 else 0.0
    for a in range(len(points)):
        point = points[a]
        write_translations(point, point.nz, row_of(nodes, point.node), q)
        write_translations(point, point.nz, row_of(velocities, point.node), rates)


@inlined
def _place_and_direction(rod: Any, nodes: Any) -> tuple[Any, Any]:
    """r and b of a rod from the places of its nodes, or their rates from those of these."""
    first, second = row_of(nodes, rod.i), row_of(nodes, rod.j)
    return plus(times(1.0 - rod.sigma, first), times(rod.sigma, second)), over(minus(second, first), rod.length)


@njit
def cosine_and_sine(angle: float) -> tuple[float, float]:
    """cos and sin, exactly 0 and ±1 at right angles up to ±π.

    A law that has no solution in a plane of axes must not find one in a cosine's round-off.
    """
    size = abs(angle)
    if size > np.pi:
        return np.cos(angle), np.sin(angle)
    sine = np.sin(size) if size <= 0.5 * np.pi else np.sin(np.pi - size)
    return np.sin(0.5 * np.pi - size), -sine if angle < 0.0 else sine


class Turning(NamedTuple):
    """Direction of a rod, and its rate.

    Attributes:
        b, rate: b and ḃ = W β̇.
        U: the unit vectors of W's columns; a rod in a plane uses the first.
        bend: Ẇ β̇.
        sine: sin φ, 1 in a plane.
    """

    b: Any
    rate: Any
    U: Any
    bend: Any
    sine: float


@njit
def direction(rod: Any, q: Any, rates: Any) -> Turning:
    """Compute a rod's direction from its angles in q and their rates in q̇ (nq,)."""
    at = rod.q + rod.nz
    if rod.nb == 2:
        c, s = cosine_and_sine(q[at])
        rate, first, second = rates[at], column_of(rod.B, 0), column_of(rod.B, 1)
        b = plus(times(c, first), times(s, second))
        u = minus(times(c, second), times(s, first))
        return Turning(b, times(rate, u), (u, u), times(-rate * rate, b), 1.0)
    ct, st = cosine_and_sine(q[at])
    cp, sp = cosine_and_sine(q[at + 1])
    turn, tilt = rates[at], rates[at + 1]
    b = (ct * sp, st * sp, cp)
    u, v = (-st, ct, 0.0), (ct * cp, st * cp, -sp)
    # θ̇² ∂²b/∂θ² + 2 θ̇ φ̇ ∂²b/∂θ∂φ + φ̇² ∂²b/∂φ²
    bend = minus(times(2.0 * cp * turn * tilt, u), times(tilt * tilt, b))
    bend = minus(bend, (turn * turn * ct * sp, turn * turn * st * sp, 0.0))
    return Turning(b, plus(times(sp * turn, u), times(tilt, v)), (u, v), bend, sp)


@njit
def place_minimal(q: Any, rates: Any, rods: Any, points: Any, nodes: Any, velocities: Any) -> None:
    """vec(N) = Υ(q) + y (2.86) and its rate, written into (N, 3) arrays; fixed nodes are left as they are."""
    for a in range(len(rods)):
        rod = rods[a]
        turning = direction(rod, q, rates)
        place_ends(rod, translated(vector(rod.anchor), rod, rod.nz, q), turning.b, nodes)
        place_ends(rod, translated(ZERO, rod, rod.nz, rates), turning.rate, velocities)
    place_points(q, rates, points, nodes, velocities)


@njit
def minimal_accelerations(members: Any, q: Any, rates: Any, out: Any) -> None:
    """q̈ (nq,) of M q̈ = H (g + Φᵀ f), and λ (R,) of (2.36), for nodal forces (N, 3) [N]: z̈ first, then β̈.

    `members`: as in `kernels.accelerations`.

    At a pole of a rod, sin φ = 0, its θ̈ is not finite; all else is.
    """
    x, A = np.zeros(3), np.zeros((3, 3))
    rods, gravity, forces, multipliers = members.rods, members.gravity, members.forces, members.multipliers
    for a in range(len(rods)):
        rod = rods[a]
        m, f, J, nz, turns = rod.mass, rod.f, rod.J, rod.nz, rod.nb - 1
        at = rod.q + nz
        b, b_rate, U, bend, sine = direction(rod, q, rates)
        t_r, t_b = rod_forces(rod, forces, gravity)
        # (m I - f²/J Eᵀ U Uᵀ E) z̈ = t_z + g_z - f Eᵀ U diag(1/s) (g_β + t_β) / J, where (g_β + t_β) / s is
        # Uᵀ (t_b - J Ẇβ̇).
        for i in range(nz):
            x[i] = dot(column_of(rod.E, i), minus(t_r, times(f, bend)))
            for j in range(i + 1):
                A[i, j] = m if i == j else 0.0
        for c in range(turns):
            drive = dot(U[c], minus(over(t_b, J), bend))
            for i in range(nz):
                eu_i = dot(column_of(rod.E, i), U[c])
                x[i] -= f * drive * eu_i
                for j in range(i + 1):
                    A[i, j] -= f * f / J * eu_i * dot(column_of(rod.E, j), U[c])
        solve_spd(nz, A, x)
        for i in range(nz):
            out[rod.q + i] = x[i]
        push = minus(t_b, times(f, translated(ZERO, rod, nz, out)))
        multipliers[a] = dot(b_rate, b_rate) + dot(b, push) / J
        # J WᵀW β̈ = g_β + t_β - f Wᵀ r̈
        for c in range(turns):
            out[at + c] = dot(U[c], minus(over(push, J), bend))
        if rod.nb == 3:
            out[at] /= sine
    accelerate_points(forces, members.points, gravity, out)


@njit
def node_accelerations(q: Any, rates: Any, accelerations: Any, rods: Any, points: Any, out: Any) -> None:
    """Accelerations of the nodes (N, 3): r̈ and b̈ = W β̈ + Ẇ β̇ along the rods; those of fixed nodes are left."""
    for a in range(len(rods)):
        rod = rods[a]
        at = rod.q + rod.nz
        _, _, U, b_acc, sine = direction(rod, q, rates)
        b_acc = plus(b_acc, times(sine * accelerations[at], U[0]))
        if rod.nb == 3:
            b_acc = plus(b_acc, times(accelerations[at + 1], U[1]))
        place_ends(rod, translated(ZERO, rod, rod.nz, accelerations), b_acc, out)
    for a in range(len(points)):
        point = points[a]
        put(out, point.node, translated(ZERO, point, point.nz, accelerations))


@njit
def wet_minimal_accelerations(members: Any, q: Any, rates: Any, drives: Any, out: Any) -> None:
    """Compute q̈ (nq,) and λ (R,) as `minimal.minimal_accelerations` does, with added mass.

    Args:
        members, q, rates, out: as there; `members` also has `added`, the rods' α (R, 4), and `held_mass`, the forces
            (N, 3) of the added mass [N], which are written.
        drives: (R, 3) accelerations of the frames that the rods are seen from.
    """
    rods, gravity, added, held = members.rods, members.gravity, members.added, members.held_mass
    forces, multipliers = members.forces, members.multipliers
    A, jac, lead = np.empty((5, 6)), np.zeros((2, 5, 3)), np.zeros((2, 3))
    held[:] = 0.0
    for a in range(len(rods)):
        rod, own = rods[a], added[a]
        nz, n = rod.nz, rod.nz + rod.nb - 1
        b, b_rate, U, bend, sine = direction(rod, q, rates)
        t_r, t_b = rod_forces(rod, forces, gravity)
        for end in range(2):
            lever = rod.length * (end - rod.sigma)
            put(lead, end, plus(times(lever, bend), row_of(drives, a)))
            for i in range(n):
                put(jac[end], i, column_of(rod.E, i) if i < nz else times(lever, U[i - nz]))
        # Of unit vectors U in place of ∂b/∂β: the angles' own rates follow by the division by sin φ.
        for i in range(n):
            if i < nz:
                A[i, 5] = dot(column_of(rod.E, i), minus(t_r, times(rod.f, bend)))
            else:
                A[i, 5] = dot(U[i - nz], minus(t_b, times(rod.J, bend)))
            for j in range(n):
                if (i < nz) == (j < nz):
                    A[i, j] = (rod.mass if i < nz else rod.J) if i == j else 0.0
                else:
                    A[i, j] = dot(times(rod.f, column_of(rod.E, min(i, j))), U[max(i, j) - nz])
        for i in range(n):
            for end in range(2):
                for other in range(2):
                    alpha = own[2 * end + other]
                    A[i, 5] -= alpha * _across(b, jac[end, i], lead[other])
                    for j in range(n):
                        A[i, j] += alpha * _across(b, jac[end, i], jac[other, j])
        solve_with_pivots(A, n, 5)
        one, two = row_of(lead, 0), row_of(lead, 1)
        for i in range(n):
            one, two = plus(one, times(A[i, 5], row_of(jac[0], i))), plus(two, times(A[i, 5], row_of(jac[1], i)))
            out[rod.q + i] = A[i, 5]
        one, two = minus(one, times(dot(b, one), b)), minus(two, times(dot(b, two), b))
        first, second = plus(times(own[0], one), times(own[1], two)), plus(times(own[2], one), times(own[3], two))
        hold(rod, (times(-1.0, first), times(-1.0, second)), held)
        # Added mass acts across the rod.
        pull = minus(t_b, times(rod.f, translated(ZERO, rod, nz, out)))
        multipliers[a] = dot(b_rate, b_rate) + dot(b, pull) / rod.J
        if rod.nb == 3:
            out[rod.q + nz] /= sine
    accelerate_points(forces, members.points, gravity, out)


@inlined
def _across(b: Any, u: Any, v: Any) -> float:
    """uᵀ P v of a unit vector b."""
    return dot(u, v) - dot(b, u) * dot(b, v)
