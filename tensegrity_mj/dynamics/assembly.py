"""Any structure as one system: natural coordinates, a constant mass matrix, and rows of constraints.

The coordinates are vectors of the world, three numbers each: r and b of every rod, the place of every point mass, and
the centre of mass r of every body with the axes e1, e2, e3 that turn with it. Node positions are linear in them,
n = Φ q + y, and so is all that joins or holds members: G q = g(t). What keeps members rigid is quadratic, v·w = const.
Where several members share a node, the first of them places it, and rows hold the others' points there. With fewer
coordinates and rows, a rod that hangs on another has b alone and its place from there: (3.17) of the thesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.dynamics.records import ROD, Records, rod_records
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.structure import Structure

# For rows of unit length, and singular values relative to the largest: smaller ones depend on others up to round-off.
RANK_TOLERANCE = 1e-9

# The system for compiled code. A pair is ½ v·v = const or v·w = const, of the vectors that start at these coordinates.
Assembly, _pack = view_of(
    "Assembly",
    redundant="size",  # whether the constraints depend on each other
    mass=("f8", "size", "size"),  # of n coordinates
    scale=("f8", "size"),  # of the coordinates in equations: 1/√ of their masses
    weights=("f8", "size"),  # the force of gravity g is the coordinate's weight times its component of g
    maps=("f8", "node_rows", "size"),  # Φ, three rows a node
    bases=("f8", "node_count", 3),  # y where nothing moves
    carried=("i8", "node_count"),  # the motion of a fixed node, or -1
    rods=(ROD, "rod_count"),  # `q` is where b starts
    pairs=("i8", "pair_count", 2),
    members=("i8", "pair_count"),  # the rod that a pair keeps at its length, or -1
    values=("f8", "pair_count"),  # the constants v·w
    factors=("f8", "pair_count"),  # of their equations: J of a rod, whose multiplier is (2.36) then
    lengths=("f8", "pair_count"),  # [m] that makes a length of v·w, or 0 where it is not reported
    rows=("f8", "row_count", "size"),  # G
    offsets=("f8", "row_count"),  # g where nothing moves
    drives=("f8", "row_count", "motion_count", 3),  # what each displacement d adds to g
    links=("i8", "row_count"),  # the linear constraint on nodes that a row is, or -1
    shares=("f8", "row_count"),  # the constraint's force is so many times the row's
)


@dataclass(frozen=True, eq=False)
class AssemblyRecords:
    """A structure as one system.

    Attributes:
        structure: what it is of.
        rods: record array of `ROD`.
        roots: (R,) where r of each rod starts, -1 for one that has its place from another.
        nq: number of coordinates.
        table: an `Assembly`.
        moved: (m, 3, 3) displacement, velocity and acceleration of the motions now.
    """

    structure: Structure
    rods: Records
    roots: IntArray
    nq: int
    table: Table
    moved: Array

    @classmethod
    def of(cls, structure: Structure, motions: Sequence[Motion], moved: Array, hung: bool = False) -> AssemblyRecords:
        """The system of a structure whose supports have these motions.

        Every rod has coordinates r and b; where rods are `hung` on others, those have b alone, and their places from
        these.
        """
        parts = _Parts(structure, motions, hung)
        for number, rod in enumerate(structure.rods):
            if rod.stiffness is None:
                parts.keep_length(number)
            parts.hold_rod(number)
        parts.place_bodies()
        parts.share_nodes()
        parts.hold_constraints()
        return cls(structure, parts.rods, parts.roots, parts.size, parts.packed(), moved)

    def state(self, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """q and q̇ (nq,) of node positions and velocities (N, 3)."""
        return self._coordinates(nodes), self._coordinates(velocities)

    def _coordinates(self, nodes: Array) -> Array:
        q = np.zeros(self.nq)
        at = 0
        for rod, root in zip(self.rods, self.roots, strict=True):
            first, second, at = nodes[rod["i"]], nodes[rod["j"]], int(rod["q"])
            if root >= 0:
                q[root : root + 3] = (1 - rod["sigma"]) * first + rod["sigma"] * second
            q[at : at + 3] = (second - first) / rod["length"]
            at += 3
        for point in self.structure.lone_masses:
            q[at : at + 3] = nodes[self.structure.node_index[point.node]]
            at += 3
        for frame in self.structure.moving_frames:
            q[at : at + 12] = (frame.fit @ nodes[frame.rows]).ravel()
            at += 12
        return q

    def deviations(self, q: Array) -> Array:
        """(pairs + rows,): how far the constraints, as in `slopes_of`, are off at q where nothing moves."""
        pairs, v = self.table["pairs"], q[self.table["pairs"][..., None] + np.arange(3)]
        factors = np.where(pairs[:, 0] == pairs[:, 1], 0.5, 1.0)
        products = factors * (np.sum(v[:, 0] * v[:, 1], axis=1) - self.table["values"])
        return np.concatenate([products, self.table["rows"] @ q - self.table["offsets"]])

    @property
    def coordinate_names(self) -> list[str]:
        """Names (nq,) of the coordinates, as text."""
        structure = self.structure
        rods = zip(structure.rods, self.roots, strict=True)
        members = [f"rod {rod.name}: {part}" for rod, root in rods for part in ("rb" if root >= 0 else "b")]
        members += [f"point mass {point.node}: r" for point in structure.lone_masses]
        moving = [body for body in structure.bodies if not body.held]
        members += [f"body {body.name}: {part}" for body in moving for part in ("r", "e1", "e2", "e3")]
        return [f"{member}{axis}" for member in members for axis in "xyz"]

    def node_accelerations(self, accelerations: Array) -> Array:
        """(N, 3) [m/s²] of q̈ (nq,), with the motions' accelerations as they are now."""
        out = np.asarray(self.table["maps"] @ accelerations).reshape(-1, 3)
        for node in np.flatnonzero(self.table["carried"] >= 0):
            out[node] += self.moved[self.table["carried"][node], 2]
        return out


