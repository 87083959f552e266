"""What follows from the ends of uniform thin rods: direction, energy, and the multiplier of rigidity; energy of all.

Every function takes node positions and velocities (..., N, 3) in the world frame, SI units.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, dot, norm
from tensegrity_mj.model.structure import Structure


def inertia_terms(mass: Any, length: Any, sigma: Any) -> tuple[Any, Any]:
    """f(σ) [kg m] and J(σ) [kg m²] of (2.30) for uniform rods; arguments broadcast."""
    return 0.5 * mass * length * (1 - 2 * sigma), mass * length**2 * (1 - 3 * sigma + 3 * sigma**2) / 3


def ends(structure: Structure, nodes: Array) -> tuple[Array, Array]:
    """Positions (or velocities) of the rods' first and second nodes, (..., R, 3) each."""
    return nodes[..., structure.rod_nodes[:, 0], :], nodes[..., structure.rod_nodes[:, 1], :]


def directions(structure: Structure, nodes: Array) -> Array:
    """b (..., R, 3) of (2.4): from a rod's first node to its second over its length; of velocities ḃ [1/s]."""
    first, second = ends(structure, nodes)
    return (second - first) / structure.rod_lengths[:, None]


def support_points(structure: Structure, nodes: Array) -> Array:
    """r (..., R, 3) of (2.6): the point (1 - σ) n_i + σ n_j of each rod."""
    first, second = ends(structure, nodes)
    sigma = np.array([rod.support.sigma for rod in structure.rods])[:, None]
    return (1.0 - sigma) * first + sigma * second


def kinetic_energy(structure: Structure, velocities: Array) -> Array:
    """Kinetic energy [J] of rods, point masses and bodies, (...): (2.25) in terms of the ends' velocities."""
    first, second = ends(structure, velocities)
    # ∫ |v|² over a linear velocity profile: (v1·v1 + v1·v2 + v2·v2) / 3.
    square = np.sum(first * first + first * second + second * second, axis=-1) / 3
    energy = 0.5 * np.sum(structure.rod_masses * square, axis=-1)
    for point in structure.point_masses:
        v = velocities[..., structure.node_index[point.node], :]
        energy = energy + 0.5 * point.mass * dot(v, v)
    for frame in structure.frames:
        v = velocities[..., frame.rows, :]
        energy = energy + 0.5 * np.einsum("...ax,ab,...bx->...", v, frame.masses, v)
    return energy


def lumped_masses(structure: Structure) -> Array:
    """(N,) [kg]: half a rod's mass at each end, point masses where they are. Exact for weight and momentum.

    Of a body as much at each node, of any sign, as the centre of mass is of them.
    """
    masses = np.zeros(len(structure.nodes))
    for pair, mass in zip(structure.rod_nodes, structure.rod_masses, strict=True):
        masses[pair] += 0.5 * mass
    for point in structure.point_masses:
        masses[structure.node_index[point.node]] += point.mass
    for body, frame in zip(structure.bodies, structure.frames, strict=True):
        masses[frame.rows] += body.mass * frame.fit[0]
    return masses


def gravity_energy(structure: Structure, nodes: Array, gravity: Array) -> Array:
    """-Σ m g·x [J], (...)."""
    return -(nodes @ np.asarray(gravity, float)) @ lumped_masses(structure)


def string_forces(structure: Structure, nodes: Array, tensions: Array) -> Array:
    """Forces of the strings on the nodes [N], (..., N, 3), for tensions (..., M)."""
    paths = structure.paths
    s = paths.spans(nodes)
    pull = np.moveaxis(s * (tensions[..., paths.strings] / norm(s))[..., None], -2, 0).copy()
    forces = np.zeros((len(structure.nodes), *pull.shape[1:]))
    for (i, j), one in zip(paths.nodes.tolist(), pull, strict=True):
        forces[i] += one
        forces[j] -= one
    return np.ascontiguousarray(np.moveaxis(forces, 0, -2))


def multipliers(
    structure: Structure, nodes: Array, velocities: Array, forces: Array, gravity: Array, r_accelerations: Array
) -> Array:
    """λ (..., R) [1/s²] of (2.36) from nodal forces (..., N, 3) and the accelerations r̈ (..., R, 3) at σ.

    λ = (|ḃ|/|b|)² - bᵀ (f r̈ - t_b) / (J |b|²); t_b collects the nodal forces and the weight.
    """
    first, second = ends(structure, forces)
    return multipliers_of_ends(structure, nodes, velocities, first, second, gravity, r_accelerations)


def multipliers_of_ends(
    structure: Structure,
    nodes: Array,
    velocities: Array,
    first: Array,
    second: Array,
    gravity: Array,
    r_accelerations: Array,
) -> Array:
    """The same from the forces (..., R, 3) on the two ends of each rod, where rods that share nodes pull each other."""
    length = structure.rod_lengths[:, None]
    sigma = _sigmas(structure)
    f, J = inertia_terms(structure.rod_masses, structure.rod_lengths, sigma)
    (x1, x2), (v1, v2) = ends(structure, nodes), ends(structure, velocities)
    b, b_rate = (x2 - x1) / length, (v2 - v1) / length
    t_b = length * ((1 - sigma)[:, None] * second - sigma[:, None] * first) + f[:, None] * np.asarray(gravity, float)
    square = dot(b, b)
    along = dot(b, f[:, None] * r_accelerations - t_b)
    return dot(b_rate, b_rate) / square - along / (J * square)


def force_densities(structure: Structure, multipliers: Array) -> Array:
    """J λ / ℓ² [N/m] of the rods, (..., R); negative in compression."""
    _, J = inertia_terms(structure.rod_masses, structure.rod_lengths, _sigmas(structure))
    return multipliers * J / structure.rod_lengths**2


def _sigmas(structure: Structure) -> Array:
    return np.array([rod.support.sigma for rod in structure.rods], float)
