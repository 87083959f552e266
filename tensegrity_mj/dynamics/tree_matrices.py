"""The constant matrices of the thesis' forms of the equations (`tree_equations`).

The mass matrix is constant: with Φ_i, Φ_j the (constant) derivatives of a rod's ends to q, it is the sum of
m/3 (Φ_iᵀΦ_i + Φ_jᵀΦ_j + (Φ_iᵀΦ_j + Φ_jᵀΦ_i)/2) over the rods, a linear profile of velocities integrated, and of what
they carry.
"""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.linked import LinkedRecords
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.model.rods import mass_products, own_masses

# What compiled code sees of them; n coordinates of the rods, C closures.
Tree, _pack_tree = view_of(
    "TreeMatrices",
    size="size",  # n
    loop_count="size",  # 3C
    map_count="size",
    held_count="size",
    rod_count="size",
    mass=("f8", "size", "size"),  # M, or its inverse for the K x K form
    loops=("f8", "loop_count", "size"),  # derivatives of the closures' gaps to the coordinates
    maps=("f8", "map_count", "size"),  # (6R, n) derivatives of the rods' ends, for the full form alone
    held=("f8", "held_count", "size"),  # rows of supports and planes, for the full form alone
    at=("i8", "rod_count"),  # where each rod's b starts among the coordinates
    roots=("i8", "rod_count"),  # where each root's r starts, -1 for other rods; for the full form alone
)


def dense_matrices(records: LinkedRecords) -> Table:
    """A `Tree` for (3.19)-(3.22): the coordinates are q of the records."""
    maps = end_maps(records, full=False)
    inverse = np.linalg.inv(mass_matrix(records, maps))
    at = np.array([records.rods[row]["q"] for row in range(len(records.rods))], np.int64)
    for link in records.links:
        at[link["rod"]] += link["nz"]
    nothing = np.zeros((0, records.rod_coordinates))
    loops = loop_matrix(records, maps)
    return _pack_tree(mass=0.5 * (inverse + inverse.T), loops=loops, maps=nothing, held=nothing, at=at, roots=at)


def full_matrices(records: LinkedRecords) -> Table:
    """A `Tree` for (3.17): b of every rod and r of every root, all in world components; supports are rows."""
    maps = end_maps(records, full=True)
    at, roots, size = _full_places(records)
    rows = []
    for number, rod in enumerate(records.structure.rods):
        supported = rod.support.constraint_rows if roots[number] >= 0 else np.zeros((0, 3))
        plane = [] if rod.support.plane is None else [rod.support.plane]
        for where, directions in ((roots[number], supported), (at[number], np.array(plane).reshape(-1, 3))):
            for direction in directions:
                row = np.zeros(size)
                row[where : where + 3] = direction / np.linalg.norm(direction)
                rows.append(row)
    return _pack_tree(
        mass=mass_matrix(records, maps),
        loops=loop_matrix(records, maps),
        maps=maps.reshape(-1, size),
        held=np.array(rows, float).reshape(-1, size),
        at=at,
        roots=roots,
    )


def _full_places(records: LinkedRecords) -> tuple[IntArray, IntArray, int]:
    """Where b of each rod and r of each root start among the coordinates of the full form, and how many there are."""
    at, roots, size = np.zeros(len(records.rods), np.int64), np.full(len(records.rods), -1, np.int64), 0
    for row in range(len(records.rods)):
        if records.forest.parent[row] < 0:
            roots[row] = size
            size += 3
        at[row] = size
        size += 3
    return at, roots, size


def end_maps(records: LinkedRecords, full: bool) -> Array:
    """(R, 2, 3, n): derivatives of the ends of every rod to q, or to the coordinates of the full form."""
    at, roots, size = _full_places(records)
    maps = np.zeros((len(records.rods), 2, 3, size if full else records.rod_coordinates))
    for link in records.links:
        row = int(link["rod"])
        rod = records.rods[row]
        if full:
            z, E, b, B = roots[row], np.eye(3), at[row], np.eye(3)
        else:
            z, E = rod["q"], rod["E"][:, : link["nz"]]
            b, B = rod["q"] + link["nz"], rod["B"][:, : rod["nb"]]
        ends = maps[row]
        if link["parent"] >= 0:
            start = int(link["hinge"])
            hung = maps[records.links[link["parent"]]["rod"], link["parent_end"]]
            ends[0], ends[1] = hung, hung
            ends[1 - start][:, b : b + B.shape[1]] += (1 if start == 0 else -1) * rod["length"] * B
        else:
            for end, lever in ((0, -rod["sigma"]), (1, 1 - rod["sigma"])):
                ends[end][:, z : z + E.shape[1]] = E
                ends[end][:, b : b + B.shape[1]] = lever * rod["length"] * B
    return maps


def mass_matrix(records: LinkedRecords, maps: Array) -> Array:
    """M (n, n), constant; for a chain of free rods (3.13) with the corrections of its misprints."""
    weighted = np.sqrt(own_masses(records.structure) / 3)[:, None, None, None] * maps
    first, second = (weighted[:, end].reshape(-1, maps.shape[-1]) for end in (0, 1))
    cross = first.T @ second
    matrix = np.asarray(first.T @ first + second.T @ second + 0.5 * (cross + cross.T))
    for row in np.flatnonzero(records.structure.rod_lumps[0]):
        a, b, c = mass_products(0.0, records.structure.rod_lumps[:, row])
        (one, other), both = maps[row], maps[row, 0].T @ maps[row, 1]
        matrix += a * one.T @ one + b * other.T @ other + c * (both + both.T)
    return matrix


def loop_matrix(records: LinkedRecords, maps: Array | None = None) -> Array:
    """(3C, n): derivatives of the closures' gaps to the rods' coordinates; the gaps are linear in them."""
    if not records.forest.closures:
        return np.zeros((0, records.rod_coordinates if maps is None else maps.shape[-1]))
    maps = end_maps(records, full=False) if maps is None else maps
    rows = [
        maps[other, int(records.rods[other]["j"] == node)] - maps[owner, int(records.rods[owner]["j"] == node)]
        for node, owner, other in records.forest.closures
    ]
    return np.array(rows).reshape(-1, maps.shape[-1])
