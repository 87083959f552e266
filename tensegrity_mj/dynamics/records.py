"""A structure as arrays of records: the one form in which compiled code sees rods, point masses and strings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.remembered import once
from tensegrity_mj.model.capabilities import require_class_1
from tensegrity_mj.model.rods import centers_and_moments, inertia_terms, own_masses
from tensegrity_mj.model.structure import Structure

Records = np.ndarray[Any, Any]

# q of a rod is (z, β): r = anchor + E z (2.41) and b = B β, with B the identity in space, a plane's basis if planar.
ROD = np.dtype(
    [
        ("i", "i8"),
        ("j", "i8"),
        ("q", "i8"),  # where its coordinates start
        ("nz", "i8"),
        ("nb", "i8"),
        ("mass", "f8"),
        ("center", "f8"),  # of mass, from 0 at i to 1 at j
        ("length", "f8"),
        ("sigma", "f8"),
        ("f", "f8"),  # (2.30)
        ("J", "f8"),
        ("per_length", "f8"),  # 1/ℓ and 1/J: to multiply is faster than to divide
        ("per_J", "f8"),
        ("E", "f8", (3, 3)),  # columns 0..nz-1
        ("B", "f8", (3, 3)),  # columns 0..nb-1
        ("rigid", "f8"),  # 1, or 0 of a rod whose length is free: b has all the motions that B gives it
        ("W", "f8", (3, 3)),  # E (m I - f²/J Eᵀ B Bᵀ E)⁻¹ Eᵀ: how r̈ answers a force, but for what b adds
        ("anchor", "f8", (3,)),
    ],
    align=True,
)
POINT = np.dtype(
    [
        ("node", "i8"),
        ("q", "i8"),
        ("nz", "i8"),
        ("mass", "f8"),
        ("E", "f8", (3, 3)),
        ("anchor", "f8", (3,)),
    ],
    align=True,
)


def rod_records(structure: Structure) -> Records:
    """The rods' records (R,) of `ROD`, each as if it were alone; where their coordinates start is left at 0."""
    rods = np.zeros(len(structure.rods), ROD)
    rods["i"], rods["j"] = structure.rod_nodes.T
    rods["mass"], rods["length"], rods["rigid"] = structure.rod_masses, structure.rod_lengths, ~structure.elastic
    rods["center"] = centers_and_moments(own_masses(structure), structure.rod_lengths, structure.rod_lumps)[0]
    for number, rod in enumerate(structure.rods):
        support, record = rod.support, rods[number]
        E, B, sigma = support.translation_basis, support.rotation_basis, support.sigma
        nz, nb = record["nz"], record["nb"] = E.shape[1], B.shape[1]
        length, lumps = float(structure.rod_lengths[number]), structure.rod_lumps[:, number]
        record["sigma"], (record["f"], record["J"]) = sigma, inertia_terms(rod.mass, length, sigma, lumps)
        record["E"][:, :nz], record["B"][:, :nb] = E, B
        if nz > 0:  # positive definite: f² < m J wherever the rod is held
            share = record["f"] ** 2 / record["J"] * E.T @ B @ B.T @ E
            record["W"] = E @ np.linalg.solve(record["mass"] * np.eye(nz) - share, E.T)
        i, j = structure.rod_nodes[number]
        r = (1 - sigma) * structure.positions[i] + sigma * structure.positions[j]
        record["anchor"] = r - E @ (E.T @ r)
    rods["per_length"], rods["per_J"] = 1.0 / rods["length"], 1.0 / rods["J"]
    return rods


def point_records(structure: Structure, offset: int) -> Records:
    """The point masses' records (P,) of `POINT`, their coordinates from place `offset` of q on."""
    points = np.zeros(len(structure.lone_masses), POINT)
    for record, point in zip(points, structure.lone_masses, strict=True):
        E = point.translation_basis
        row = structure.node_index[point.node]
        record["node"], record["q"], record["nz"], record["mass"] = row, offset, E.shape[1], point.mass
        record["E"][:, : E.shape[1]] = E
        record["anchor"] = structure.positions[row] - E @ (E.T @ structure.positions[row])
        offset += E.shape[1]
    return points


