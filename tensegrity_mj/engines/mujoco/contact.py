"""Contact in a MuJoCo run: its work, counted along with the state, and its forces at the recorded times.

A run without contact has none of it: `touches` is zero in its table.

MuJoCo knows the contact's forces only after the control callback has returned. So the callback keeps the velocities of
each stage, and counts the power when it is next called. The forces at the recorded times are found again afterwards,
from the state, controls and loads that were recorded with each row: the same solution of the same equations.

Work is counted as work on thin rods. What friction puts into the spin of a rod about its own axis, which no node sees
and a thin rod does not have, is not work on them: it counts as lost, and what comes back of it as given. Where spin is
held, it is by an armature of that freedom alone: a moment of inertia that weighs against turning and, unlike the body's
own, carries no angular momentum about. What is left of spin falls in proportion: the limit is a model without it.
"""

from __future__ import annotations

import copy as copying
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.pointers import address, borrowing, copy, floats
from tensegrity_mj.dynamics.native.vectors import dot, minus, row_of
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.model.elements.contact import holds_spin
from tensegrity_mj.model.members import Rod
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure


@borrowing
def spin_energy(run: Any) -> float:
    """Kinetic energy [J] of the rods' spin about their own axes."""
    nodes, twists, spinning, inertia = run.nodes, run.cvel, run.spinning, run.spin_inertia
    total = 0.0
    for i in range(len(spinning)):
        span = minus(row_of(nodes, spinning[i, 2]), row_of(nodes, spinning[i, 1]))
        total += 0.5 * inertia[i] * dot(row_of(twists, spinning[i, 0]), span) ** 2 / dot(span, span)
    return total


@borrowing
def write_state(run: Any, row: Any) -> None:
    """Write all that the forces of this state follow from at the end of a row.

    That is qpos, qvel, ctrl, the actuators' limits, and the loads on bodies.
    """
    limits = floats(address(run.force_range), 2 * run.string_count)
    loads = floats(address(run.xfrc_applied), 6 * run.body_count)
    at = len(row) - run.nq - run.nv - run.string_count - len(limits) - len(loads)
    copy(run.qpos, row[at:])
    at += run.nq
    copy(run.qvel, row[at:])
    at += run.nv
    copy(run.ctrl, row[at:])
    at += run.string_count
    copy(limits, row[at:])
    copy(loads, row[at + len(limits) :])


def bodies_of(members: Sequence[Rod], model: mujoco.MjModel) -> NDArray[np.int64]:
    """Numbers of the bodies of rigid rods."""
    return np.array([model.geom_bodyid[model.geom(rod.name).id] for rod in members], np.int64)


def spins(structure: Structure, model: mujoco.MjModel) -> NDArray[np.int64]:
    """The degrees of freedom that turn rods about their own axes, relative to what they hang on."""
    own = bodies_of([rod for rod in structure.rods if rod.support.plane is None and rod.stiffness is None], model)
    return np.asarray(model.body_dofadr[own] + model.body_dofnum[own] - 1, np.int64)


HOLDING = 1e9  # of a rod's transverse moment of inertia: the armature that holds its spin


def hold_spins(model: mujoco.MjModel, scene: Scene) -> None:
    """Hold the rods of a compiled model where the scene's contact does; a free joint's armature in MJCF is of all six.

    MuJoCo reads it in `dof_M0`, too, where a body's mass matrix is diagonal. The mean inertia, by which its solver
    measures what is left to do, stays as it was compiled.
    """
    if holds_spin(scene):
        dofs = spins(scene.structure, model)
        model.dof_armature[dofs] = HOLDING * model.body_inertia[model.dof_bodyid[dofs], 0]
        model.dof_M0[dofs] += model.dof_armature[dofs]


