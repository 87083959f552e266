"""Rods with added mass in minimal coordinates: Lagrange's equations of each rod, solved for z and the angles together.

With J_i the derivatives of a rod's end i to its coordinates and a_i⁰ what the end accelerates by without any q̈, added
mass α and P, which takes what is across the rod, enter as

    (M + Σ_ij α_ij J_iᵀ P J_j) q̈ = Q - Σ_ij α_ij J_iᵀ P a_j⁰
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.kernels import accelerate_points, hold, rod_forces, solve_with_pivots, translated
from tensegrity_mj.dynamics.minimal import direction
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.pointers import inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, column_of, dot, minus, plus, put, row_of, times


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
