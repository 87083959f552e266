"""Boundary conditions of a study of statics: the structure's supports, and further holds of the study.

All of it is linear in the node positions: G (x - x₀) = s d, with x (3N,) the nodes one after another, x₀ where they are
at first, d what the holds move by, and s the parameter of a path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.rigidity import body_motions, turned
from tensegrity_mj.model.structure import Structure

Matrix: TypeAlias = Array | sparse.csr_array

SMALL = 240  # coordinates 3N up to which matrices are dense
RANK = 1e-10  # of a block's largest singular value: rows below it say what others say already
NODES = kinds.names("node")


@value("hold", OptionError)
class Hold:
    """Nodes that a study holds where they are, or moves.

    Attributes:
        nodes: names, or one.
        directions: (r, 3) of which components of their displacement are held; None for all.
        displacement: [m] what they are moved by, once the path's parameter is 1. Its part along the held directions
            counts; a part outside them is refused.
    """

    nodes: Sequence[str] = field(NODES._replace(plain=lambda of: NODES.plain([of] if isinstance(of, str) else of)))
    directions: Sequence[Vector] | None = field(kinds.many(kinds.direction(), ""), default=None, none="None for all")
    displacement: Vector = field(kinds.vector(), default=(0.0, 0.0, 0.0))

    def __attrs_post_init__(self) -> None:
        for what in ("nodes", "directions"):
            if getattr(self, what) == ():
                raise refused(self, f"{what} = (); give one or more")
        moved = np.array(self.displacement)
        if np.linalg.norm(moved - self.basis.T @ (self.basis @ moved)) > 1e-9 * np.linalg.norm(moved):
            raise OptionError(
                f"hold of {', '.join(self.nodes)}: displacement = {self.displacement} m is not along its directions "
                f"{self.directions}; add the direction that it moves in"
            )

    @property
    def basis(self) -> Array:
        """(r, 3) orthonormal rows of the held directions."""
        if self.directions is None:
            return np.eye(3)
        _, singular, right = np.linalg.svd(np.array(self.directions), full_matrices=False)
        return np.asarray(right[singular > 1e-9 * singular[0]])


@dataclass(frozen=True, eq=False)
class Boundary:
    """The free coordinates y of node positions x = x₀ + s d + Z y; n = 3N, q of them free.

    Attributes:
        rows: G (c, n).
        Z: (n, q) orthonormal.
        moved: d (n,) [m], the smallest displacement of the nodes that moves the holds.
    """

    rows: sparse.csr_array
    Z: sparse.csr_array
    moved: Array

    @property
    def is_small(self) -> bool:
        """True where dense arrays are faster: a sparse matrix takes some tens of microseconds at any size."""
        return self.Z.shape[0] <= SMALL

    @cached_property
    def quick(self) -> tuple[Matrix, Matrix]:
        """G and Z, as dense arrays if they are small."""
        return (self.rows.toarray(), self.Z.toarray()) if self.is_small else (self.rows, self.Z)

    def straight_ways(self, *further: Array) -> Array:
        """Orthonormal directions (3, k) of the straight lines that nothing holds the whole on, nor do further rows."""
        shifts = np.tile(np.eye(3), (self.rows.shape[1] // 3, 1))
        rows = np.vstack([np.zeros((3, 3)), self.rows @ shifts, *(one @ shifts for one in further)])
        _, singular, right = np.linalg.svd(rows, full_matrices=False)
        return np.asarray(right[singular < 1e-9].T)

    @classmethod
    def of(cls, structure: Structure, holds: Sequence[Hold] = ()) -> Boundary:
        """Make the boundary from the supports of a structure and further holds.

        Raises:
            OptionError: for a node that there is not, or holds that contradict a support or each other.
        """
        index, n = structure.node_index, 3 * len(structure.nodes)
        rows: list[dict[int, float]] = []
        values: list[float] = []

        def add(weights: Sequence[tuple[int, float]], direction: ArrayLike, value: float = 0.0) -> None:
            axes = np.asarray(direction, float)
            rows.append({3 * node + k: w * float(axes[k]) for node, w in weights if w for k in range(3) if axes[k]})
            values.append(value)

        for rod, (i, j) in zip(structure.rods, structure.rod_nodes.tolist(), strict=True):
            sigma = rod.support.sigma
            for row in rod.support.constraint_rows:
                add([(i, 1.0 - sigma), (j, sigma)], row / np.linalg.norm(row))
            if rod.support.plane is not None:
                normal = np.array(rod.support.plane)
                add([(i, -1.0), (j, 1.0)], normal / np.linalg.norm(normal))
        for name in structure.fixed_nodes:
            for axis in np.eye(3):
                add([(index[name], 1.0)], axis)
        for body, frame in zip(structure.bodies, structure.frames, strict=True):
            corners = frame.rows[frame.base].tolist()
            for axis in np.eye(3):
                for corner in corners if body.held else ():
                    add([(corner, 1.0)], axis)
                for node, weights in frame.followers:
                    add([(node, -1.0), *zip(corners, weights.tolist(), strict=True)], axis)
        for point in structure.point_masses:
            if point.plane is not None:
                add([(index[point.node], 1.0)], np.array(point.plane) / np.linalg.norm(point.plane))
        for one in structure.constraints:
            add([(index[node], weight) for node, weight in one.nodes.items()], one.unit)
        for hold in holds:
            if not isinstance(hold, Hold):
                raise OptionError(f"holds: {hold!r} is no Hold; use Hold(nodes, directions, displacement)")
            for name in hold.nodes:
                check_known("hold", name, index, "node")
                for direction in hold.basis:
                    add([(index[name], 1.0)], direction, float(direction @ np.array(hold.displacement)))
        places = [(r, c, v) for r, row in enumerate(rows) for c, v in row.items()]
        r, c, v = (np.array(column) for column in zip(*places, strict=True)) if places else (np.zeros(0, int),) * 3
        G = sparse.csr_array((v.astype(float), (r, c)), shape=(len(rows), n))
        Z, moved = _solve(G, np.array(values))
        gap = np.abs(G @ moved - values)
        if gap.size and gap.max() > 1e-9 * np.abs(values).max():
            raise OptionError(
                "holds: they contradict a support of the structure or each other (a node cannot be moved where it is "
                "held); leave one of them out"
            )
        return cls(G, Z, moved)


def _solve(G: sparse.csr_array, values: Array) -> tuple[sparse.csr_array, Array]:
    """An orthonormal basis (n, q) of the x with G x = 0, and the smallest x with G x = values, block by block."""
    n = G.shape[1]
    moved = np.zeros(n)
    pattern = abs(G)  # of which no products cancel: rows may be orthogonal to each other
    count, labels = connected_components(pattern.T @ pattern, directed=False) if G.shape[0] else (n, np.arange(n))
    blocks = zip(_grouped(labels, count), _grouped(labels[G.indices[G.indptr[:-1]]], count), strict=True)
    entries: list[tuple[Array, Array, Array]] = [(np.zeros(0), np.zeros(0, int), np.zeros(0, int))]
    q = 0
    for columns, rows in blocks:
        dense = G[rows][:, columns].toarray() if len(rows) else np.zeros((0, len(columns)))
        left, singular, right = np.linalg.svd(dense)
        rank = int(np.sum(singular > RANK * singular.max(initial=0.0)))
        moved[columns] = right[:rank].T @ (left[:, :rank].T @ values[rows] / singular[:rank])
        free = right[rank:]
        entries.append((free.ravel(), np.tile(columns, len(free)), np.repeat(q + np.arange(len(free)), len(columns))))
        q += len(free)
    v, r, c = (np.concatenate(part) for part in zip(*entries, strict=True))
    Z = sparse.csr_array((v, (r, c)), shape=(n, q))
    Z.eliminate_zeros()
    return Z, moved


def _grouped(labels: IntArray, count: int) -> list[IntArray]:
    """Return for each label, from 0 on, the rows that have it."""
    return np.split(np.argsort(labels, kind="stable"), np.cumsum(np.bincount(labels, minlength=count))[:-1])


def lasting_motions(boundary: Boundary, nodes: Array) -> Array:
    """Orthonormal motions (3N, p) of the whole as one body that go on, as far as supports and holds leave them.

    A turn is one of them where what holds the nodes turns into itself: where it does not, the nodes leave the
    circle, and the motion is a mechanism of the structure and its supports.
    """
    G, Z = boundary.rows, boundary.Z
    bodies = body_motions(nodes)
    rows = [np.zeros((6, 6)), np.asarray(G @ bodies)]
    for held in G.toarray():
        change = np.asarray(Z.T @ turned(held.reshape(-1, 3)))
        rows.append(np.hstack([np.zeros_like(change), change]))
    _, values, right = np.linalg.svd(np.vstack(rows), full_matrices=False)
    left, size, _ = np.linalg.svd(bodies @ right[values < 1e-7].T, full_matrices=False)
    return np.asarray(left[:, size > 1e-9])