class _Parts:
    """A system while it is put together.

    Attributes:
        size: n, the number of coordinates; those of the bodies start at `bodies`.
        ends: (R, 2, 3, n) derivatives of the rods' ends.
        maps, bases, carried: maps of the nodes, as in `Assembly`.
    """

    def __init__(self, structure: Structure, motions: Sequence[Motion], hung: bool) -> None:
        self.structure, self.count = structure, len(motions)
        self.rods, self.forest = rod_records(structure), spanning_forest(structure)
        has_place = self.forest.parent < 0 if hung else np.ones(len(self.rods), bool)
        self.rods["q"] = 3 * (np.arange(len(self.rods)) + np.cumsum(has_place))
        self.roots = np.where(has_place, self.rods["q"] - 3, -1)
        points = 3 * (len(self.rods) + int(np.sum(has_place)))
        self.bodies = points + 3 * len(structure.lone_masses)
        self.size = self.bodies + 12 * len(structure.moving_frames)
        self.motion_of = {motion.support: number for number, motion in enumerate(motions)}
        self.scale = np.zeros(self.size)  # where it is not that of the masses
        self.maps = np.zeros((len(structure.nodes), 3, self.size))
        self.bases, self.carried = np.zeros((len(structure.nodes), 3)), np.full(len(structure.nodes), -1)
        self._pairs: list[tuple[int, int, int, float, float, float]] = []
        self._rows: list[tuple[Array, float, Array]] = []
        self._links: dict[int, tuple[int, float]] = {}  # of a row
        self.place_rods()
        for name in structure.fixed_nodes:
            row = structure.node_index[name]
            self.bases[row], self.carried[row] = structure.positions[row], self.motion_of.get(name, -1)
        for number, point in enumerate(structure.lone_masses):
            at, row = points + 3 * number, structure.node_index[point.node]
            self.move(at, at, point.mass)
            self.weights[at : at + 3] = point.mass
            self.maps[row] = self.vector(at)
            if point.plane is not None:
                self.hold(np.array([point.plane]) @ self.maps[row], np.array([point.plane]) @ structure.positions[row])

    def vector(self, at: int) -> Array:
        """(3, n): the vector that starts at this coordinate."""
        return np.eye(3, self.size, at)

    def move(self, one: int, other: int, mass: float) -> None:
        """Add mass · v·w of two vectors to 2 T."""
        for x in range(3):
            self.mass[one + x, other + x] = self.mass[other + x, one + x] = mass

    def place_rods(self) -> None:
        """Set the ends, masses and weights of the rods in terms of each rod's r and b."""
        self.ends = np.zeros((len(self.rods), 2, 3, self.size))
        places, turns = np.zeros((2, len(self.rods), 3, self.size))
        for number in self.forest.order:
            rod, root, parent = self.rods[number], self.roots[number], self.forest.parent[number]
            held, sigma, turns[number] = self.vector(root), rod["sigma"], self.vector(int(rod["q"]))
            if root < 0:
                hinge = int(self.rods[parent]["j"] == self.forest.hinge[number])
                held, sigma = self.ends[parent, hinge], float(self.forest.flipped[number])
            for end in range(2):
                self.ends[number, end] = held + (end - sigma) * rod["length"] * turns[number]
            places[number] = held + (rod["sigma"] - sigma) * rod["length"] * turns[number]
        r, b = places.reshape(-1, self.size), turns.reshape(-1, self.size)
        m, f, J = (np.repeat(self.rods[name], 3)[:, None] for name in ("mass", "f", "J"))
        self.mass = r.T @ (m * r + f * b) + b.T @ (f * r + J * b)
        self.weights = (m * r + f * b).sum(axis=0)

    def keep_length(self, number: int) -> None:
        """Keep b of a rod a unit vector."""
        b = int(self.rods[number]["q"])
        self._pairs.append((b, b, number, 1.0, float(self.rods[number]["J"]), 0.0))

    def place_bodies(self) -> None:
        """Set masses and nodes of the bodies, and keep their axes orthonormal; held bodies have no coordinates."""
        for body, frame in zip(self.structure.bodies, self.structure.frames, strict=True):
            if body.held:
                self.bases[frame.rows] = self.structure.positions[frame.rows]
        for number, frame in enumerate(self.structure.moving_frames):
            r, axes = self.bodies + 12 * number, [self.bodies + 12 * number + 3 * k for k in (1, 2, 3)]
            mass = float(frame.masses.sum())
            self.move(r, r, mass)
            self.weights[r : r + 3] = mass
            for i, one in enumerate(axes):
                for j, other in enumerate(axes[: i + 1]):
                    self.move(one, other, frame.second[i, j])
                    self._pairs.append((one, other, -1, float(i == j), 1.0, float(np.abs(frame.offsets).max())))
                # Of a flat body one of them is zero: the constraints move that axis.
                self.scale[one : one + 3] = 1.0 / np.sqrt(np.trace(frame.second) / 3)
            for row, offsets in zip(frame.rows, frame.offsets, strict=True):
                self.maps[row] = self.vector(r) + sum(x * self.vector(at) for x, at in zip(offsets, axes, strict=True))

    def hold(self, rows: Array, values: Array, driven: Array | None = None, motion: str = "") -> None:
        """Keep rows (k, n) · q at values (k,), to which the displacement of this support adds `driven` (k, 3) d."""
        for number, (row, value) in enumerate(zip(rows, values, strict=True)):
            drives, length = np.zeros((self.count, 3)), float(np.linalg.norm(row))
            if driven is not None and motion in self.motion_of:
                drives[self.motion_of[motion]] = driven[number] / length
            self._rows.append((row / length, float(value) / length, drives))

    def hold_constraints(self) -> None:
        """Add the rows of the structure's linear constraints on nodes, none of which is a fixed one."""
        structure = self.structure
        for number, (one, row) in enumerate(zip(structure.constraints, structure.constraint_rows, strict=True)):
            linear, value = row @ self.maps.reshape(-1, self.size), row @ structure.positions.ravel()
            self._links[len(self._rows)] = number, 1.0 / float(np.linalg.norm(linear))
            self.hold(linear[None], np.array([value]), one.unit[None], one.name)

    def hold_rod(self, number: int) -> None:
        """Add the rows of a rod's support and plane; a rod that hangs on another has no support of its own."""
        rod, record, positions = self.structure.rods[number], self.rods[number], self.structure.positions
        support = rod.support
        if self.forest.parent[number] < 0:
            D, (i, j) = support.constraint_rows, (positions[record[end]] for end in "ij")
            r = (1 - support.sigma) * i + support.sigma * j
            self.hold(D @ self.vector(self.roots[number]), D @ r, D, rod.name)
        if support.plane is not None:
            self.hold(np.array([support.plane]) @ self.vector(int(record["q"])), np.zeros(1))

    def share_nodes(self) -> None:
        """Place every node by its first member, and hold the points of the other members there."""
        for number in self.forest.order:
            for end, node in enumerate(self.structure.rod_nodes[number].tolist()):
                gap = self.ends[number, end] - self.maps[node]
                if not np.any(self.maps[node]):
                    self.maps[node] = gap
                elif np.any(gap):  # a rod that hangs there is there
                    self.hold(gap, np.zeros(3))

    def packed(self) -> Table:
        """The table; rows that others imply are left out."""
        from scipy.linalg import qr

        rows = np.array([row for row, _, _ in self._rows]).reshape(-1, self.size)
        if len(rows):
            triangle, order = qr(rows.T, mode="r", pivoting=True)
            sizes = np.abs(np.diag(triangle))
            kept = np.sort(order[: len(sizes)][sizes > RANK_TOLERANCE])
            rows, self._rows = rows[kept], [self._rows[k] for k in kept]
            self._links = {place: self._links[k] for place, k in enumerate(kept.tolist()) if k in self._links}
        links = np.array([self._links.get(row, (-1, 0.0)) for row in range(len(rows))]).reshape(-1, 2)
        pairs = np.array(self._pairs, float).reshape(-1, 6)
        by_mass = self.scale == 0
        self.scale[by_mass] = 1.0 / np.sqrt(np.diag(self.mass)[by_mass])
        return _pack(
            redundant=0,
            mass=self.mass,
            scale=self.scale,
            weights=self.weights,
            maps=self.maps.reshape(-1, self.size),
            bases=self.bases,
            carried=self.carried,
            rods=self.rods,
            pairs=pairs[:, :2],
            members=pairs[:, 2],
            values=pairs[:, 3],
            factors=pairs[:, 4],
            lengths=pairs[:, 5],
            rows=rows,
            offsets=np.array([offset for _, offset, _ in self._rows]),
            drives=np.array([drive for _, _, drive in self._rows]).reshape(len(rows), self.count, 3),
            links=links[:, 0],
            shares=links[:, 1],
        )


def needs_assembly(structure: Structure) -> bool:
    """Return whether a structure has bodies or constraints, which only this form of the equations can simulate."""
    return bool(structure.bodies or structure.constraints)


def slopes_of(table: Table, q: Array) -> Array:
    """(pairs + rows, n): derivatives of the constraints at q, ½ v·v and v·w and G q."""
    turning = np.zeros((len(table["pairs"]), len(q)))
    for row, (one, other) in zip(turning, table["pairs"].tolist(), strict=True):
        factor = 0.5 if one == other else 1.0
        row[one : one + 3] += factor * q[other : other + 3]
        row[other : other + 3] += factor * q[one : one + 3]
    return np.concatenate([turning, table["rows"]])


def note_redundancy(table: Table, q: Array) -> None:
    """Write whether the constraints at q depend on each other, so that their forces are not the only ones."""
    together = slopes_of(table, q) * table["scale"]
    together /= np.linalg.norm(together, axis=1)[:, None]
    singular = np.linalg.svd(together, compute_uv=False) if len(together) else np.ones(1)
    free = len(together) <= len(q) and singular[-1] > RANK_TOLERANCE * singular[0]
    table["redundant"] = 0 if free else 1
