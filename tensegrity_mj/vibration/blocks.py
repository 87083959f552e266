"""Matrices of small motions as sums of blocks: of pairs of bodies, and of strings between them.

A joint of rods a and b at a node is C y = 0, C = X_a - X_b, three rows, in coordinates y of `small_motions`, where
the mass matrix is one; a linear constraint is a row more. With y = P y of the projection P = 1 - C⁺ C, a matrix of
unjoined bodies becomes P K P: what joints forbid stays zero, and no eigenvalue above zero is larger than before. Joints
that say what others say already (loops, rows across a plane) change nothing in P; of their forces the least are taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.model.strings import Paths
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.vibration.bodies import SLOTS, Bodies

RANK = 1e-9  # of the largest singular value: below it, a row says what others say
SOFT = 1e-12  # of a row's own: what keeps the sparse equations of redundant rows solvable


@dataclass(frozen=True, eq=False)
class Joints:
    """The constraints of J joints between bodies of `slots` coordinates each, and L more.

    Attributes:
        pairs: (J, 2) bodies a, b.
        maps: (2, J, 3, slots) X of the joint's node as the end of a, and of b.
        bodies: B.
        dense: whether matrices are arrays.
        linear: (L, n) rows of linear constraints.
    """

    pairs: IntArray
    maps: Array = field(repr=False)
    bodies: int
    dense: bool
    linear: Array = field(repr=False)

    @cached_property
    def _rows(self) -> tuple[Any, Array]:
        """C (3 J + L, n) with rows of length one, and what each was divided by; rows of nothing stay so."""
        J, slots = len(self.pairs), self.maps.shape[-1]
        size = np.append(np.sqrt(np.sum(self.maps**2, axis=(0, 3))).reshape(3 * J), np.linalg.norm(self.linear, axis=1))
        size[size <= RANK * size.max(initial=0.0)] = np.inf
        scaled = self.maps / size[: 3 * J].reshape(J, 3)[None, :, :, None]
        linear = self.linear / size[3 * J :, None]
        values = np.stack([scaled[0], -scaled[1]])
        row = np.broadcast_to(np.arange(3 * J).reshape(1, J, 3, 1), values.shape)
        column = slots * self.pairs.T[:, :, None, None] + np.arange(slots)
        column = np.broadcast_to(column, values.shape)
        shape = (3 * J, slots * self.bodies)
        if self.dense:
            C = np.zeros(shape)
            C[row.ravel(), column.ravel()] = values.ravel()
            return np.concatenate([C, linear]), size
        from scipy.sparse import coo_array, vstack

        own = coo_array((values.ravel(), (row.ravel(), column.ravel())), shape=shape)
        return vstack([own, coo_array(linear)]).tocsr(), size

    @property
    def rank(self) -> int:
        """Number of independent rows."""
        C, _ = self._rows
        return int(np.linalg.matrix_rank(C if self.dense else C.toarray(), rtol=RANK))

    @cached_property
    def _solve(self) -> Callable[[Array], Array]:
        """x (3 J + L,) -> (C Cᵀ)⁺ x, with C of rows of length one."""
        C, _ = self._rows
        if self.dense:
            inverse = np.linalg.pinv(C, rcond=RANK)
            return lambda x: np.asarray(inverse.T @ (inverse @ x))
        from scipy.sparse import eye_array
        from scipy.sparse.linalg import splu

        S = (C @ C.T).tocsc()
        factors = splu((S + SOFT * eye_array(S.shape[0], format="csc")).tocsc())

        def solve(x: Array) -> Array:
            found = factors.solve(x)
            for _ in range(2):  # what SOFT takes from the softest row of a long chain
                found = found + factors.solve(x - S @ found)
            return np.asarray(found)

        return solve

    def forces(self, pushes: Array, bias: Array) -> tuple[Array, Array]:
        """(J, 3) [N] on the end of a, and (L,) of the rows, for pushes y (n,) and bias (3 J + L,) [m/s²].

        The bias is how much faster a's end accelerates than b's, and a row than it should, where ÿ = 0.
        """
        C, size = self._rows
        wanted = -(bias / size) - C @ pushes
        joints, rows = np.split(self._solve(wanted) / size, [3 * len(self.pairs)])
        return joints.reshape(-1, 3), rows

    def project(self, y: Array) -> Array:
        """P y (n,)."""
        if self.dense:
            return np.asarray(self.projection @ y)
        C, _ = self._rows
        return np.asarray(y - C.T @ self._solve(C @ y))

    @cached_property
    def projection(self) -> Array:
        """P (n, n), dense: of the right singular vectors that the rows do not reach."""
        C, _ = self._rows
        C = C if self.dense else C.toarray()
        _, size, V = np.linalg.svd(C, full_matrices=False)
        held = V[size > RANK * size.max(initial=0.0)]
        return np.asarray(np.eye(C.shape[1]) - held.T @ held)


DENSE = 150  # coordinates up to which matrices are dense


def is_dense(bodies: int) -> bool:
    """Return whether the matrices of that many bodies are dense arrays."""
    return SLOTS * bodies <= DENSE


@dataclass(frozen=True, eq=False)
class Blocks:
    """A sum of blocks (..., slots, slots) of a matrix of bodies, at these rows and columns of blocks."""

    values: Array
    rows: IntArray
    columns: IntArray

    def times(self, factor: float) -> Blocks:
        """The blocks, each times a factor."""
        return Blocks(factor * self.values, self.rows, self.columns)

    def row_sums(self, bodies: int) -> float:
        """The largest sum of absolute values along a row of a matrix of that many bodies: a bound on eigenvalues."""
        if not len(self.rows):
            return 0.0
        sums = np.zeros((bodies + 1, self.values.shape[-1]))
        np.add.at(sums, self.rows, np.abs(self.values).sum(axis=2))
        return float(sums[:bodies].max(initial=0.0))


def spring_blocks(paths: Paths, directions: Array, along: Array, across: Array) -> Array:
    """(P, 3, 3) [N/m] of strings of stiffness (M,) along segments of unit vectors (S, 3), and (S,) across (T/l).

    A string has k (∇L)(∇L)ᵀ, which couples any two of its segments, and T times the Hessian of L: that of each alone.
    """
    first, second = paths.couples.T
    parallel = directions[first, :, None] * directions[second, None, :]
    stretching = along[paths.strings[first], None, None] * parallel
    turning = np.where(first == second, across[first], 0.0)[:, None, None] * (np.eye(3) - parallel)
    return np.asarray(stretching + turning)


class Assembly:
    """Matrices (n, n) of sums over couples of segments of Xᵀ W X, with W (P, 3, 3), and of blocks."""

    def __init__(self, structure: Structure, bodies: Bodies, turned: Array, joints: Joints | None) -> None:
        self.B, self.slots, self.joints = len(bodies.mass), bodies.slots, joints
        paths = structure.paths
        first, second = (
            [(p, turned[k], bodies.body[k]) for p, k in zip((1.0, -1.0), paths.nodes[rows].T, strict=True)]
            for rows in paths.couples.T
        )
        self._pairs = [(p * q * np.swapaxes(X, 1, 2), Y, a, b) for p, X, a in first for q, Y, b in second]

    def sum(self, blocks: Blocks) -> Any:
        """The matrix of blocks of bodies."""
        return self._matrix(blocks.values, blocks.rows, blocks.columns)

    def __call__(self, weights: Array, blocks: Blocks | None = None, between: bool = True) -> Any:
        """The matrix, with blocks added; `between` bodies there is nothing of strings without that."""
        found = []
        for X, Y, a, b in self._pairs if weights.any() else ():
            chosen = slice(None) if between else a == b
            found.append((X[chosen] @ weights[chosen] @ Y[chosen], a[chosen], b[chosen]))
        if blocks is not None:
            found.append((blocks.values, blocks.rows, blocks.columns))
        if not found:
            found.append((np.zeros((0, self.slots, self.slots)), np.zeros(0, np.int64), np.zeros(0, np.int64)))
        return self._matrix(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def _matrix(self, values: Array, row: IntArray, column: IntArray) -> Any:
        slots, size = self.slots, self.slots * self.B
        if is_dense(self.B):
            matrix = np.zeros((self.B + 1, self.B + 1, slots, slots))
            np.add.at(matrix, (row, column), values)
            free = matrix[: self.B, : self.B]  # without fixed nodes
            full = np.ascontiguousarray(free.transpose(0, 2, 1, 3)).reshape(size, size)
            return full if self.joints is None else self.joints.projection @ full @ self.joints.projection
        from scipy.sparse import coo_array

        inside = (row < self.B) & (column < self.B)
        values, row, column = values[inside], row[inside], column[inside]
        slot = np.arange(slots)
        at = (
            slots * row[:, None, None] + slot[:, None] + 0 * slot,
            slots * column[:, None, None] + 0 * slot[:, None] + slot,
        )
        return coo_array((values.ravel(), (at[0].ravel(), at[1].ravel())), shape=(size, size)).tocsr()
