"""Rods that share nodes in the coordinates of their nodes: nothing hangs on anything, joints need no equation.

The mass matrix of a uniform rod is m/3, m/6, m/6, m/3 between its ends; its weight is half at each. Rods' lengths,
supports and planes are constraints, whose forces a least-squares solution of one dense system gives. No engine works
so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.model import rods
from tensegrity_mj.model.scene import Scene

Array = NDArray[np.float64]


def solve(
    scene: Scene, nodes: Array, velocities: Array, tensions: Array | None = None, time: float = 0.0
) -> tuple[Array, Array, Array]:
    """Node accelerations (N, 3), the rods' force densities (R,) and the forces of supports on nodes (N, 3)."""
    structure, N = scene.structure, len(scene.structure.nodes)
    mass, lines, right = np.zeros((3 * N, 3 * N)), [], []
    motions = {motion.support: motion.at(time)[2] for motion in scene.motions}
    still = np.zeros(3)

    def at(node: int) -> slice:
        return slice(3 * node, 3 * node + 3)

    def require(terms: list[tuple[int, Array]], value: float) -> None:
        line = np.zeros(3 * N)
        for node, part in terms:
            line[at(node)] += part
        lines.append(line)
        right.append(value)

    for (i, j), m in zip(structure.rod_nodes, structure.rod_masses, strict=True):
        for one, other, share in ((i, i, 1 / 3), (i, j, 1 / 6), (j, i, 1 / 6), (j, j, 1 / 3)):
            mass[at(one), at(other)] += share * m * np.eye(3)
        s, v = nodes[j] - nodes[i], velocities[j] - velocities[i]
        require([(i, -s), (j, s)], -float(v @ v))
    for point in structure.point_masses:
        row = structure.node_index[point.node]
        mass[at(row), at(row)] += point.mass * np.eye(3)
        if point.plane is not None:
            require([(row, np.array(point.plane))], 0.0)
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
        sigma = rod.support.sigma
        for row in rod.support.constraint_rows:
            require([(i, (1 - sigma) * row), (j, sigma * row)], float(row @ motions.get(rod.name, still)))
        if rod.support.plane is not None:
            require([(i, -np.array(rod.support.plane)), (j, np.array(rod.support.plane))], 0.0)
    for name in structure.fixed_nodes:
        row = structure.node_index[name]
        mass[at(row), at(row)] = np.eye(3)
        for axis in np.eye(3):
            require([(row, axis)], float(axis @ motions.get(name, still)))
    if tensions is None:
        lengths = structure.string_lengths(nodes)
        tensions = structure.stiffness * np.maximum(lengths - structure.rest_lengths, 0.0)
    force = rods.string_forces(structure, nodes, tensions) + scene.nodal_forces(time)
    force = force + np.outer(rods.lumped_masses(structure), scene.gravity)
    C = np.array(lines)
    C /= (scale := np.linalg.norm(C, axis=1))[:, None]
    root = np.linalg.cholesky(mass)
    half = np.linalg.solve(root, C.T)  # C M⁻¹ Cᵀ = halfᵀ half
    free = np.linalg.solve(mass, force.ravel())
    pull = np.linalg.pinv(half.T @ half, rcond=1e-13) @ (np.array(right) / scale - C @ free)
    accelerations = free + np.linalg.solve(mass, C.T @ pull)
    R = len(structure.rods)
    held = (C[R:].T @ pull[R:]).reshape(-1, 3)
    for name in structure.fixed_nodes:  # which have no mass but for this matrix to have an inverse
        row = structure.node_index[name]
        held[row] -= accelerations.reshape(-1, 3)[row]
    return accelerations.reshape(-1, 3), -pull[:R] / scale[:R], held
