"""External forces on nodes as an element: a scene's `loads`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.elements.element import Element, as_forces

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene


@dataclass(frozen=True)
class NodalLoads(Element):
    """The `loads` of its scene: `Load`s, or a function of time."""

    smooth = True
    vectorized = True
    compiled = "tensegrity_mj.dynamics.native.loads:pack_loads"
    arrays = "tensegrity_mj.engines.jax.effects:loads"
    label = "loads"

    def act(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
        """See `Element`."""
        times = np.broadcast_to(np.asarray(time, float), nodes.shape[:-2])
        forces = [as_forces(scene.nodal_forces(float(t)), nodes.shape[-2:]) for t in times.ravel()]
        return np.array(forces, float).reshape(nodes.shape)
