"""A structure's members at some nodes, all counted alike: how their lengths change, and what forces in them stiffen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.rigidity import Members, members_at, nodal_forces
from tensegrity_mj.model.string_paths import Paths
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.body_motions import lasting_motions
from tensegrity_mj.statics.boundary import Boundary
from tensegrity_mj.statics.signs import Flags

RANK = 1e-9  # of the largest singular value, as in `self_stress`


@dataclass(frozen=True, eq=False)
class Assembly:
    """B at some nodes, its null spaces, and the forms of prestress; M strings come first, R rods after them.

    Attributes:
        nodes: (N, 3) [m].
        whole: (M,) strings that are not broken.
        members: lengths and directions of the strings' segments, and of the rods behind them (S + R).
        B: (M + R, q) how lengths change with the free coordinates of the boundary.
    """

    structure: Structure
    boundary: Boundary
    nodes: Array
    whole: Flags
    members: Members
    B: Array

    @classmethod
    def of(cls, structure: Structure, boundary: Boundary, nodes: Array, whole: Flags) -> Assembly:
        """At nodes (N, 3); OptionError for a member without length."""
        paths = member_paths(structure)
        members = members_at(paths.nodes, nodes)
        if len(paths.nodes) and members.lengths.min() == 0:
            names = [one.name for one in structure.strings] + [one.name for one in structure.rods]
            name = names[int(paths.strings[members.lengths.argmin()])]
            raise OptionError(f"'{name}' has no length at these nodes, and so no direction: look at other nodes")
        slopes = -paths.total(nodal_forces(paths.nodes, members.directions, len(nodes))).T
        slopes[: len(whole)][~whole] = 0.0
        B = np.asarray((boundary.Z.T @ slopes.T).T)
        return cls(structure, boundary, nodes, whole, members, B)

    @cached_property
    def bodies(self) -> Array:
        """Orthonormal motions (3N, p) of the whole as one body that go on, as far as supports and holds leave them."""
        return lasting_motions(self.boundary, self.nodes)

    def without_bodies(self, motions: Array) -> Array:
        """An orthonormal basis (3N, m) of motions of orthonormal free coordinates (q, a), those of the whole apart."""
        Z = self.boundary.Z
        others = Z.T @ self.bodies
        if others.shape[1]:
            left, values, _ = np.linalg.svd(motions - others @ (others.T @ motions), full_matrices=False)
            motions = left[:, values > 0.5]
        return np.asarray(Z @ motions)

    def loose(self, taut: Flags) -> Array:
        """(3N, k) what neither rods nor taut strings resist, to first order, motions of the whole apart."""
        M = len(taut)
        rows = np.concatenate([self.B[:M][taut], self.B[M:]])
        _, values, right = np.linalg.svd(rows) if len(rows) else (None, np.zeros(0), np.eye(self.B.shape[1]))
        return self.without_bodies(right[rank_of(values) :].T)

    def form(self, forces: Array, motions: Array) -> Array:
        """(k, k) [N/m]: Σ t/L (v·v - (v·s)²) of the members' relative motions v, for motions (3N, k)."""
        return np.asarray(np.einsum("t,tmn->mn", forces, self.forms(motions)))

    def forms(self, motions: Array) -> Array:
        """(M + R, k, k) [1/m] the same for 1 N in each member."""
        paths, (lengths, directions) = member_paths(self.structure), self.members
        moved = motions.reshape(len(self.nodes), 3, -1)
        apart = moved[paths.nodes[:, 1]] - moved[paths.nodes[:, 0]]
        along = np.einsum("tx,txm->tm", directions, apart)
        square = np.einsum("txm,txn->tmn", apart, apart) - along[:, :, None] * along[:, None, :]
        return np.asarray(paths.total(square / lengths[:, None, None], axis=0))

    def stress_matrix(self, forces: Array) -> Array:
        """(N, N) [N/m] of forces (M + R,) [N] of the members."""
        paths = member_paths(self.structure)
        density = forces[paths.strings] / self.members.lengths
        C = np.zeros((len(paths.nodes), len(self.nodes)))
        rows = np.arange(len(paths.nodes))
        C[rows, paths.nodes[:, 0]], C[rows, paths.nodes[:, 1]] = -1.0, 1.0
        return np.asarray(C.T @ (density[:, None] * C))


def member_paths(structure: Structure) -> Paths:
    """The segments of M strings, and behind them R rods as strings of one segment each."""
    return structure.paths.followed_by(structure.rod_nodes)


def rank_of(values: Array) -> int:
    """How many singular values count."""
    return int(np.sum(values > RANK * values.max(initial=0.0))) if values.size else 0
