"""The equations of motion of chapter 2, (2.45)-(2.49), compiled, for rods of every support and for point masses.

Vectors b and r are kept in world components; the bases E of (2.41) and B (planar rods, b = B β) of a rod's record
say which directions they may have. Forces reach a rod only through t_r (conjugate to r) and t_b (conjugate to b).
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

njit = numba.njit(cache=True, error_model="numpy")


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


@njit
def rod_accelerations(rod: Any, b: Any, c: float, t_r: Any, t_b: Any, r_acc: Any, b_acc: Any, work: Any) -> None:
    """r̈ and b̈ of one rod from its forces, (2.43) and (2.37).

    `c` is (‖ḃ‖/‖b‖)², plus what a stabilization adds. With c = 0 this applies A = M⁻¹ H of (2.45), which is
    symmetric: the laws use it so. `work` is scratch, (4, 3).
    """
    square = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    nz, nb = rod.nz, rod.nb
    m, f, J = rod.mass, rod.f, rod.J
    # P t_b, with P = B Bᵀ - b bᵀ/‖b‖².
    along = (b[0] * t_b[0] + b[1] * t_b[1] + b[2] * t_b[2]) / square
    for i in range(3):
        b_acc[i] = t_b[i] - along * b[i]
        r_acc[i] = 0.0
    if nb == 2:
        _keep_in_plane(rod.B, b_acc)
    if nz > 0:
        if f == 0.0 and nz == 3:
            for i in range(3):
                r_acc[i] = t_r[i] / m
        else:
            E, B = rod.E, rod.B
            A, x = work[:3], work[3]
            for i in range(nz):
                eb_i = E[0, i] * b[0] + E[1, i] * b[1] + E[2, i] * b[2]
                x[i] = 0.0
                for k in range(3):
                    x[i] += E[k, i] * (t_r[k] - f / J * b_acc[k])
                x[i] += f * c * eb_i
                for j in range(i + 1):
                    eb_j = E[0, j] * b[0] + E[1, j] * b[1] + E[2, j] * b[2]
                    projected = -eb_i * eb_j / square
                    for p in range(nb):
                        be_i = B[0, p] * E[0, i] + B[1, p] * E[1, i] + B[2, p] * E[2, i]
                        be_j = B[0, p] * E[0, j] + B[1, p] * E[1, j] + B[2, p] * E[2, j]
                        projected += be_i * be_j
                    A[i, j] = -f * f / J * projected
                A[i, i] += m
            solve_spd(nz, A, x)
            for k in range(3):
                for i in range(nz):
                    r_acc[k] += E[k, i] * x[i]
    if f != 0.0:
        # P f r̈, subtracted from P t_b.
        along = f * (b[0] * r_acc[0] + b[1] * r_acc[1] + b[2] * r_acc[2]) / square
        pr = work[0]
        for i in range(3):
            pr[i] = f * r_acc[i] - along * b[i]
        if nb == 2:
            _keep_in_plane(rod.B, pr)
        for i in range(3):
            b_acc[i] -= pr[i]
    for i in range(3):
        b_acc[i] = b_acc[i] / J - c * b[i]


@njit
def _keep_in_plane(B: Any, v: Any) -> None:
    p = B[0, 0] * v[0] + B[1, 0] * v[1] + B[2, 0] * v[2]
    q = B[0, 1] * v[0] + B[1, 1] * v[1] + B[2, 1] * v[2]
    for i in range(3):
        v[i] = B[i, 0] * p + B[i, 1] * q


@njit
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


@njit
def accelerate_points(forces: Any, points: Any, gravity: Any, out: Any) -> None:
    """z̈ of the point masses for nodal forces (N, 3) [N]."""
    for a in range(len(points)):
        point = points[a]
        for p in range(point.nz):
            total = 0.0
            for k in range(3):
                total += point.E[k, p] * (forces[point.node, k] / point.mass + gravity[k])
            out[point.q + p] = total


@njit
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


@njit
def rod_forces(rod: Any, forces: Any, gravity: Any, t_r: Any, t_b: Any) -> None:
    """t_r and t_b of nodal forces (N, 3), Φᵀ f of (2.55), and of the rod's weight."""
    for k in range(3):
        fi, fj = forces[rod.i, k], forces[rod.j, k]
        t_r[k] = fi + fj + rod.mass * gravity[k]
        t_b[k] = rod.length * ((1.0 - rod.sigma) * fj - rod.sigma * fi) + rod.f * gravity[k]


@njit
def accelerations(
    q: Any,
    rates: Any,
    forces: Any,
    rods: Any,
    points: Any,
    gravity: Any,
    kp: float,
    kd: float,
    out: Any,
    multipliers: Any,
) -> None:
    """q̈ (nq,) and λ (R,) for nodal forces (N, 3) [N]; kp, kd are Baumgarte's gains of (3.25), zero for none."""
    work = np.empty((10, 3))  # one allocation: this is called at every stage
    b, b_rate, t_r, t_b, r_acc, b_acc = work[4], work[5], work[6], work[7], work[8], work[9]
    for a in range(len(rods)):
        rod = rods[a]
        iz, ib = rod.q, rod.q + rod.nz
        square, rate2, dot = 0.0, 0.0, 0.0
        for k in range(3):
            b[k], b_rate[k] = 0.0, 0.0
            for p in range(rod.nb):
                b[k] += rod.B[k, p] * q[ib + p]
                b_rate[k] += rod.B[k, p] * rates[ib + p]
            square += b[k] * b[k]
            rate2 += b_rate[k] * b_rate[k]
            dot += b[k] * b_rate[k]
        rod_forces(rod, forces, gravity, t_r, t_b)
        # bᵀb̈ + ‖ḃ‖² = -k_d bᵀḃ - k_p (bᵀb - 1)/2, (3.26).
        c = (rate2 + kd * dot + 0.5 * kp * (square - 1.0)) / square
        rod_accelerations(rod, b, c, t_r, t_b, r_acc, b_acc, work[:4])
        along = 0.0
        for k in range(3):
            along += b[k] * (rod.f * r_acc[k] - t_b[k])
        multipliers[a] = c - along / (rod.J * square)
        for p in range(rod.nz):
            out[iz + p] = rod.E[0, p] * r_acc[0] + rod.E[1, p] * r_acc[1] + rod.E[2, p] * r_acc[2]
        for p in range(rod.nb):
            out[ib + p] = rod.B[0, p] * b_acc[0] + rod.B[1, p] * b_acc[1] + rod.B[2, p] * b_acc[2]
    accelerate_points(forces, points, gravity, out)


@njit
def normalize(q: Any, rates: Any, rods: Any) -> None:
    """(3.23)-(3.24): b to unit length, ḃ orthogonal to it."""
    for a in range(len(rods)):
        rod = rods[a]
        ib = rod.q + rod.nz
        square, dot = 0.0, 0.0
        for p in range(rod.nb):
            square += q[ib + p] * q[ib + p]
        norm = np.sqrt(square)
        for p in range(rod.nb):
            q[ib + p] /= norm
            dot += q[ib + p] * rates[ib + p]
        for p in range(rod.nb):
            rates[ib + p] -= dot * q[ib + p]
