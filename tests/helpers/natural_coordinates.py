"""Rods of any class by the positions of their nodes alone: a reference that knows no forest, no b and no joint.

Shared nodes are shared coordinates, so that joints need no equation. A rod is a linear profile of velocities between
its nodes, points of mass in the mass matrix, and a distance that stays. Supports are rows on its point at σ.
"""

from __future__ import annotations

import numpy as np
from loaded_rods import cloud, mass_of_nodes

from tensegrity_mj.model import rods
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.structure import Structure


def mass_matrix(structure):
    """(3N, 3N); nodes without mass have a unit that no force reaches, for they are held."""
    mass = mass_of_nodes(structure)
    for name in structure.fixed_nodes:
        mass[structure.node_index[name], structure.node_index[name]] = 1.0
    return np.kron(mass, np.eye(3))


def constraints(structure, nodes, velocities, moved=None):
    """Rows (c, 3N) and right sides (c,) of what the nodes' accelerations obey; rods' lengths come first.

    `moved` maps a support to its (3, 3) displacement, velocity and acceleration.
    """
    moved = moved or {}
    size = nodes.size
    rows, right = [], []

    def require(terms, value):
        row = np.zeros(size)
        for node, part in terms:
            row[3 * node : 3 * node + 3] += part
        rows.append(row)
        right.append(value)

    for i, j in structure.rod_nodes:
        d, v = nodes[j] - nodes[i], velocities[j] - velocities[i]
        require([(i, -d), (j, d)], -v @ v)
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
        support = rod.support
        acceleration = moved[rod.name][2] if rod.name in moved else np.zeros(3)
        for direction in support.constraint_rows:
            unit = np.array(direction) / np.linalg.norm(direction)
            require([(i, (1 - support.sigma) * unit), (j, support.sigma * unit)], unit @ acceleration)
        if support.plane is not None:
            unit = np.array(support.plane) / np.linalg.norm(support.plane)
            require([(i, -unit), (j, unit)], 0.0)
    for name in structure.fixed_nodes:
        acceleration = moved[name][2] if name in moved else np.zeros(3)
        for k in range(3):
            require([(structure.node_index[name], np.eye(3)[k])], acceleration[k])
    for point in structure.point_masses:
        if point.plane is not None:
            require([(structure.node_index[point.node], np.array(point.plane))], 0.0)
    return np.array(rows), np.array(right)


def accelerations(structure, nodes, velocities, forces, gravity, moved=None):
    """Node accelerations (N, 3), and each rod's force density [N/m], negative in compression.

    By Gauss's principle: the accelerations nearest to the free ones in the metric of the masses that obey all rows,
    which redundant rows do not change. Force densities are those of least norm where they are not determined.
    """
    mass = mass_matrix(structure)
    root = np.linalg.cholesky(mass)
    weight = np.zeros_like(nodes)
    for row, s, m in cloud(structure):
        weight[structure.rod_nodes[row]] += m * np.outer((1 - s, s), gravity)
    for point in structure.point_masses:
        weight[structure.node_index[point.node]] += point.mass * np.asarray(gravity)
    rows, right = constraints(structure, nodes, velocities, moved)
    free = np.linalg.solve(mass, (forces + weight).ravel())
    scaled = np.linalg.solve(root, rows.T).T
    answer, _, _, _ = np.linalg.lstsq(scaled @ scaled.T, right - rows @ free, rcond=1e-11)
    out = free + np.linalg.solve(mass, rows.T @ answer)
    return out.reshape(-1, 3), -answer[: len(structure.rods)]


def consistent_velocities(structure, nodes, velocities, moved=None):
    """The velocities (N, 3) nearest to those given that all constraints allow."""
    rows, _ = constraints(structure, nodes, np.zeros_like(nodes))
    shifted = {name: np.array([d[1], d[1], d[1]]) for name, d in (moved or {}).items()}
    _, right = constraints(structure, nodes, np.zeros_like(nodes), shifted)
    change = np.linalg.lstsq(rows, right - rows @ velocities.ravel(), rcond=1e-11)[0]
    out = velocities + change.reshape(-1, 3)
    for name in structure.fixed_nodes:  # exactly, not up to round-off
        out[structure.node_index[name]] = moved[name][1] if name in (moved or {}) else 0.0
    return out


