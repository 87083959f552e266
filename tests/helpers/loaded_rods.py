"""Rods that carry masses, and the same mass as a cloud of points: what a test integrates over by itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj.model import PointMass, RodMass

SIMPSON = ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6))  # exact for all that is quadratic along a rod


def cloud(structure: tmj.Structure) -> Iterator[tuple[int, float, float]]:
    """(rod, s, mass) of points that have a structure's rods' and lumps' mass, first moment and moment of inertia.

    A lump of mass m and inertia I is two points m/2 at a distance √(I/m) from its centre.
    """
    for row, (rod, (i, j)) in enumerate(zip(structure.rods, structure.rod_nodes, strict=True)):
        length = float(np.linalg.norm(structure.positions[j] - structure.positions[i]))
        for s, weight in SIMPSON:
            yield row, s, weight * rod.mass
        for lump in rod.masses:
            apart = math.sqrt(lump.inertia / lump.mass) / length
            yield row, lump.at - apart, lump.mass / 2
            yield row, lump.at + apart, lump.mass / 2


def mass_of_nodes(structure: tmj.Structure) -> np.ndarray:
    """(N, N) [kg]: ½ v·M·v is the kinetic energy, the cloud's points moving with their parts of both ends."""
    mass = np.zeros((len(structure.nodes), len(structure.nodes)))
    for row, s, m in cloud(structure):
        share = np.array([1 - s, s])
        mass[np.ix_(structure.rod_nodes[row], structure.rod_nodes[row])] += m * np.outer(share, share)
    for point in structure.point_masses:
        node = structure.node_index[point.node]
        mass[node, node] += point.mass
    return mass


def loaded(scene: tmj.Scene, seed: int = 1, damping: float = 0.0) -> tmj.Scene:
    """The scene with two masses on each rod but the first, and point masses on some nodes of rods."""
    rng, structure = np.random.default_rng(seed), scene.structure

    def carried(mass: float) -> tuple[RodMass, ...]:
        at, part = rng.uniform(0, 1, 2), rng.uniform(0.2, 1.0, 2) * mass
        return RodMass(at[0], part[0]), RodMass(at[1], part[1], float(rng.uniform(0.0, 0.02)) * part[1])

    first, *others = structure.rods
    rods = (first, *(replace(rod, masses=carried(rod.mass)) for rod in others))
    ends = list(dict.fromkeys(name for rod in structure.rods for name in rod.nodes))
    points = tuple(PointMass(name, float(rng.uniform(0.1, 0.5)), damping=damping) for name in ends[1::2])
    return scene.with_(structure=replace(structure, rods=rods, point_masses=(*structure.point_masses, *points)))
