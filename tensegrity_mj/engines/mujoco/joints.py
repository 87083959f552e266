"""Forces in rods that share nodes, and the gaps of joints that close loops, from the recorded states of a MuJoCo run.

MuJoCo knows the forces of a state after its control callback has returned, and none between the bodies of a tree. So
a run of rods that share nodes records its states; afterwards MuJoCo solves for each again, with the same tensions,
loads and drives, and gives the accelerations of the nodes and the forces of the constraints, which are rigid here: the
soft ones of a run lack a part of their force as long as a gap is closed, and ring in its stages. The force f on a rod
where it hangs then follows from its own motion, m (c̈ - g) = f + what else acts on it, from the rods that hang last to
the roots.
"""

from __future__ import annotations

import copy as copying
from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines.mujoco import mjcf, mjcf_tree, motion
from tensegrity_mj.model import rods
from tensegrity_mj.model.elements.element import forces_of
from tensegrity_mj.model.scene import Scene

REDUNDANT = 1e-12  # of the largest singular value: below it, a constraint says what others say


class JointForces:
    """Forces in rods and joints, from the recorded states (T, nq + nv) of a run."""

    def __init__(self, scene: Scene, tree: mjcf_tree.BodyTree, model: mujoco.MjModel, run: Table) -> None:
        """`run`: the table of the run, with its supports."""
        self.scene, self.tree, self.model, self.run = scene, tree, model, run
        structure = scene.structure
        self.state = int(model.nq + model.nv)
        implicit = structure.constraints or any(one.adds_mass for one in scene.effects)
        self.width = self.state + (3 * len(structure.nodes) if implicit else 0)
        self._sites = np.array([model.site(name).id for name in structure.node_names], np.int64)
        ends = mjcf_tree.Names(scene, tree).ends
        # Where each end of each rod is: at its node's site, or at a site of its own where a constraint holds it there.
        self._ends = self._sites[structure.rod_nodes]
        self._gaps = []
        for (node, owner, other), name in zip(tree.forest.closures, ends, strict=True):
            own = int(model.site(name).id)
            self._ends[other, self._end(other, node)] = own
            self._gaps.append((int(self._sites[node]), own, owner, other, node))

    def _end(self, rod: int, node: int) -> int:
        return int(self.scene.structure.rod_nodes[rod, 1] == node)

    def multipliers(self, time: Array, rows: Array, pushes: Array | None = None) -> tuple[Array, dict[str, Any]]:
        """λ (T, R) [1/s²] of (2.36) with the joints' forces, and the report "joints" of the gaps of closures.

        Args:
            time: (T,) [s].
            rows: (T, ...) as recorded: those of `write_row` first; qpos, qvel and implicit forces last.
            pushes: (T, R, 2, 3) [N] of contacts on both ends of each rod, which the model does not find again.
        """
        scene, structure = self.scene, self.scene.structure
        T, N, M = len(time), len(structure.nodes), len(structure.strings)
        nodes, velocities = rows[:, : 3 * N].reshape(T, N, 3), rows[:, 3 * N : 6 * N].reshape(T, N, 3)
        tensions = rows[:, 6 * N + 2 * M : 6 * N + 3 * M]
        states = rows[:, 6 * N + 3 * M + 3 :]  # and what comes behind them
        loads = forces_of(scene.effects, scene, time, nodes, velocities, states)
        states = rows[:, -self.width :]
        if self.width > self.state:
            loads += states[:, self.state :].reshape(T, N, 3)
        pushes = np.zeros((T, 0, 2, 3)) if pushes is None else pushes
        accelerations, pulls, gaps = self._solve(time, states[:, : self.state], tensions, loads, pushes)
        nodal = rods.string_forces(structure, nodes, tensions) + loads
        forces = self._end_forces(nodal, pushes, pulls, accelerations)
        sigma = np.array([rod.support.sigma for rod in structure.rods])[:, None]
        r_accelerations = (1 - sigma) * accelerations[:, :, 0] + sigma * accelerations[:, :, 1]
        found = rods.multipliers(
            structure, nodes, velocities, forces[:, :, 0], forces[:, :, 1], np.array(scene.gravity), r_accelerations
        )
        if not self._gaps:
            return found, {}
        worst = np.max(np.nan_to_num(gaps), axis=0)
        largest = int(np.argmax(worst))
        report = {
            "closures": len(self._gaps),
            "largest_gap": float(worst[largest]),  # [m], at the recorded times
            "node": structure.node_names[self._gaps[largest][4]],
        }
        return found, {"joints": report, "closure_drift": report["largest_gap"]}  # the second as the DAE has it

    def _solve(
        self, time: Array, states: Array, tensions: Array, loads: Array, pushes: Array
    ) -> tuple[Array, Array, Array]:
        """Accelerations of the rods' ends (T, R, 2, 3), forces of the closures on their first rods (T, C, 3), gaps."""
        scene, model = self.scene, copying.copy(self.model)
        model.actuator_forcerange[:, 1] = mjcf.UNLIMITED  # a run may have left a slack string's limit there
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        structure, data = scene.structure, mujoco.MjData(model)
        T, R, C = len(time), len(structure.rods), len(self._gaps)
        accelerations, pulls, gaps = np.zeros((T, R, 2, 3)), np.zeros((T, C, 3)), np.zeros((T, C))
        with np.errstate(all="ignore"):
            for row in range(T):
                if not np.all(np.isfinite(states[row])):
                    accelerations[row], pulls[row], gaps[row] = np.nan, np.nan, np.nan
                    continue
                data.qpos[:], data.qvel[:] = np.split(states[row], [model.nq])
                if scene.motions:
                    data.qfrc_applied[:] = motion.driving_forces(self.run["driven"], scene, float(time[row]), model.nv)
                mujoco.mj_fwdPosition(model, data)
                mujoco.mj_fwdVelocity(model, data)
                if len(structure.strings):
                    # The control that makes MuJoCo's tension the recorded one, for any law and for broken strings.
                    data.ctrl[:] = mjcf.controls_for(structure, data.ten_length, data.ten_velocity, tensions[row])
                self._apply(data, np.concatenate([loads[row], pushes[row].reshape(-1, 3)]))
                mujoco.mj_forward(model, data)
                accelerations[row] = site_accelerations(model, data, self._ends.ravel()).reshape(R, 2, 3)
                equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
                for number, (site, own, *_) in enumerate(self._gaps):
                    found = np.flatnonzero(equality & (data.efc_id == number))
                    pulls[row, number, : len(found)] = data.efc_force[found]
                    gaps[row, number] = np.linalg.norm(data.site_xpos[site] - data.site_xpos[own])
        return accelerations, pulls, gaps

    def _apply(self, data: mujoco.MjData, loads: Array) -> None:
        """Loads on the nodes, and on the rods' ends (N and N + 2 R, 3), as forces and torques at centres of mass."""
        data.xfrc_applied[:] = 0.0
        for site, force in zip([*self._sites, *self._ends.ravel()], loads, strict=False):
            body = self.model.site_bodyid[site]
            if body and force.any():
                data.xfrc_applied[body, :3] += force
                data.xfrc_applied[body, 3:] += np.cross(data.site_xpos[site] - data.xipos[body], force)

    def _end_forces(self, nodal: Array, pushes: Array, pulls: Array, accelerations: Array) -> Array:
        """Forces (T, R, 2, 3) [N] on each end of each rod: all but gravity."""
        structure, forest = self.scene.structure, self.tree.forest
        out = np.zeros_like(accelerations)
        out[:, : pushes.shape[1]] += pushes
        for node, owner in enumerate(forest.owner):
            if owner >= 0:
                out[:, owner, self._end(int(owner), node)] += nodal[:, node]
        for number, (_, _, owner, other, node) in enumerate(self._gaps):
            out[:, owner, self._end(owner, node)] += pulls[:, number]
            out[:, other, self._end(other, node)] -= pulls[:, number]
        gravity = np.array(self.scene.gravity)
        centers = rods.mass_at_ends(structure)[:, 1] / structure.rod_masses
        for rod in forest.order[::-1]:
            parent, node = int(forest.parent[rod]), int(forest.hinge[rod])
            if parent < 0:
                continue
            middle = (1.0 - centers[rod]) * accelerations[:, rod, 0] + centers[rod] * accelerations[:, rod, 1]
            pull = structure.rod_masses[rod] * (middle - gravity) - out[:, rod].sum(axis=1)
            out[:, rod, self._end(int(rod), node)] += pull
            out[:, parent, self._end(parent, node)] -= pull
        return out


