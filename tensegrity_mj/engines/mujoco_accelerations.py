"""Node accelerations of the MuJoCo model at any state, without a step of integration."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.engines import mujoco_callback as callback
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.law import NO_SOLUTION
from tensegrity_mj.mjcf import quaternion, rotation_to
from tensegrity_mj.native.plant import HELD, STATUS

Array = NDArray[np.float64]


class NodeAccelerations:
    """See `engines.run.Accelerations`. The engine's callback sets controls and loads, as in a run."""

    def __init__(self, run: Any) -> None:
        self.run, self.scene = run, run.request.scene
        model = run.model
        self.sites = np.array([model.site(name).id for name in self.scene.structure.nodes])
        self.bodies = model.site_bodyid[self.sites]

    def __call__(
        self, time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None
    ) -> tuple[Array, Array]:
        run, model, data = self.run, self.run.model, self.run.data
        mujoco.mj_resetData(model, data)
        self._place(nodes, velocities)
        if rest_lengths is not None:
            run.plant[HELD][:] = rest_lengths
        # The callback counts time in steps: one step of this length.
        run.keep[callback.STEP_SIZE][0] = time
        run.counters[:] = [0, 1 if time else 0, 0, -1, callback.RUNNING, 0]
        with callback.installed(run.plant.table):
            mujoco.mj_forward(model, data)
        ended, failed = int(run.counters[callback.ENDED]), int(run.plant.table[STATUS])
        run.plant.raise_if_failed(max(ended, failed, 0), time)
        if ended == NO_SOLUTION:
            raise InfeasibleError(run.plant.infeasible_message(time))
        out = np.zeros((len(self.sites), 3))
        jacobian, rate = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for row, (site, body) in enumerate(zip(self.sites, self.bodies, strict=True)):
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            mujoco.mj_jacDot(model, data, rate, None, data.site_xpos[site], body)
            out[row] = jacobian @ data.qacc + rate @ data.qvel
        return data.site_xpos[self.sites].copy(), out

    def _place(self, nodes: Array, velocities: Array) -> None:
        """Joint coordinates and velocities of node positions and velocities; no rod spins about its axis."""
        model, data, structure = self.run.model, self.run.data, self.scene.structure
        start = self.scene.nodes0
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