def chain(rng, count, top=None, spread=1.0, sigmas=True):
    """A chain of rods of random directions, lengths and masses from the origin on; `top` is the first one's support."""
    directions = rng.normal(size=(count, 3)) * [spread, spread, 1.0] - [0.0, 0.0, 1.0]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    lengths = rng.uniform(0.2, 1.0, count)
    nodes = np.concatenate([np.zeros((1, 3)), np.cumsum(directions * lengths[:, None], axis=0)])
    supports = [Support.free(rng.uniform() if sigmas else 0.0) for _ in range(count)]
    supports[0] = Support.pinned(0.0) if top is None else top
    return Structure.from_arrays(
        nodes,
        [(k, k + 1) for k in range(count)],
        [],
        rod_mass=rng.uniform(0.3, 2.0, count),
        stiffness=1.0,
        supports=supports,
        name="chain",
    )


def random_class_k(rng, rods=7, loops=2, planar=False):
    """Rods that touch at random: a tree with some loops, some rods held somehow, some strings, fixed nodes, masses.

    Loops of three rods and more stay movable or not as chance has it; both are structures.
    """
    count = rods - loops + 1
    nodes = rng.uniform(-1, 1, size=(count + 2, 3))
    plane = (0.0, 0.6, 0.8) if planar else None
    if planar:
        nodes -= np.outer(nodes @ np.array(plane), plane)
    pairs = [(int(rng.integers(k)), k) if rng.random() < 0.5 else (k, int(rng.integers(k))) for k in range(1, count)]
    while len(pairs) < rods:
        i, j = (int(k) for k in rng.choice(count, 2, replace=False))
        if (i, j) not in pairs and (j, i) not in pairs:
            pairs.append((i, j))
    supports = []
    for _ in pairs:
        chance, sigma = rng.random(), float(rng.choice([0.0, 0.3, 1.0]))
        if chance < 0.15:
            supports.append(Support.pinned(sigma, plane=plane))
        elif chance < 0.35:
            rows = rng.normal(size=(1, 3))
            if plane is not None:  # within the plane, which holds the height by itself
                rows -= np.outer(rows @ np.array(plane), plane)
            supports.append(Support.constrained(rows, sigma, plane=plane))
        else:
            supports.append(Support.free(rng.uniform(), plane=plane))
    strings = [(count, int(rng.integers(count))), (count + 1, int(rng.integers(count))), (count, count + 1)]
    return Structure.from_arrays(
        nodes,
        pairs,
        strings,
        rod_mass=rng.uniform(0.3, 2.0, rods),
        stiffness=50.0,
        damping=0.5,
        force_density=rng.uniform(1, 5, 3),
        supports=supports,
        fixed_nodes=(count,),
        point_masses={count + 1: 0.7},
        name="random class k",
    )


def request(scene):
    """What an engine's accelerations are requested with."""
    from tensegrity_mj.dynamics.native.law import native_law
    from tensegrity_mj.engines.request import Request
    from tensegrity_mj.model.actuation import Actuation, OnInfeasible

    native = native_law(None, scene.structure)
    return Request(scene, native, Actuation.continuous(), OnInfeasible.STOP, 1.0, None, progress=False)


def string_forces(structure, nodes, velocities):
    """(N, 3) [N] of clipped strings with dampers."""
    lengths, rates = structure.string_lengths(nodes), structure.string_rates(nodes, velocities)
    stretch = lengths - structure.rest_lengths
    pull = np.where(stretch > 0, np.maximum(0.0, structure.stiffness * stretch + structure.damping * rates), 0.0)
    return rods.string_forces(structure, nodes, pull)