def site_accelerations(model: mujoco.MjModel, data: mujoco.MjData, sites: Any) -> Array:
    """Accelerations (n, 3) [m/s²] of sites (n,), once forces are known; joints close loops as by `close_rigidly`."""
    if data.nefc and model.neq:
        close_rigidly(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    out, spatial = np.zeros((len(sites), 3)), np.zeros(6)
    for row, site in enumerate(sites):
        mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_SITE, int(site), spatial, 0)
        out[row] = spatial[3:] + model.opt.gravity  # of a frame in free fall, as MuJoCo has it
    return out


def close_rigidly(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Add to the joint accelerations and forces what the softness of `connect` constraints keeps from them.

    MuJoCo finds J q̈ = a - R f with a = -B ġ - K g - J̇ q̇ for the gaps g, and J q̈ = -J̇ q̇ leaves ġ as it is. The
    Jacobian must be a dense one. A state beyond all reason is left alone.
    """
    joints = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)  # contacts keep their forces
    J = data.efc_J.reshape(data.nefc, model.nv)[joints]
    stiffness, damping, impedance = data.efc_KBIP.reshape(data.nefc, 4)[joints, :3].T
    missing = (data.efc_R * data.efc_force)[joints] + damping * data.efc_vel[joints]
    missing += stiffness * impedance * data.efc_pos[joints]
    if not (np.all(np.isfinite(missing)) and np.all(np.isfinite(J))):
        return
    per_force = np.zeros((len(joints), model.nv))  # M⁻¹ Jᵀ, by rows
    mujoco.mj_solveM(model, data, per_force, J.copy())
    force = np.linalg.lstsq(J @ per_force.T, missing, rcond=REDUNDANT)[0]
    data.qacc[:] += force @ per_force
    data.efc_force[joints] += force
    data.qfrc_constraint[:] += force @ J
