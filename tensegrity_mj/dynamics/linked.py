"""Rods that share nodes, and moved supports, as records: the coordinates of chapter 3 for any forest of rods.

q is (z, b) of every root and b of every other rod, in the order of the rods: a rod that hangs on another has its place
from there. So a hanging chain has the thesis' q = (b_1, ..., b_K), and node positions are linear in q. What a moved
support adds, d(t), moves its whole tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.kernels import direction_of, normalize_direction, place_points, translated
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, minus, plus, put, row_of, times, vector
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.dynamics.records import POINT, ROD, MemberRecords, Records, point_records, rod_records
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.forest import Forest, spanning_forest
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.structure import Structure

# Place of a rod in the forest; one record a rod, parents before children. An end is 0 (node i) or 1 (node j).
LINK = np.dtype(
    [
        ("rod", "i8"),
        ("nz", "i8"),  # how many z it has in q: none unless it is a root
        ("hinge", "i8"),  # the end where it hangs on its parent, -1 for a root
        ("parent", "i8"),  # place of the parent among the links, and the parent's end there
        ("parent_end", "i8"),
        ("owns", "i8", (2,)),  # whether the node of this end is placed by this rod, and loads there act on it
        ("closure", "i8", (2,)),  # the closure that holds this end, or -1
        ("held", "i8"),  # whether r may not move in all directions that b has, or the rod is heavier towards one end
        ("motion", "i8"),  # the motion of its support, or -1
        ("drive", "i8"),  # the motion of its tree's root, or -1
    ],
    align=True,
)

# A `LinkedRecords` for compiled code.
Linked, _pack_linked = view_of(
    "LinkedRecords",
    rods=(ROD, "rod_count"),  # `q` is where a rod's coordinates start, z first if it is a root
    links=(LINK, "rod_count"),
    points=(POINT, "point_count"),
    moved_nodes=("i8", "moved_count", 2),  # row and motion of the fixed nodes that move
    bases=("f8", "moved_count", 3),  # where they are without it [m]
    gaps=("f8", "closure_count", 2, 3),  # how far the other rod's end is from the owner's [m], and its rate [m/s]
    motions=("f8", "motion_count", 3, 3),  # displacement, velocity and acceleration now
)


@dataclass(frozen=True, eq=False)
class LinkedRecords(MemberRecords):
    """Rods of any class, point masses and moved supports as records.

    Attributes:
        forest: see `joints`.
        links: record array of `LINK`.
        rod_coordinates: how many of q are the rods'.
        table: a `Linked`; its `motions` are written before each use, `gaps` by `place_linked`.
    """

    forest: Forest
    links: Records
    rod_coordinates: int
    table: Table

    @classmethod
    def of(cls, structure: Structure, motions: Sequence[Motion] = (), moved: Array | None = None) -> LinkedRecords:
        """The records of a structure.

        Args:
            structure: a structure of any class.
            motions: motions of its supports.
            moved: (m, 3, 3), where the motions' current values are read from; an own array by default.

        Raises:
            SceneError: for a motion of a rod that hangs on another one, and so has no support of its own.
        """
        forest = spanning_forest(structure)
        rods, links, offset = rod_records(structure), np.zeros(len(structure.rods), LINK), 0
        places = np.empty(len(rods), np.int64)
        places[forest.order] = np.arange(len(rods))
        for row, record in enumerate(rods):
            record["q"] = offset
            link = links[places[row]]
            hangs = forest.parent[row] >= 0
            link["rod"], link["nz"] = row, 0 if hangs else record["nz"]
            link["hinge"], link["parent"], link["parent_end"] = -1, -1, -1
            if hangs:
                parent = int(forest.parent[row])
                link["hinge"], link["parent"] = int(forest.flipped[row]), places[parent]
                link["parent_end"] = int(rods[parent]["j"] == forest.hinge[row])
            link["owns"] = [forest.owner[record[end]] == row for end in ("i", "j")]
            link["closure"] = -1
            link["held"] = record["nz"] < record["nb"] or structure.rod_lumps[0, row] > 0
            offset += int(link["nz"] + record["nb"])
        for number, (node, _, other) in enumerate(forest.closures):
            links[places[other]]["closure"][int(rods[other]["j"] == node)] = number
        moved_nodes, bases = _attach_motions(structure, motions, links, places)
        for link in links:
            link["drive"] = link["motion"] if link["parent"] < 0 else links[link["parent"]]["drive"]
        points = point_records(structure, offset)
        table = _pack_linked(
            rods=rods,
            links=links,
            points=points,
            moved_nodes=moved_nodes,
            bases=bases,
            gaps=np.zeros((len(forest.closures), 2, 3)),
            motions=np.zeros((len(motions), 3, 3)) if moved is None else moved,
        )
        nq = offset + int(points["nz"].sum())
        return cls(structure, rods, points, nq, forest, links, offset, table)

    @property
    def translations(self) -> IntArray:
        """(R,): those of the roots; other rods have none of their own."""
        return np.where(self.forest.parent < 0, self.rods["nz"], 0)

    def place(self, q: Array, rates: Array) -> tuple[Array, Array]:
        """Node positions and velocities (N, 3) of q and q̇ (nq,), with the motions as they are now."""
        nodes, velocities = self.structure.positions.copy(), np.zeros_like(self.structure.positions)
        place_linked(self.table.address, q, rates, nodes, velocities)
        return nodes, velocities

    def node_accelerations(self, accelerations: Array) -> Array:
        """(N, 3) [m/s²] of q̈ (nq,), with the motions' accelerations as they are now."""
        motions = self.table["motions"]
        velocities = motions[:, 1].copy()
        motions[:, 1] = motions[:, 2]
        out = self.place(np.zeros(self.nq), accelerations)[1]
        motions[:, 1] = velocities
        return out


