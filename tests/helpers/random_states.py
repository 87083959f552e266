"""Random states of random structures."""

from __future__ import annotations

import numpy as np

from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw

SUPPORTS = ["free", "pinned", "constrained"]


def random_state(seed: int, planar: bool, law: StringLaw = StringLaw.CLIPPED) -> Scene:
    """Every support, point masses, slack strings, dampers, gravity, loads, motion."""
    rng = np.random.default_rng([seed, planar])
    structure = random_structure(
        rng,
        rods=1 + seed % 5,
        support=SUPPORTS[seed % 4] if seed % 4 < 3 else SUPPORTS,
        planar=planar,
        own_planes=0.3,
        point_masses=seed % 3,
        stretch=(-0.2, 0.4),
        damping=(0.0, 3.0),
        law=law,
    )
    return random_scene(rng, structure, displaced=0.3, moving=2.0, gravity=True, loads=2)
