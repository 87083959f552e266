"""Joints of rods, and linear constraints, in the linear model of small motions: what they forbid, what they carry.

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
        """How many of the rows say what no other does."""
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
