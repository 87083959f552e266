"""A spring to the ground as an element of one's own, and a small structure for elements to act on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj.model import Element, Work


@dataclass(frozen=True)
class GroundSpring(Element):
    """A spring of no length from a node to a place."""

    node: str
    stiffness: float
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    work = Work.STORED
    smooth = True

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any) -> Any:
        forces, row = np.zeros_like(nodes), scene.structure.node_index[self.node]
        forces[row] = self.stiffness * (np.array(self.place) - nodes[row])
        return forces

    def energy(self, scene: Any, nodes: Any) -> float:
        away = nodes[scene.structure.node_index[self.node]] - self.place
        return 0.5 * self.stiffness * float(away @ away)


def tethered(elements: Any = (), **scene: Any) -> tmj.Scene:
    """A free rod on two taut strings without dampers, which starts with a push."""
    nodes = {"a": (0.0, 0.0, 0.0), "b": (0.8, 0.1, 0.2), "p": (-0.6, 0.0, 0.1), "q": (1.3, 0.4, 0.0)}
    strings = (tmj.String("s1", ("p", "a"), 40.0, 0.0, 0.3), tmj.String("s2", ("b", "q"), 60.0, 0.0, 0.3))
    structure = tmj.Structure("tethered", nodes, (tmj.Rod("r", ("a", "b"), 0.7),), strings, fixed_nodes=("p", "q"))
    velocities = np.zeros((4, 3))
    velocities[:2] = (0.1, 0.4, -0.2)
    return tmj.Scene(structure, initial_velocities=velocities, elements=elements, **scene)