def _attach_motions(
    structure: Structure, motions: Sequence[Motion], links: Records, places: IntArray
) -> tuple[IntArray, Array]:
    """Write the motions of rods into their links; rows and motions (n, 2) of moved fixed nodes, and their places."""
    links["motion"] = -1
    rods = {rod.name: row for row, rod in enumerate(structure.rods)}
    nodes = []
    for number, motion in enumerate(motions):
        if motion.support in rods:
            link = links[places[rods[motion.support]]]
            if link["parent"] >= 0:
                raise SceneError(
                    f"motion of '{motion.support}': this rod hangs on others and has no support that holds it: move "
                    "the support of a pinned or constrained rod"
                )
            link["motion"] = number
        else:
            nodes.append((structure.node_index[motion.support], number))
    rows = np.array(nodes, np.int64).reshape(-1, 2)
    return rows, structure.positions[rows[:, 0]].copy()


def end_maps(records: LinkedRecords) -> Array:
    """(R, 2, 3, n): derivatives of the ends of every rod to q."""
    maps = np.zeros((len(records.rods), 2, 3, records.rod_coordinates))
    for link in records.links:
        rod, ends = records.rods[link["rod"]], maps[link["rod"]]
        z, nz, nb = rod["q"], link["nz"], rod["nb"]
        turning = slice(z + nz, z + nz + nb)
        if link["parent"] >= 0:
            start = int(link["hinge"])
            ends[:] = maps[records.links[link["parent"]]["rod"], link["parent_end"]]
            ends[1 - start][:, turning] += (1 if start == 0 else -1) * rod["length"] * rod["B"][:, :nb]
        else:
            for end, lever in ((0, -rod["sigma"]), (1, 1 - rod["sigma"])):
                ends[end][:, z : z + nz] = rod["E"][:, :nz]
                ends[end][:, turning] = lever * rod["length"] * rod["B"][:, :nb]
    return maps


def loop_matrix(records: LinkedRecords, maps: Array | None = None) -> Array:
    """(3C, n): derivatives of the closures' gaps to the rods' coordinates; the gaps are linear in them."""
    if not records.forest.closures:
        return np.zeros((0, records.rod_coordinates))
    maps = end_maps(records) if maps is None else maps
    rows = [
        maps[other, int(records.rods[other]["j"] == node)] - maps[owner, int(records.rods[owner]["j"] == node)]
        for node, owner, other in records.forest.closures
    ]
    return np.array(rows).reshape(-1, maps.shape[-1])


@inlined
def _put_end(linked: Any, link: Any, end: int, node: int, x: Any, v: Any, nodes: Any, velocities: Any) -> None:
    """Write an end of a rod as the node's, or how far it is from the node as the closure's gap."""
    if link.owns[end]:
        put(nodes, node, x)
        put(velocities, node, v)
    elif link.closure[end] >= 0:
        gap = linked.gaps[link.closure[end]]
        put(gap, 0, minus(x, row_of(nodes, node)))
        put(gap, 1, minus(v, row_of(velocities, node)))


@borrowing
def place_linked(address: int, q: Any, rates: Any, nodes: Any, velocities: Any) -> None:
    """Node positions and velocities (N, 3) of q and q̇; fixed nodes that do not move are left as they are.

    A node that several rods share is placed by the first of them in the forest; how far another's end is from it is
    written into `gaps` where a closure holds it there, and is zero elsewhere.
    """
    linked = Linked(address)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        at = rod.q + link.nz
        b, b_rate = direction_of(rod, q, at), direction_of(rod, rates, at)
        if link.hinge == 0:
            xi, vi = row_of(nodes, rod.i), row_of(velocities, rod.i)
            xj, vj = plus(xi, times(rod.length, b)), plus(vi, times(rod.length, b_rate))
        elif link.hinge == 1:
            xj, vj = row_of(nodes, rod.j), row_of(velocities, rod.j)
            xi, vi = minus(xj, times(rod.length, b)), minus(vj, times(rod.length, b_rate))
        else:
            r = plus(vector(rod.anchor), translated(ZERO, rod, link.nz, q))
            r_rate = translated(ZERO, rod, link.nz, rates)
            if link.motion >= 0:
                moved = linked.motions[link.motion]
                r, r_rate = plus(r, row_of(moved, 0)), plus(r_rate, row_of(moved, 1))
            back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
            xi, vi = minus(r, times(back, b)), minus(r_rate, times(back, b_rate))
            xj, vj = plus(r, times(ahead, b)), plus(r_rate, times(ahead, b_rate))
        _put_end(linked, link, 0, rod.i, xi, vi, nodes, velocities)
        _put_end(linked, link, 1, rod.j, xj, vj, nodes, velocities)
    for n in range(len(linked.moved_nodes)):
        node, moved = linked.moved_nodes[n, 0], linked.motions[linked.moved_nodes[n, 1]]
        put(nodes, node, plus(row_of(linked.bases, n), row_of(moved, 0)))
        put(velocities, node, row_of(moved, 1))
    place_points(q, rates, linked.points, nodes, velocities)


@borrowing
def normalize_linked(address: int, q: Any, rates: Any) -> None:
    """(3.23)-(3.24) for every rod."""
    linked = Linked(address)
    for k in range(len(linked.links)):
        rod = linked.rods[linked.links[k].rod]
        normalize_direction(rod, q, rates, rod.q + linked.links[k].nz)
