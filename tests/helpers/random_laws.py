"""Random laws of feedback linearization for random structures."""

from __future__ import annotations

import numpy as np

import tensegrity_mj as tmj
from evidence.random_structures import random_configuration
from tensegrity_mj.controllers import Gains, Lyapunov


def random_gains(rng, n):
    root = rng.normal(size=(2 * n, 2 * n))
    matrix = root @ root.T + np.eye(2 * n)
    return Gains(matrix[:n, :n], matrix[:n, n:], matrix[n:, n:])


def random_law(rng, structure, gravity, path):
    targets = [random_configuration(rng, structure, 0.5) for _ in range(3)]
    target = tmj.Target.path([0.0, 1.0, 2.5], targets) if path else tmj.Target.set_point(targets[0])
    sizes = {rod.name: rod.support.translation_basis.shape[1] for rod in structure.rods}
    sizes |= {point.node: point.translation_basis.shape[1] for point in structure.point_masses}
    return Lyapunov(
        structure,
        target,
        decay_rate=float(rng.uniform(0.1, 2)),
        translation={name: random_gains(rng, n) for name, n in sizes.items() if n},
        rotation={rod.name: random_gains(rng, 3) for rod in structure.rods},
        minimum_force_density=rng.uniform(0, 0.1, len(structure.strings)),
        gravity=gravity,
    )
