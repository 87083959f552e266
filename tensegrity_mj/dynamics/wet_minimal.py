"""Rods with added mass in minimal coordinates: Lagrange's equations of each rod, solved for z and the angles together.

With J_i the derivatives of a rod's end i to its coordinates and a_i⁰ what the end accelerates by without any q̈, added
mass α and P, which takes what is across the rod, enter as

    (M + Σ_ij α_ij J_iᵀ P J_j) q̈ = Q - Σ_ij α_ij J_iᵀ P a_j⁰
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.kernels import accelerate_points, rod_forces, solve_with_pivots
from tensegrity_mj.dynamics.minimal import direction
from tensegrity_mj.dynamics.native.compiling import njit


@njit
def wet_minimal_accelerations(
    members: Any, q: Any, rates: Any, forces: Any, added: Any, drives: Any, out: Any, multipliers: Any
) -> None:
    """q̈ (nq,) and λ (R,) as `minimal.minimal_accelerations`, with α (R, 4) of the rods.

    Args:
        members, q, rates, forces, out, multipliers: as there; `members` has `held_mass` besides, (N, 3) the forces of
            the added mass [N], which are written.
        added: α.
        drives: (R, 3) accelerations of the frames that the rods are seen from.
    """
    rods, gravity, held = members.rods, members.gravity, members.held_mass
    work = np.zeros((5, 3))
    b, b_rate, bend, U = work[0], work[1], work[2], work[3:]
    A, jac, lead, push = np.empty((5, 6)), np.zeros((2, 5, 3)), np.zeros((2, 3)), np.zeros((2, 3))
    held[:] = 0.0
    for a in range(len(rods)):
        rod = rods[a]
        nz, turns = rod.nz, rod.nb - 1
        at, n = rod.q + nz, nz + turns
        sine = direction(rod, q[at : at + 2], rates[at : at + 2], b, b_rate, U, bend)
        t_r, t_b = rod_forces(rod, forces, gravity)
        for end in range(2):
            lever = rod.length * (end - rod.sigma)
            for k in range(3):
                lead[end, k] = lever * bend[k] + drives[a, k]
                for p in range(nz):
                    jac[end, p, k] = rod.E[k, p]
                for c in range(turns):
                    jac[end, nz + c, k] = lever * U[c, k]
        # Of unit vectors U in place of ∂b/∂β: the angles' own rates follow by the division by sin φ.
        for i in range(n):
            A[i, 5] = 0.0
            for k in range(3):
                if i < nz:
                    A[i, 5] += rod.E[k, i] * (t_r[k] - rod.f * bend[k])
                else:
                    A[i, 5] += U[i - nz, k] * (t_b[k] - rod.J * bend[k])
            for j in range(n):
                A[i, j] = 0.0
                if i < nz and j < nz:
                    A[i, j] = rod.mass if i == j else 0.0
                elif i >= nz and j >= nz:
                    A[i, j] = rod.J if i == j else 0.0
                else:
                    for k in range(3):
                        A[i, j] += rod.f * rod.E[k, min(i, j)] * U[max(i, j) - nz, k]
        for i in range(n):
            for end in range(2):
                for other in range(2):
                    alpha = added[a, 2 * end + other]
                    A[i, 5] -= alpha * _across(b, jac[end, i], lead[other])
                    for j in range(n):
                        A[i, j] += alpha * _across(b, jac[end, i], jac[other, j])
        solve_with_pivots(A, n, 5)
        for end in range(2):
            for k in range(3):
                push[end, k] = lead[end, k]
                for i in range(n):
                    push[end, k] += A[i, 5] * jac[end, i, k]
        first, second = 0.0, 0.0
        for k in range(3):
            first += b[k] * push[0, k]
            second += b[k] * push[1, k]
        along, rate2 = 0.0, 0.0
        for k in range(3):
            one, two = push[0, k] - first * b[k], push[1, k] - second * b[k]
            held[rod.i, k] -= added[a, 0] * one + added[a, 1] * two
            held[rod.j, k] -= added[a, 2] * one + added[a, 3] * two
            r_acc = 0.0
            for i in range(nz):
                r_acc += rod.E[k, i] * A[i, 5]
            along += b[k] * (t_b[k] - rod.f * r_acc)
            rate2 += b_rate[k] * b_rate[k]
        multipliers[a] = rate2 + along / rod.J  # added mass acts across the rod
        for i in range(n):
            out[rod.q + i] = A[i, 5]
        if rod.nb == 3:
            out[at] /= sine
    accelerate_points(forces, members.points, gravity, out)


@njit
def _across(b: Any, u: Any, v: Any) -> float:
    """uᵀ P v of a unit vector b."""
    uv, bu, bv = 0.0, 0.0, 0.0
    for k in range(3):
        uv += u[k] * v[k]
        bu += b[k] * u[k]
        bv += b[k] * v[k]
    return uv - bu * bv
