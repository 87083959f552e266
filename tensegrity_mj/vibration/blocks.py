"""Matrices of small motions as sums of blocks: of pairs of bodies, and of strings between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.model.string_paths import Paths
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.vibration.bodies import SLOTS, Bodies
from tensegrity_mj.vibration.joints import Joints

DENSE = 150  # coordinates up to which matrices are dense


def is_dense(bodies: int) -> bool:
    """Whether the matrices of that many bodies are arrays."""
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
            kept = slice(None) if between else a == b
            found.append((X[kept] @ weights[kept] @ Y[kept], a[kept], b[kept]))
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
            kept = matrix[: self.B, : self.B]
            full = np.ascontiguousarray(kept.transpose(0, 2, 1, 3)).reshape(size, size)
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