@dataclass(frozen=True, eq=False)
class MemberRecords:
    """Rods and point masses of a structure as records, with their coordinates q: (z, b) of each rod, z of each point.

    Attributes:
        structure: what they are of.
        rods, points: record arrays of `ROD` and `POINT`.
        nq: number of coordinates; b counts three (two in a plane).
    """

    structure: Structure
    rods: Records
    points: Records
    nq: int

    @property
    def translations(self) -> IntArray:
        """(R,): how many z of each rod are in q."""
        return self.rods["nz"]

    def state(self, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """q and q̇ (nq,) of node positions and velocities (N, 3)."""
        return self.coordinates(nodes), self.coordinates(velocities)

    def coordinates(self, nodes: Array) -> Array:
        """q (..., nq) of node positions (..., N, 3), or q̇ of velocities: E is orthogonal to anchors and motions."""
        rods, points, nz = self.rods, self.points, self.translations
        first, second, sigma = nodes[..., rods["i"], :], nodes[..., rods["j"], :], rods["sigma"][:, None]
        q = np.zeros((*nodes.shape[:-2], self.nq + 1))  # the last for what a basis has no direction for
        for bases, vectors, start, count in (
            (rods["E"], (1 - sigma) * first + sigma * second, rods["q"], nz),
            (rods["B"], (second - first) / rods["length"][:, None], rods["q"] + nz, rods["nb"]),
            (points["E"], nodes[..., points["node"], :], points["q"], points["nz"]),
        ):
            k = np.arange(3)
            places = np.where(k < count[:, None], start[:, None] + k, self.nq)
            q[..., places] = (vectors[..., None, :] @ bases)[..., 0, :]
        return q[..., : self.nq]


@once
def _of_class_1(structure: Structure) -> tuple[Records, Records, int]:
    """Rods, points and nq."""
    rods = rod_records(structure)
    sizes = rods["nz"] + rods["nb"]
    rods["q"] = np.cumsum(sizes) - sizes
    points = point_records(structure, int(sizes.sum()))
    return rods, points, int(sizes.sum() + points["nz"].sum())


@dataclass(frozen=True, eq=False)
class StructureRecords(MemberRecords):
    """Records of a structure of class 1, where every rod has its own z: nq is that of the thesis' model (2.91)."""

    @classmethod
    def of(cls, structure: Structure) -> StructureRecords:
        """The records of a structure.

        Raises:
            StructureError: where rods share nodes; `linked.LinkedRecords` has the model of those.
        """
        require_class_1(structure, "the laws of chapters 4 to 6 (use one of your own, a recording, or none) are")
        return cls(structure, *_of_class_1(structure))

    @cached_property
    def affine_map(self) -> tuple[Array, Array]:
        """Φ (3N, nq) and y (3N,) of (2.53), vec(N) = Φ q + y; nodes stacked one after another."""
        count = len(self.structure.nodes)
        phi = np.zeros((3 * count, self.nq))
        y = np.zeros(3 * count)
        for name in self.structure.fixed_nodes:
            row = self.structure.node_index[name]
            y[3 * row : 3 * row + 3] = self.structure.positions[row]
        for rod in self.rods:
            z = slice(rod["q"], rod["q"] + rod["nz"])
            b = slice(z.stop, z.stop + rod["nb"])
            for node, lever in ((rod["i"], -rod["sigma"]), (rod["j"], 1 - rod["sigma"])):
                rows = slice(3 * node, 3 * node + 3)
                phi[rows, z] = rod["E"][:, : rod["nz"]]
                phi[rows, b] = lever * rod["length"] * rod["B"][:, : rod["nb"]]
                y[rows] = rod["anchor"]
        for point in self.points:
            rows = slice(3 * point["node"], 3 * point["node"] + 3)
            phi[rows, point["q"] : point["q"] + point["nz"]] = point["E"][:, : point["nz"]]
            y[rows] = point["anchor"]
        return phi, y

    def node_accelerations(self, accelerations: Array) -> Array:
        """Φ q̈ (N, 3) [m/s²] of q̈ (nq,)."""
        return np.asarray(self.affine_map[0] @ accelerations).reshape(-1, 3)
