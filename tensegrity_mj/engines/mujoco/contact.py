"""Contact in a MuJoCo run: its work, counted beside the state, and its forces at the recorded times.

A run without contact has none of it: the slot CONTACT of its table is zero.

MuJoCo knows the contact's forces only after the control callback has returned. So the callback keeps the velocities of
each stage, and counts the power when it is next called. The forces at the recorded times are found again afterwards,
from the state, controls and loads that were recorded with each row: the same solution of the same equations.

Work is counted as work on thin rods. What friction puts into the spin of a rod about its own axis, which no node sees
and a thin rod does not have, is not work on them: it counts as lost, and what comes back of it as given.
"""

from __future__ import annotations

import copy as copying
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, floats, integers
from tensegrity_mj.model.structure import Structure

# Of the contact's own table: sizes, addresses of MjData's arrays and of ours, and whether a stage awaits its forces.
(
    NQ,
    NV,
    NU,
    NBODY,
    QPOS,
    QVEL,
    CTRL,
    LIMITS,
    XFRC,
    CONSTRAINT,
    KEPT,
    SPIN_COUNT,
    SPIN_DOFS,
    SPIN_INERTIA,
    WAITS,
) = range(15)


@borrowing
def state_width(contact: Any) -> int:
    """Length of what `write_state` adds to a row: qpos, qvel, ctrl, the actuators' limits, and the loads on bodies."""
    return contact[NQ] + contact[NV] + 3 * contact[NU] + 6 * contact[NBODY]


@borrowing
def copy(source: Any, out: Any, count: Any) -> None:
    """Copy so many numbers from one address to another. Slices would need memory of numba's own."""
    values, places = floats(source, (count,)), floats(out, (count,))
    for i in range(count):
        places[i] = values[i]


@borrowing
def keep_stage(contact: Any) -> None:
    """Keep the velocities of this stage until its forces are known."""
    copy(contact[QVEL], contact[KEPT], contact[NV])
    contact[WAITS] = 1


@borrowing
def last_stage_work(contact: Any, weight: float, one_stage: bool) -> float:
    """Work [J] of the contacts over the stage before, of this weight [s].

    An integrator of one stage holds its forces over the step: their work counts the speeds at both ends.
    """
    if not contact[WAITS]:
        return 0.0
    contact[WAITS] = 0
    nv = contact[NV]
    force, kept = floats(contact[CONSTRAINT], (nv,)), floats(contact[KEPT], (nv,))
    now = floats(contact[QVEL], (nv,))
    power = 0.0
    for i in range(nv):
        power += force[i] * (0.5 * (kept[i] + now[i]) if one_stage else kept[i])
    return weight * power


@borrowing
def spin_energy(contact: Any) -> float:
    """Kinetic energy [J] of the rods' spin about their own axes."""
    count, velocity = contact[SPIN_COUNT], floats(contact[QVEL], (contact[NV],))
    dofs, inertia = integers(contact[SPIN_DOFS], (count,)), floats(contact[SPIN_INERTIA], (count,))
    total = 0.0
    for i in range(count):
        total += 0.5 * inertia[i] * velocity[dofs[i]] ** 2
    return total


@borrowing
def write_state(contact: Any, address: Any) -> None:
    """Write all that the forces of this state follow from to an address in a row."""
    copy(contact[QPOS], address, contact[NQ])
    address += 8 * contact[NQ]
    copy(contact[QVEL], address, contact[NV])
    address += 8 * contact[NV]
    copy(contact[CTRL], address, contact[NU])
    address += 8 * contact[NU]
    copy(contact[LIMITS], address, 2 * contact[NU])
    copy(contact[XFRC], address + 16 * contact[NU], 6 * contact[NBODY])


