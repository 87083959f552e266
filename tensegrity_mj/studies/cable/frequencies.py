"""The small oscillations of a hanging chain, as an engine's own equations have them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.actuation import OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.simulation import request_for
from tensegrity_mj.studies.cable.cases import DIRECTION
from tensegrity_mj.studies.cable.chain import Chain

LEAN = 1e-3  # of a rod, for central differences of order four: their error is 1e-12 of a frequency, round-off less


def engine_frequencies(scene: Scene, engine: Any, direction: tuple[float, float, float] = DIRECTION) -> Array:
    """Frequencies (K,) [Hz], ascending, of a chain's motion in a vertical plane.

    Each rod in turn is inclined by little, and the engine's accelerations show how all directions are accelerated.

    Args:
        scene: a chain that hangs at rest, its top at rest too.
        engine: MuJoCo(...), DAE(...).
        direction: of the plane.
    """
    chain = Chain.of(scene.structure)
    along = np.asarray(direction, float) / np.linalg.norm(direction)
    up = -np.asarray(scene.gravity) / np.linalg.norm(scene.gravity)
    at = engine.accelerations(request_for(scene, None, None, None, OnInfeasible.STOP, None, False))
    top = scene.nodes0[chain.nodes[0]]
    still = np.zeros_like(scene.nodes0)

    def directions_accelerated(rod: int, lean: float) -> Array:
        b = np.tile(-up, (len(chain.rods), 1))
        b[rod] = lean * along - np.sqrt(1.0 - lean**2) * up
        nodes = np.array(scene.nodes0)
        nodes[chain.nodes] = top + np.vstack([np.zeros(3), np.cumsum(chain.lengths[:, None] * b, axis=0)])
        acceleration = at(0.0, nodes, still)[1][chain.nodes]
        return np.diff(acceleration @ along) / chain.lengths

    A = np.empty((len(chain.rods),) * 2)
    for rod in range(len(chain.rods)):
        near, far = (directions_accelerated(rod, k * LEAN) - directions_accelerated(rod, -k * LEAN) for k in (1, 2))
        A[:, rod] = (8.0 * near - far) / (12.0 * LEAN)
    return np.sort(np.sqrt(-np.linalg.eigvals(A).real)) / (2.0 * np.pi)
