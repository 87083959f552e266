"""Momenta of structures, which engines must keep."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model import rods
from tensegrity_mj.model.structure import Structure


def linear_momentum(structure: Structure, velocities: Array) -> Array:
    """Σ m v [kg m/s], (..., 3)."""
    return np.einsum("n,...ni->...i", rods.lumped_masses(structure), velocities)


def angular_momentum(structure: Structure, nodes: Array, velocities: Array) -> Array:
    """About the origin [kg m²/s], (..., 3): ∫ x × v dm over linear profiles of x and v."""
    (x1, x2), (v1, v2) = rods.ends(structure, nodes), rods.ends(structure, velocities)
    # ∫ x × v over the rod: (2 x1×v1 + x1×v2 + x2×v1 + 2 x2×v2) / 6.
    cross = (2 * np.cross(x1, v1) + np.cross(x1, v2) + np.cross(x2, v1) + 2 * np.cross(x2, v2)) / 6
    total = np.einsum("r,...ri->...i", structure.rod_masses, cross)
    for point in structure.point_masses:
        row = structure.node_index[point.node]
        total = total + point.mass * np.cross(nodes[..., row, :], velocities[..., row, :])
    return total
