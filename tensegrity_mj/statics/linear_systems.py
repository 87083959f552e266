"""The linear systems of statics: steps that keep rods' lengths, projections onto them, rods' forces, eigenvalues.

The equations at one place and their derivatives are assembled when they are first needed, and once. Matrices are dense
arrays where these are faster (`Boundary.is_small`).
"""

from __future__ import annotations

import warnings
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.linalg import eigh, qr
from scipy.sparse.linalg import LinearOperator, MatrixRankWarning, eigsh, splu

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.rigidity import body_motions, turned
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


def neutral_motions(model: StaticModel, x: Array, parameter: float, rod_forces: Array) -> Array:
    """Orthonormal motions (3N, p) of the whole as one body that change no energy: what no stiffness resists.

    Translations across the external forces, and turns about an axis to which all of these are parallel, as far as
    supports and holds leave them, and as far as these keep them on their way: a node that a guide holds on a
    straight line leaves the circle about an axis at once, and the reaction of the guide resists.

    At x (3N,) [m], for the parameter of a path, under axial forces N (R,) [N] of the rods.
    """
    G, Z = model.boundary.quick
    bodies = body_motions(x.reshape(-1, 3))
    forces = model.external(parameter)
    largest = float(np.abs(forces).max(initial=0.0))
    rows = [np.zeros((6, 6)), np.asarray(G @ bodies)]

    def by_turning(force: Array) -> Array:
        """Return the change of forces (3N,) when the whole turns, on the free coordinates (q, 6)."""
        change = np.asarray(Z.T @ turned(force.reshape(-1, 3)))
        return np.hstack([np.zeros_like(change), change])

    if largest > 0:
        free = Z @ (Z.T @ forces) / largest
        rows += [(free @ bodies)[None], by_turning(free)]
    if model.elements:
        rows.append(Z.T @ (model.element_stiffness(x) @ bodies) / model.scale[1])
    if G.shape[0]:
        inside = model.gradient(x, parameter)
        carried = np.concatenate([model.tensions(model.lengths(x)), rod_forces])
        scale = float(np.abs(carried).max(initial=0.0)) + largest
        held = inside + model.rod_pulls(x, rod_forces)
        if scale > 0:
            rows.append(by_turning((held - Z @ (Z.T @ held)) / scale))
    _, singular, right = np.linalg.svd(np.vstack(rows), full_matrices=False)
    found = bodies @ right[singular < 1e-7].T
    left, singular, _ = np.linalg.svd(found, full_matrices=False)
    # Nodes on one line: turning about it moves none; nearly on one: as little as the bound above lets through.
    return np.asarray(left[:, singular > 1e-6])


def _same_kind(matrix: Matrix) -> Matrix:
    return np.asarray(matrix) if isinstance(matrix, np.ndarray) else sparse.csr_array(matrix)


DENSE = 1800  # free coordinates up to which eigenvalues are found by dense matrices
# Redundant rods make the equations singular. So little compliance, relative to the stiffest string, makes them regular;
# it acts on changes of forces only (a proximal point), so that it leaves no error behind.
PROXIMAL = 1e-8
RIDGE = 1e-14
PROJECTIONS = 30
OUTWEIGHED = 1e-4  # of an entry 1, see `across`
LENGTHS, DETERMINED = 1e-12, 1e-6  # see `own_stresses`


def saddle_matrix(H: sparse.csr_array, C: sparse.csr_array, compliance: Array) -> sparse.csc_array:
    """[H Cᵀ; C -diag(compliance)]."""
    return sparse.csc_array(sparse.block_array([[H, C.T], [C, -sparse.diags_array(compliance)]]))


def across(motions: Array) -> sparse.csr_array:
    """Rows (p, q) that keep steps across orthonormal motions (q, p) of the whole.

    They have entries everywhere: one that is taken as a pivot before all others are fills the factors. As `OUTWEIGHED`,
    none is, as long as any entry of its column resists.
    """
    return sparse.csr_array(OUTWEIGHED * motions.T)