class Contacts:
    """Contact of a run.

    Attributes:
        width: columns that a row has more.
    """

    def __init__(self, structure: Structure, model: mujoco.MjModel, run: Table) -> None:
        """`run`: the table of the run, in which it is set."""
        self.structure, self.model = structure, model
        self._bodies = bodies_of(structure.rods, model)
        free = [row for row, rod in enumerate(structure.rods) if rod.support.plane is None]
        spinning = np.column_stack([self._bodies, structure.rod_nodes])[free]
        run.set(touches=1, stage_rates=np.zeros(model.nv), spinning=spinning)
        own = self._bodies[free]
        last = model.body_dofadr[own] + model.body_dofnum[own] - 1
        run.set(spin_inertia=model.body_inertia[own, 2] + model.dof_armature[last])
        self.width = int(model.nq + model.nv + 3 * model.nu + 6 * model.nbody)

    def forces(self, states: Array) -> tuple[Array, Array, dict[str, Any]]:
        """Contact forces [N] of recorded states (T, width), and a report of them.

        Returns those on both ends of each rod (T, R, 2, 3), and all of a node together (T, N, 3). A force at the part
        s of a rod's length counts with 1 - s and s at its nodes, which is the same to a rigid thin rod. What it does
        about the axis, by the rod's radius, is left out.
        """
        model, structure = copying.copy(self.model), self.structure
        data = mujoco.MjData(model)
        owner, pairs = self._owners(), structure.rod_nodes
        point = np.array([structure.node_index[mass.node] for mass in structure.lone_masses], int)
        ends, out = np.zeros((len(states), len(pairs), 2, 3)), np.zeros((len(states), len(structure.nodes), 3))
        counts, largest, deepest = np.zeros(len(states), int), np.zeros(len(states)), 0.0
        local = np.zeros(6)
        for row, state in enumerate(states):
            if not np.all(np.isfinite(state)):
                continue  # of a run that diverged
            parts = (data.qpos, data.qvel, data.ctrl, model.actuator_forcerange.ravel(), data.xfrc_applied.ravel())
            for part, values in zip(parts, np.split(state, np.cumsum([part.size for part in parts[:-1]])), strict=True):
                part[:] = values
            mujoco.mj_forward(model, data)
            counts[row] = data.ncon
            for number, contact in enumerate(data.contact):
                mujoco.mj_contactForce(model, data, number, local)
                force = contact.frame.reshape(3, 3).T @ local[:3]  # from the first geom on the second
                largest[row], deepest = max(largest[row], local[0]), min(deepest, float(contact.dist))
                for geom, sign in zip(contact.geom, (-1.0, 1.0), strict=True):
                    member = owner[geom]
                    if member < 0:
                        continue
                    if member >= len(pairs):
                        out[row, point[member - len(pairs)]] += sign * force
                        continue
                    i, j = pairs[member]
                    x, y = (data.site(structure.node_names[n]).xpos for n in (i, j))
                    s = min(max(float((contact.pos - x) @ (y - x) / ((y - x) @ (y - x))), 0.0), 1.0)
                    shares = sign * np.array([[1 - s], [s]]) * force
                    ends[row, member] += shares
                    out[row, [i, j]] += shares
        found = {
            "touching": counts.tolist(),  # contacts at each recorded time
            "largest_normal_force": float(largest.max(initial=0.0)),  # [N], at the recorded times
            "deepest": 0.0 - deepest,  # [m]: largest overlap at the recorded times
            "final_forces": {  # [N], on the nodes at the last recorded time
                name: force.tolist() for name, force in zip(structure.node_names, out[-1], strict=True) if force.any()
            },
        }
        return ends, out, found

    def _owners(self) -> NDArray[np.int64]:
        """Number of each geom's rod, or of its point mass after the rods, or -1."""
        model, structure = self.model, self.structure
        bodies = np.full(model.nbody, -1)
        bodies[self._bodies] = np.arange(len(structure.rods))
        for number, mass in enumerate(structure.lone_masses):
            bodies[model.site_bodyid[model.site(mass.node).id]] = len(structure.rods) + number
        return np.asarray(bodies[model.geom_bodyid])
