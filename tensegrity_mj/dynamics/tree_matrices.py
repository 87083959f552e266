"""The constant matrices of the thesis' K x K form of the equations (`tree_equations`).

The mass matrix is constant: with Φ_i, Φ_j the (constant) derivatives of a rod's ends to q, it is the sum of
m/3 (Φ_iᵀΦ_i + Φ_jᵀΦ_j + (Φ_iᵀΦ_j + Φ_jᵀΦ_i)/2) over the rods, a linear profile of velocities integrated, and of what
they carry.
"""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.linked import LinkedRecords
from tensegrity_mj.dynamics.native.views import Table, view_of
from tensegrity_mj.model.rods import mass_products, own_masses

# What compiled code sees of them; n coordinates of the rods, C closures.
Tree, _pack_tree = view_of(
    "TreeMatrices",
    inverse=("f8", "size", "size"),  # M⁻¹
    loops=("f8", "loop_count", "size"),  # (3C, n) derivatives of the closures' gaps to the coordinates
    maps=("f8", "map_count", "size"),  # (6R, n) derivatives of the rods' ends
    at=("i8", "rod_count"),  # where each rod's b starts among the coordinates
)


def tree_matrices(records: LinkedRecords) -> Table:
    """A `Tree`, whose coordinates are q of the records."""
    maps = end_maps(records)
    inverse, loops = np.linalg.inv(mass_matrix(records, maps)), loop_matrix(records, maps)
    at = records.rods["q"].copy()
    at[records.links["rod"]] += records.links["nz"]
    return _pack_tree(inverse=0.5 * (inverse + inverse.T), loops=loops, maps=maps.reshape(-1, len(inverse)), at=at)


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
        return np.zeros((0, records.rod_coordinates))
    maps = end_maps(records) if maps is None else maps
    rows = [
        maps[other, int(records.rods[other]["j"] == node)] - maps[owner, int(records.rods[owner]["j"] == node)]
        for node, owner, other in records.forest.closures
    ]
    return np.array(rows).reshape(-1, maps.shape[-1])