def solve(matrix: sparse.csc_array | Array, right: Array) -> Array | None:
    """The solution, or None where the matrix is singular."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", MatrixRankWarning)
        try:
            dense = isinstance(matrix, np.ndarray)
            found: Array = np.linalg.solve(matrix, right) if dense else splu(matrix).solve(right)
        except (RuntimeError, MatrixRankWarning, np.linalg.LinAlgError):
            return None
    return found if np.all(np.isfinite(found)) else None


def proximal(model: StaticModel) -> float:
    """[m/N] the compliance of `PROXIMAL`."""
    return PROXIMAL / model.scale[1]


def rod_forces(model: StaticModel, x: Array, gradient: Array) -> Array:
    """N (R,) [N]: of elastic rods by their lengths, of rigid ones the least that leave the least of Zᵀ (∇Π + Cᵀ N)."""
    forces = model.rod_forces_from_lengths(x, np.zeros(len(model.rod_lengths)))
    rigid = np.flatnonzero(model.compliance == 0)
    if not len(rigid):
        return forces
    slopes = model.rod_slopes(x)
    Z = model.boundary.Z
    C = sparse.csr_array(slopes[rigid] @ Z)
    normal = sparse.csc_array(C @ C.T)
    factors = splu(normal + RIDGE * sparse.eye_array(len(rigid), format="csc"))
    left = Z.T @ (gradient + slopes.T @ forces)
    found = np.zeros(len(rigid))
    for _ in range(3):  # refined: normal equations lose digits
        found -= factors.solve(C @ (left + C.T @ found))
    forces[rigid] = found
    return least_forces(model, x, forces)


def least_forces(model: StaticModel, x: Array, forces: Array) -> Array:
    """N (R,) [N] without the rigid rods' own states of self-stress: of all that push alike, the least sum of squares.

    Regularized equations make any multiple of round-off of these states, which nothing determines.
    """
    if not model.has_redundant_rods:
        return forces
    own, _ = own_stresses(model, x)
    return np.asarray(forces - own @ (own.T @ forces))


def own_stresses(model: StaticModel, x: Array) -> tuple[Array, bool]:
    """Orthonormal states of self-stress (R, k) that rigid rods and supports have alone; whether k is clear.

    They are the left null space of C Z. Places are known to `projected`'s 1e-12 of a rod, which changes directions, and
    with them the singular values of R rows of unit vectors, by less than 1e-12 √(2R): what is below is none. `_descend`
    accepts residuals of 1e-10 of the forces; divided by a singular value of 1e-6 they leave four digits of a force:
    what is above counts. In between, k depends on digits that the nodes do not have.
    """
    rigid = np.flatnonzero(model.compliance == 0)
    stresses, size, _ = np.linalg.svd((model.rod_slopes(x)[rigid] @ model.boundary.Z).toarray())
    size = size / (size.max(initial=0.0) or 1.0)
    own = np.zeros((len(model.compliance), len(rigid) - int(np.sum(size > RANK))))
    own[rigid] = stresses[:, len(rigid) - own.shape[1] :]
    return own, not np.any((size > LENGTHS * np.sqrt(2 * len(rigid))) & (size < DETERMINED))


def projected(model: StaticModel, x: Array, lengths: Array) -> Array | None:
    """The nearest x, to first order, at which rods have these lengths, on the boundary's free directions; or None."""
    if not len(lengths):
        return x
    Z, best = model.boundary.Z, np.inf
    for _ in range(PROJECTIONS):
        gap = model.rods(x).lengths - lengths
        size = float(np.abs(gap / lengths).max())
        if size <= 4e-16 or (size <= 1e-13 and size >= 0.5 * best):
            return x
        if not size < 2.0 * best:
            return None
        best = min(best, size)
        C = sparse.csr_array(model.rod_slopes(x) @ Z)
        normal = sparse.csc_array(C @ C.T) + RIDGE * sparse.eye_array(len(gap), format="csc")
        try:
            x = x - Z @ (C.T @ splu(normal).solve(gap))
        except RuntimeError:
            return None
    return x if best <= LENGTHS else None


def lowest_stiffness(at: Linearized, count: int) -> tuple[Array, Array]:
    """The lowest eigenvalues (m,) [N/m], m <= count, ascending, of the stiffness on admissible motions, and these.

    Motions (3N, m) are orthonormal, and across neutral ones. Beyond `DENSE` coordinates the eigenvalues nearest
    to zero are found.
    """
    model, Z, K = at.model, at.Z, at.stiffness
    if Z.shape[1] <= DENSE:
        T = at.tangent_basis(at.neutral)
        if not T.shape[1]:
            return np.zeros(0), np.zeros((len(at.x), 0))
        K = T.T @ (K @ T)
        values, vectors = eigh(0.5 * (K + K.T), subset_by_index=[0, min(count, len(K)) - 1])
        return values, np.asarray(Z @ (T @ vectors))
    rows = sparse.vstack([at.held_lengths, sparse.csr_array((Z.T @ at.neutral).T)])
    C, stiffest = sparse.csr_array(rows), model.scale[1]
    values, vectors = nearest_pairs(K, sparse.eye_array(K.shape[0], format="csr"), C, -1e-9 * stiffest, stiffest, count)
    return values, np.asarray(Z @ vectors)


def nearest_pairs(K: Matrix, M: Matrix, C: Matrix, shift: float, scale: float, count: int) -> tuple[Array, Array]:
    """Eigenvalues (m,), m <= count, of K v = λ M v with C v = 0: those nearest to the shift, ascending; and v (q, m).

    By inverse iteration; `scale` is a typical size of K.
    """
    q, kept = K.shape[0], C.shape[0]
    factors = splu(saddle_matrix(sparse.csr_array(K - shift * M), C, np.full(kept, RIDGE / scale)))

    def inverse(v: Array) -> Array:
        return np.asarray(factors.solve(np.concatenate([v, np.zeros(kept)]))[:q])

    operator = LinearOperator((q, q), matvec=inverse, dtype=float)
    start = np.random.default_rng(0).normal(size=q)
    values, vectors = eigsh(K, k=min(count + 2, q - 1), M=M, sigma=shift, OPinv=operator, v0=start)
    order = np.argsort(values)[:count]
    return values[order], vectors[:, order]
