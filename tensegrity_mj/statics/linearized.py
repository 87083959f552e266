"""The equations of equilibrium and their derivatives at one place, each assembled when it is first needed, and once.

Matrices are dense arrays where these are faster (`Boundary.is_small`).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.linalg import qr

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.statics.body_motions import neutral_motions
from tensegrity_mj.statics.boundary import Matrix
from tensegrity_mj.statics.model import RANK, StaticModel


class Linearized:
    """The equations at x (3N,), parameter s, and axial forces N (R,) of the rods; q free coordinates.

    Zᵀ (∇Π + Cᵀ N) = 0 and L = ℓ + N ℓ/EA, see `model`.
    """

    def __init__(self, model: StaticModel, x: Array, s: float, forces: Array) -> None:
        self.model, self.x, self.s, self.forces = model, x, s, forces
        self.small, self.Z = model.boundary.is_small, model.boundary.quick[1]

    @cached_property
    def left(self) -> Array:
        """(q,) [N]: the forces that are left on the free coordinates."""
        model = self.model
        return np.asarray(self.Z.T @ (model.gradient(self.x, self.s) + model.rod_pulls(self.x, self.forces)))

    @cached_property
    def gaps(self) -> Array:
        """(R,) [m]: what the rods are longer than their forces make them."""
        model = self.model
        return model.rods(self.x).lengths - model.rod_lengths - model.compliance * self.forces

    @cached_property
    def hessian(self) -> Matrix:
        """(3N, 3N) [N/m]: ∇²Π + Σ N ∇²L."""
        make = self.model.dense_hessian if self.small else self.model.hessian
        return make(self.x, self.forces)

    @cached_property
    def slopes(self) -> Matrix:
        """C (R, 3N)."""
        return (self.model.dense_rod_slopes if self.small else self.model.rod_slopes)(self.x)

    @cached_property
    def free_hessian(self) -> Matrix:
        """(q, q): Zᵀ hessian Z."""
        return _same_kind(self.Z.T @ self.hessian @ self.Z)

    @cached_property
    def free_slopes(self) -> Matrix:
        """(R, q): C Z."""
        return _same_kind(self.slopes @ self.Z)

    @cached_property
    def stiffness(self) -> Matrix:
        """(q, q) [N/m]: `free_hessian` and what elastic rods resist; rigid rods' lengths are not in it."""
        elastic = np.flatnonzero(self.model.compliance > 0)
        if not len(elastic):
            return self.free_hessian
        C = self.free_slopes[elastic]
        return _same_kind(self.free_hessian + C.T @ (sparse.diags_array(1.0 / self.model.compliance[elastic]) @ C))

    @cached_property
    def held_lengths(self) -> Matrix:
        """(rigid rods, q): how the lengths of rigid rods change."""
        return self.free_slopes[np.flatnonzero(self.model.compliance == 0)]

    def tangent_basis(self, without: Array | None = None) -> Array:
        """Orthonormal motions (q, t) of free coordinates that keep rigid rods' lengths, across the given (3N, p)."""
        held = self.held_lengths
        rows = [held if isinstance(held, np.ndarray) else held.toarray()]
        if without is not None and without.shape[1]:
            rows.append((self.Z.T @ without).T)
        matrix = np.vstack(rows)
        if not len(matrix):
            return np.eye(self.Z.shape[1])
        Q, R, _ = qr(matrix.T, mode="full", pivoting=True)
        size = np.abs(np.diag(R))
        return np.asarray(Q[:, int(np.sum(size > RANK * size.max(initial=0.0))) :])

    @cached_property
    def neutral(self) -> Array:
        """(3N, p) orthonormal: motions of the whole as one body that nothing resists."""
        return neutral_motions(self.model, self.x, self.s, self.forces)

    @cached_property
    def by_parameter(self) -> tuple[Array, Array]:
        """(q,) [N] and (R,) [m]: how `left` and the rods' lengths change with the parameter."""
        model, moved = self.model, self.model.boundary.moved
        pushed = -model.loads.ravel()
        if not np.any(moved):
            return np.asarray(self.Z.T @ pushed), np.zeros(len(self.forces))
        return np.asarray(self.Z.T @ (self.hessian @ moved + pushed)), np.asarray(self.slopes @ moved)


def _same_kind(matrix: Matrix) -> Matrix:
    return np.asarray(matrix) if isinstance(matrix, np.ndarray) else sparse.csr_array(matrix)
