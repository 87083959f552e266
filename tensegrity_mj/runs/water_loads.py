"""What water did to each rod along a run: Morison's loads at the recorded states, added mass included.

Drag, inertia of the water and buoyancy follow from recorded positions and velocities exactly. Added mass answers the
rods' accelerations, which are the slopes of the cubic spline through the recorded velocities: off by about h³/24 of
their third derivative between samples h apart, and more at the ends of the run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.water import rod_loads, samples_at_once

if TYPE_CHECKING:
    from tensegrity_mj.runs.trajectory import Trajectory


def water_loads(run: Trajectory) -> Array:
    """The force (T, R, 3) [N] of the water on each rod, in the world frame.

    Raises:
        OptionError: where the scene has no water or no rods, or the run fewer than two samples.
    """
    scene, structure = run.scene, run.scene.structure
    if scene.water is None or not len(structure.rods):
        raise OptionError(f"water_loads: scene '{scene.name}' has no {'rods' if scene.water else 'water'}")
    if len(run.time) < 2:
        raise OptionError(f"water_loads: the run has {len(run.time)} samples; two are needed for accelerations")
    ends = CubicSpline(run.time, run.velocities).derivative()(run.time)[:, structure.rod_nodes]
    span = np.diff(run.nodes[:, structure.rod_nodes], axis=2)
    axes = span / np.linalg.norm(span, axis=-1, keepdims=True)
    across = ends - np.sum(ends * axes, axis=-1, keepdims=True) * axes
    found, piece = np.zeros_like(across[:, :, 0]), samples_at_once(scene)
    for first in range(0, len(run.time), piece):
        rows = slice(first, first + piece)
        loads, alpha = rod_loads(scene, run.time[rows], run.nodes[rows], run.velocities[rows])
        found[rows] = loads.sum(axis=-2) - np.einsum("trij,trjx->trx", alpha, across[rows])
    return found
