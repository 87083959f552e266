"""Node positions and velocities as the joint coordinates of a scene's MuJoCo model."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.mjcf import quaternion, rotation_to
from tensegrity_mj.scene import Scene

Array = NDArray[np.float64]


def place(model: mujoco.MjModel, data: mujoco.MjData, scene: Scene, nodes: Array, velocities: Array) -> None:
    """Set joint coordinates and velocities from node positions and velocities; no rod spins about its axis.

    `scene` is the one that the model was made from.
    """
    structure, start = scene.structure, scene.nodes0
    for rod, (i, j), length in zip(structure.rods, structure.rod_nodes, structure.rod_lengths, strict=True):
        sigma, plane, E = rod.support.sigma, rod.support.plane, rod.support.translation_basis
        b = (nodes[j] - nodes[i]) / np.linalg.norm(nodes[j] - nodes[i])
        spin = np.cross(b, (velocities[j] - velocities[i]) / length)
        r = (1 - sigma) * nodes[i] + sigma * nodes[j]
        r_rate = (1 - sigma) * velocities[i] + sigma * velocities[j]
        body = model.site_bodyid[model.site(rod.nodes[0]).id]
        joint = model.body_jntadr[body]
        at, dof = model.jnt_qposadr[joint], model.body_dofadr[body]
        rotation, slides = rotation_to(b), E.shape[1]
        data.qvel[dof : dof + slides] = E.T @ r_rate
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            data.qpos[at : at + 3], data.qpos[at + 3 : at + 7] = r, quaternion(rotation)
            data.qvel[dof + 3 : dof + 6] = rotation.T @ spin
            continue
        # Slides and turns count from where the model was built.
        first = (1 - sigma) * start[i] + sigma * start[j]
        b0 = (start[j] - start[i]) / np.linalg.norm(start[j] - start[i])
        data.qpos[at : at + slides] = E.T @ (r - first)
        if plane is None:
            data.qpos[at + slides : at + slides + 4] = quaternion(rotation_to(b0).T @ rotation)
            data.qvel[dof + slides : dof + slides + 3] = rotation.T @ spin
        else:
            normal = np.array(plane) / np.linalg.norm(plane)
            data.qpos[at + slides] = np.arctan2(normal @ np.cross(b0, b), b0 @ b)
            data.qvel[dof + slides] = normal @ spin
    for point in structure.point_masses:
        row, E = structure.node_index[point.node], point.translation_basis
        body = model.site_bodyid[model.site(point.node).id]
        at, dof, slides = model.jnt_qposadr[model.body_jntadr[body]], model.body_dofadr[body], E.shape[1]
        data.qpos[at : at + slides] = E.T @ (nodes[row] - start[row])
        data.qvel[dof : dof + slides] = E.T @ velocities[row]
