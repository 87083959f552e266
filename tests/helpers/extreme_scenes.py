"""Scenes whose numbers are far from 1."""

from __future__ import annotations

from dataclasses import replace

from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure


def extreme(**changes: float) -> Scene:
    """The pinned rod with a mass, and strings with a stiffness and so on, far from 1, within what scenes may have."""
    scene = load_scene("pinned_rod").with_(duration=0.02, target=None, control=None)
    structure = scene.structure
    size = changes.pop("size", 1.0)
    mass = changes.pop("mass", 1.0)
    force = changes.pop("force", 0.0)
    made = Structure(
        structure.name,
        {name: (size * x, size * y, size * z) for name, (x, y, z) in structure.nodes.items()},
        tuple(replace(rod, mass=mass) for rod in structure.rods),
        tuple(replace(string, **{"rest_length": None, "force_density": 0.0} | changes) for string in structure.strings),
        structure.fixed_nodes,
    )
    return Scene(made, duration=0.02, loads=(Load("n1", (0.0, 0.0, force)),) if force else ())
