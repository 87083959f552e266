"""The thesis' own form of the equations of chapter 3, for any forest of rods: a matrix of K x K for K rods.

It is independent of `joint_forces`, which is faster, and serves as a check on it and as what the thesis describes. Its
other form, one large matrix (3.17), is that of `assembly`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.joint_forces import LEAST_PIVOT, acceleration_of, moved_nodes_power, push_joint, set_ends
from tensegrity_mj.dynamics.joint_plan import Joints
from tensegrity_mj.dynamics.kernels import accelerate_points, direction_of, stretch_term
from tensegrity_mj.dynamics.linked import Linked
from tensegrity_mj.dynamics.native.pointers import borrowing, owning
from tensegrity_mj.dynamics.native.vectors import add, dot, minus, times, vector
from tensegrity_mj.dynamics.tree_matrices import Tree


@borrowing
def _load_ends(address: int, joints_at: int, forces: Any, gravity: Any) -> None:
    """Forces at the rods' ends with their shares of its weight, in the frame that moves with the tree's support."""
    set_ends(address, forces, joints_at)
    linked, joints = Linked(address), Joints(joints_at)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod, pull = linked.rods[link.rod], minus(vector(gravity), acceleration_of(linked, link.drive))
        for end in range(2):
            share = (rod.center if end == 1 else 1.0 - rod.center) * rod.mass
            add(joints.ends[link.rod], end, times(share, pull))


@borrowing
def _gap_rates(linked: Any, joints: Any, kp: float, kd: float, right: Any) -> None:
    """What the closures' gaps must accelerate with beside what moved supports make of them, (3C,)."""
    for a in range(len(linked.gaps)):
        e = joints.closures[a]
        for x in range(3):
            right[3 * a + x] = -kd * linked.gaps[a, 1, x] - kp * linked.gaps[a, 0, x]
        for k in range(len(linked.links)):
            link = linked.links[k]
            drive = acceleration_of(linked, link.drive)
            for x in range(3):
                if link.rod == joints.joints[e, 2]:
                    right[3 * a + x] -= drive[x]
                if link.rod == joints.joints[e, 0]:
                    right[3 * a + x] += drive[x]


@owning
def _solve_semidefinite(S: Any, whole: Any, x: Any) -> Any:
    """The least solution of S y = x, S (n, n) symmetric positive semidefinite, of which redundant rows have a part.

    Singular values are compared after scaling by what the diagonal of each block of three was before it was eliminated,
    `whole`.
    """
    scale = np.empty(len(x))
    for r in range(len(x)):
        block = 3 * (r // 3)
        scale[r] = 1.0 / np.sqrt(max(whole[block, block], whole[block + 1, block + 1], whole[block + 2, block + 2]))
    return scale * np.linalg.lstsq(scale.reshape(-1, 1) * S * scale, scale * x, LEAST_PIVOT)[0]


@owning
def dense_accelerations(model: Any, q: Any, rates: Any, out: Any) -> float:
    """As `joint_accelerations`, by (3.19)-(3.22) with a K x K matrix; closures by a Schur complement on top of it."""
    linked, joints, tree = Linked(model.linked), Joints(model.joints), Tree(model.tree)
    forces, kp, kd, multipliers = model.forces, model.kp, model.kd, model.multipliers
    inverse, loops = tree.inverse, tree.loops
    R, n, size = len(linked.rods), inverse.shape[0], len(loops)
    right, force = np.zeros(size), np.zeros(size)
    _load_ends(model.linked, model.joints, forces, model.gravity)
    u = np.dot(joints.ends.copy().reshape(-1), tree.maps)  # of (3.15), for any forest
    _gap_rates(linked, joints, kp, kd, right)
    Y = np.zeros((R, 3))
    y = np.zeros(R)
    for k in range(len(linked.links)):
        rod = linked.rods[linked.links[k].rod]
        row, place = linked.links[k].rod, tree.at[linked.links[k].rod]
        b, b_rate = direction_of(rod, q, place), direction_of(rod, rates, place)
        for p in range(rod.nb):
            Y[row, p] = rod.rigid * rod.J * q[place + p]
        y[row] = -rod.J * dot(b, b) * stretch_term(rod, b, b_rate, kp, kd)
    free = np.dot(inverse, u)
    # M⁻¹Y and W = YᵀM⁻¹Y, (3.20).
    answers, W, t = np.zeros((R, n)), np.empty((R, R)), np.empty(R)
    for a in range(R):
        for p in range(linked.rods[a].nb):
            factor = Y[a, p]
            for i in range(n):
                answers[a, i] += factor * inverse[tree.at[a] + p, i]
    for a in range(R):
        place, nb = tree.at[a], linked.rods[a].nb
        t[a] = 0.0
        for p in range(nb):
            t[a] += Y[a, p] * free[place + p]
        for e in range(R):
            total = 0.0
            for p in range(nb):
                total += Y[a, p] * answers[e, place + p]
            W[a, e] = total
        W[a, a] += 1.0 - linked.rods[a].rigid  # of an elastic rod: λ = 0
    if size == 0:
        multipliers[:R] = np.linalg.solve(W, t - y)
        acceleration = free - np.dot(multipliers[:R], answers)
    else:
        # The closures' own Schur complement: what rods of constant length answer to forces at the closures.
        pulled = np.dot(loops, inverse)
        sides = np.empty((R, size + 1))
        sides[:, size] = t - y
        for a in range(R):
            for c in range(size):
                total = 0.0
                for p in range(linked.rods[a].nb):
                    total += Y[a, p] * pulled[c, tree.at[a] + p]
                sides[a, c] = total
        solved = np.linalg.solve(W, sides)
        coupling, turned, known = sides[:, :size].copy(), solved[:, :size].copy(), solved[:, size].copy()
        whole = np.dot(pulled, loops.T)
        stiff = whole - np.dot(coupling.T, turned)
        force = _solve_semidefinite(stiff, whole, right - np.dot(loops, free - np.dot(known, answers)))
        multipliers[:R] = known + np.dot(turned, force)
        acceleration = free + np.dot(force, pulled) - np.dot(multipliers[:R], answers)
    out[:n] = acceleration
    accelerate_points(forces, linked.points, model.gravity, out)
    return _supports_power(linked, joints, tree, acceleration, force) + moved_nodes_power(model.linked, forces)


@owning
def _supports_power(linked: Any, joints: Any, tree: Any, accelerations: Any, force: Any) -> float:
    """Power of the supports of rods that move [W]: what momenta take that loads and closures (3C,) do not give them."""
    power = 0.0
    if len(linked.motions) == 0:
        return power
    for a in range(len(joints.closures)):
        push_joint(joints, joints.closures[a], force[3 * a : 3 * a + 3])
    moves = np.dot(tree.maps, accelerations)  # of the ends, seen from the support, as their loads are
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod, ends = linked.rods[link.rod], joints.ends[link.rod]
        if link.drive >= 0:
            for x in range(3):
                first, second = moves[6 * link.rod + x], moves[6 * link.rod + 3 + x]
                need = rod.mass * ((1.0 - rod.center) * first + rod.center * second)
                power += (need - ends[0, x] - ends[1, x]) * linked.motions[link.drive, 1, x]
    return power
