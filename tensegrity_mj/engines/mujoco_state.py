"""Node positions and velocities as the joint coordinates of a scene's MuJoCo model."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.mjcf_tree import BodyTree, body_tree, joint_coordinates
from tensegrity_mj.scene import Scene

Array = NDArray[np.float64]


def place(data: mujoco.MjData, scene: Scene, nodes: Array, velocities: Array, tree: BodyTree | None = None) -> None:
    """Set joint coordinates and velocities from node positions and velocities; no rod spins about its axis.

    `scene` is the one that the model was made from; `tree` is its `body_tree`, where that is known.
    """
    tree = body_tree(scene) if tree is None else tree
    data.qpos[:], data.qvel[:] = joint_coordinates(scene, tree, nodes, velocities)