class ContactTable:
    """The table of a run with contact, and the arrays behind it.

    Attributes:
        table: int64, see the slots above.
        width: columns that a row has more.
    """

    def __init__(self, structure: Structure, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.structure, self.model = structure, model
        dofs, inertia = _spins(structure, model)
        kept = np.zeros(model.nv)
        self._keep = (dofs, inertia, kept)
        self.table = np.zeros(WAITS + 1, np.int64)
        self.table[NQ], self.table[NV], self.table[NU], self.table[NBODY] = model.nq, model.nv, model.nu, model.nbody
        self.table[SPIN_COUNT] = len(dofs)
        views = {
            QPOS: data.qpos,
            QVEL: data.qvel,
            CTRL: data.ctrl,
            LIMITS: model.actuator_forcerange,
            XFRC: data.xfrc_applied,
            CONSTRAINT: data.qfrc_constraint,
            KEPT: kept,
            SPIN_DOFS: dofs,
            SPIN_INERTIA: inertia,
        }
        for slot, array in views.items():
            self.table[slot] = address_of(array)
        self.width = int(state_width.py_func(self.table))

    def forces(self, states: Array) -> tuple[Array, dict[str, Any]]:
        """Contact forces of recorded states (T, width) as forces on the nodes (T, N, 3) [N], and what they were.

        A force at the part s of a rod's length counts with 1 - s and s at its nodes, which is the same to a rigid thin
        rod. What it does about the axis, by the rod's radius, is left out.
        """
        model, structure = copying.copy(self.model), self.structure
        data = mujoco.MjData(model)
        owner, pairs = _geom_owners(structure, model), structure.rod_nodes
        point = np.array([structure.node_index[mass.node] for mass in structure.point_masses], int)
        out = np.zeros((len(states), len(structure.nodes), 3))
        counts, largest, deepest = np.zeros(len(states), int), np.zeros(len(states)), 0.0
        local = np.zeros(6)
        for row, state in enumerate(states):
            if not np.all(np.isfinite(state)):
                continue  # of a run that diverged
            self._solve(model, data, state)
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
                    out[row, i] += sign * (1 - s) * force
                    out[row, j] += sign * s * force
        found = {
            "touching": counts.tolist(),  # contacts at each recorded time
            "largest_normal_force": float(largest.max(initial=0.0)),  # [N], at the recorded times
            "deepest": 0.0 - deepest,  # [m]: largest overlap at the recorded times
            "final_forces": {  # [N], on the nodes at the last recorded time
                name: force.tolist() for name, force in zip(structure.node_names, out[-1], strict=True) if force.any()
            },
        }
        return out, found

    def _solve(self, model: mujoco.MjModel, data: mujoco.MjData, state: Array) -> None:
        """The contacts and their forces at one recorded state."""
        parts = (data.qpos, data.qvel, data.ctrl, model.actuator_forcerange.reshape(-1), data.xfrc_applied.reshape(-1))
        for part, values in zip(parts, np.split(state, np.cumsum([part.size for part in parts[:-1]])), strict=True):
            part[:] = values
        mujoco.mj_forward(model, data)


def _spins(structure: Structure, model: mujoco.MjModel) -> tuple[NDArray[np.int64], Array]:
    """The degrees of freedom that turn a rod about its own axis, and the moments of inertia [kg m²] about them."""
    dofs, inertia = [], []
    for rod in structure.rods:
        if rod.support.plane is None:
            body = model.site_bodyid[model.site(rod.nodes[0]).id]
            dofs.append(int(model.body_dofadr[body] + model.body_dofnum[body] - 1))
            inertia.append(float(model.body_inertia[body, 2]))
    return np.array(dofs, np.int64), np.array(inertia, float)


def _geom_owners(structure: Structure, model: mujoco.MjModel) -> NDArray[np.int64]:
    """For each geom the number of its rod, or of its point mass after the rods, or -1."""
    bodies = np.full(model.nbody, -1)
    for number, rod in enumerate(structure.rods):
        bodies[model.site_bodyid[model.site(rod.nodes[0]).id]] = number
    for number, mass in enumerate(structure.point_masses):
        bodies[model.site_bodyid[model.site(mass.node).id]] = len(structure.rods) + number
    return np.asarray(bodies[model.geom_bodyid])
