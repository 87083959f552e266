"""The minimal model of chapter 2.3: q = (z, β) of each rod, β = (θ, φ) in space and one angle in a plane.

In space b = (cos θ sin φ, sin θ sin φ, cos φ) (2.67); in a plane b = B (cos β, sin β), B being the support's
`rotation_basis`. Point masses have z alone. With W = ∂b/∂β and f, J of (2.30), Lagrange's equations of a rod are (the
thesis' with the corrections of its misprints, derived anew)

    m z̈ + f Eᵀ W β̈ = g_z + t_z,          g_z = -f Eᵀ Ẇ β̇,      t_z = Eᵀ t_r
    f Wᵀ E z̈ + J WᵀW β̈ = g_β + t_β,      g_β = -J Wᵀ Ẇ β̇,      t_β = Wᵀ t_b

and with β̈ eliminated from the first, M(q) q̈ = H(q) (g + Φᵀ f) with M block lower triangular, (2.81)-(2.85), (2.89).

W has orthogonal columns, W = U diag(s) with unit vectors U, s = (sin φ, 1) in space and s = 1 in a plane. Hence
W (WᵀW)⁻¹ = U diag(1/s), and all that is singular at φ = 0, π is one division, of θ̈ by sin φ: z̈ and λ stay finite.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.kernels import accelerate_points, place_points, rod_forces, solve_spd
from tensegrity_mj.dynamics.native.compiling import njit
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
    work = np.zeros((5, 3))
    b, b_rate, bend, U = work[0], work[1], work[2], work[3:]
    for a in range(len(rods)):
        rod = rods[a]
        for p in range(rod.nz):
            q[rod.q + p], rates[rod.q + p] = 0.0, 0.0
        for k in range(3):
            b[k] = (nodes[rod.j, k] - nodes[rod.i, k]) / rod.length
            b_rate[k] = (velocities[rod.j, k] - velocities[rod.i, k]) / rod.length
            r = (1.0 - rod.sigma) * nodes[rod.i, k] + rod.sigma * nodes[rod.j, k]
            r_rate = (1.0 - rod.sigma) * velocities[rod.i, k] + rod.sigma * velocities[rod.j, k]
            for p in range(rod.nz):
                q[rod.q + p] += rod.E[k, p] * r
                rates[rod.q + p] += rod.E[k, p] * r_rate
        at = rod.q + rod.nz
        if rod.nb == 2:
            x, y = 0.0, 0.0
            for k in range(3):
                x += rod.B[k, 0] * b[k]
                y += rod.B[k, 1] * b[k]
            q[at] = np.arctan2(y, x)
        else:
            across = np.hypot(b[0], b[1])
            q[at + 1] = np.arctan2(across, b[2])
            if across > 0.0:
                q[at] = np.arctan2(b[1], b[0])
            else:
                q[at] = np.arctan2(b[2] * b_rate[1], b[2] * b_rate[0])
        rates[at : at + rod.nb - 1] = 0.0
        sine = direction(rod, q[at : at + 2], rates[at : at + 2], b, work[2], U, bend)
        for c in range(rod.nb - 1):
            for k in range(3):
                rates[at + c] += U[c, k] * b_rate[k]
        if rod.nb == 3:
            rates[at] = rates[at] / sine if sine > 0.0 else 0.0
    for a in range(len(points)):
        point = points[a]
        for p in range(point.nz):
            q[point.q + p], rates[point.q + p] = 0.0, 0.0
            for k in range(3):
                q[point.q + p] += point.E[k, p] * nodes[point.node, k]
                rates[point.q + p] += point.E[k, p] * velocities[point.node, k]


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


@njit
def direction(rod: Any, angles: Any, rates: Any, b: Any, b_rate: Any, U: Any, bend: Any) -> float:
    """b, ḃ = W β̇, the unit vectors U (rows) of W's columns, and Ẇ β̇, of a rod's angles; returns sin φ (1 in a plane).

    `U` is (2, 3), of which a rod in a plane uses the first row.
    """
    if rod.nb == 2:
        c, s = cosine_and_sine(angles[0])
        rate = rates[0]
        for k in range(3):
            b[k] = rod.B[k, 0] * c + rod.B[k, 1] * s
            U[0, k] = rod.B[k, 1] * c - rod.B[k, 0] * s
            b_rate[k] = rate * U[0, k]
            bend[k] = -rate * rate * b[k]
        return 1.0
    ct, st = cosine_and_sine(angles[0])
    cp, sp = cosine_and_sine(angles[1])
    turn, tilt = rates[0], rates[1]
    b[0], b[1], b[2] = ct * sp, st * sp, cp
    U[0, 0], U[0, 1], U[0, 2] = -st, ct, 0.0
    U[1, 0], U[1, 1], U[1, 2] = ct * cp, st * cp, -sp
    for k in range(3):
        b_rate[k] = sp * turn * U[0, k] + tilt * U[1, k]
        # θ̇² ∂²b/∂θ² + 2 θ̇ φ̇ ∂²b/∂θ∂φ + φ̇² ∂²b/∂φ²
        bend[k] = 2.0 * cp * turn * tilt * U[0, k] - tilt * tilt * b[k]
    bend[0] -= turn * turn * ct * sp
    bend[1] -= turn * turn * st * sp
    return sp


@njit
def place_minimal(q: Any, rates: Any, rods: Any, points: Any, nodes: Any, velocities: Any) -> None:
    """vec(N) = Υ(q) + y (2.86) and its rate, written into (N, 3) arrays; fixed nodes are left as they are."""
    work = np.zeros((5, 3))
    b, b_rate, bend, U = work[0], work[1], work[2], work[3:]
    for a in range(len(rods)):
        rod = rods[a]
        at = rod.q + rod.nz
        direction(rod, q[at : at + 2], rates[at : at + 2], b, b_rate, U, bend)
        back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
        for k in range(3):
            r, r_rate = rod.anchor[k], 0.0
            for p in range(rod.nz):
                r += rod.E[k, p] * q[rod.q + p]
                r_rate += rod.E[k, p] * rates[rod.q + p]
            nodes[rod.i, k] = r - back * b[k]
            nodes[rod.j, k] = r + ahead * b[k]
            velocities[rod.i, k] = r_rate - back * b_rate[k]
            velocities[rod.j, k] = r_rate + ahead * b_rate[k]
    place_points(q, rates, points, nodes, velocities)


@njit
def minimal_accelerations(members: Any, q: Any, rates: Any, forces: Any, out: Any, multipliers: Any) -> None:
    """q̈ (nq,) of M q̈ = H (g + Φᵀ f), and λ (R,) of (2.36), for nodal forces (N, 3) [N]: z̈ first, then β̈.

    `members`: as in `kernels.accelerations`.

    At a pole of a rod, sin φ = 0, its θ̈ is not finite; all else is.
    """
    work = np.zeros((11, 3))
    b, b_rate, bend, r_acc, push, x = work[0], work[1], work[2], work[3], work[4], work[5]
    U, A = work[6:8], work[8:11]
    rods, gravity = members.rods, members.gravity
    for a in range(len(rods)):
        rod = rods[a]
        m, f, J, nz, turns = rod.mass, rod.f, rod.J, rod.nz, rod.nb - 1
        at = rod.q + nz
        sine = direction(rod, q[at : at + 2], rates[at : at + 2], b, b_rate, U, bend)
        t_r, t_b = rod_forces(rod, forces, gravity)
        # (m I - f²/J Eᵀ U Uᵀ E) z̈ = t_z + g_z - f Eᵀ U diag(1/s) (g_β + t_β) / J, where (g_β + t_β) / s is
        # Uᵀ (t_b - J Ẇβ̇).
        for i in range(nz):
            x[i] = 0.0
            for k in range(3):
                x[i] += rod.E[k, i] * (t_r[k] - f * bend[k])
            for j in range(i + 1):
                A[i, j] = m if i == j else 0.0
        for c in range(turns):
            drive = 0.0
            for k in range(3):
                drive += U[c, k] * (t_b[k] / J - bend[k])
            for i in range(nz):
                eu_i = rod.E[0, i] * U[c, 0] + rod.E[1, i] * U[c, 1] + rod.E[2, i] * U[c, 2]
                x[i] -= f * drive * eu_i
                for j in range(i + 1):
                    eu_j = rod.E[0, j] * U[c, 0] + rod.E[1, j] * U[c, 1] + rod.E[2, j] * U[c, 2]
                    A[i, j] -= f * f / J * eu_i * eu_j
        solve_spd(nz, A, x)
        along, rate2 = 0.0, 0.0
        for k in range(3):
            r_acc[k] = 0.0
            for i in range(nz):
                r_acc[k] += rod.E[k, i] * x[i]
            push[k] = t_b[k] - f * r_acc[k]
            along += b[k] * push[k]
            rate2 += b_rate[k] * b_rate[k]
        multipliers[a] = rate2 + along / J
        for i in range(nz):
            out[rod.q + i] = x[i]
        # J WᵀW β̈ = g_β + t_β - f Wᵀ r̈
        for c in range(turns):
            total = 0.0
            for k in range(3):
                total += U[c, k] * (push[k] / J - bend[k])
            out[at + c] = total
        if rod.nb == 3:
            out[at] /= sine
    accelerate_points(forces, members.points, gravity, out)


@njit
def node_accelerations(q: Any, rates: Any, accelerations: Any, rods: Any, points: Any, out: Any) -> None:
    """Accelerations of the nodes (N, 3): r̈ and b̈ = W β̈ + Ẇ β̇ along the rods; those of fixed nodes are left."""
    work = np.zeros((5, 3))
    b, b_rate, bend, U = work[0], work[1], work[2], work[3:]
    for a in range(len(rods)):
        rod = rods[a]
        at = rod.q + rod.nz
        sine = direction(rod, q[at : at + 2], rates[at : at + 2], b, b_rate, U, bend)
        back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
        for k in range(3):
            r_acc, b_acc = 0.0, bend[k]
            for p in range(rod.nz):
                r_acc += rod.E[k, p] * accelerations[rod.q + p]
            b_acc += sine * accelerations[at] * U[0, k]
            if rod.nb == 3:
                b_acc += accelerations[at + 1] * U[1, k]
            out[rod.i, k] = r_acc - back * b_acc
            out[rod.j, k] = r_acc + ahead * b_acc
    for a in range(len(points)):
        point = points[a]
        for k in range(3):
            out[point.node, k] = 0.0
            for p in range(point.nz):
                out[point.node, k] += point.E[k, p] * accelerations[point.q + p]
