"""The thesis' own forms of the equations of chapter 3, for any forest of rods: one large matrix, or one of K x K.

Both are independent of `joint_forces`, which is faster, and serve as checks on it and as what the thesis describes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.joint_forces import LEAST_PIVOT, moved_nodes_power, push_joint, set_ends
from tensegrity_mj.dynamics.joint_plan import Joints
from tensegrity_mj.dynamics.kernels import accelerate_points, direction_of
from tensegrity_mj.dynamics.linked import Linked, stretch_term, write_coordinates
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined, owning
from tensegrity_mj.dynamics.native.vectors import ZERO, dot, minus, plus, row_of, times, vector
from tensegrity_mj.dynamics.tree_matrices import Tree
from tensegrity_mj.dynamics.wet_rods import forces_of_ends, hold, own_mass

# Singular values of the scaled matrix (3.17) below this part of the largest are those of redundant closures.
LEAST_SINGULAR_VALUE = 1e-11


@inlined
def _drive_of(linked: Any, motion: int) -> Any:
    return row_of(linked.motions[motion], 2) if motion >= 0 else ZERO


@borrowing
def _load_ends(address: int, joints_at: int, forces: Any, gravity: Any) -> None:
    """Forces at the rods' ends with their shares of its weight, in the frame that moves with the tree's support."""
    set_ends(address, forces, joints_at)
    linked, joints = Linked(address), Joints(joints_at)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod, pull = linked.rods[link.rod], minus(vector(gravity), _drive_of(linked, link.drive))
        for end in range(2):
            share = times((rod.center if end == 1 else 1.0 - rod.center) * rod.mass, pull)
            for x in range(3):
                joints.ends[link.rod, end, x] += share[x]


@borrowing
def _pull_through_hinges(address: int, joints_at: int, u: Any) -> None:
    """u of (3.15) for any forest: loads go from the leaves to the roots. Consumes the forces at the ends."""
    linked, joints = Linked(address), Joints(joints_at)
    for k in range(len(linked.links) - 1, -1, -1):
        link = linked.links[k]
        rod, ends = linked.rods[link.rod], joints.ends[link.rod]
        first, second = row_of(ends, 0), row_of(ends, 1)
        if link.parent >= 0:
            parent = joints.ends[linked.links[link.parent].rod]
            for x in range(3):
                parent[link.parent_end, x] += ends[0, x] + ends[1, x]
            t_b = times(rod.length, second) if link.hinge == 0 else times(-rod.length, first)
        else:
            t_b = times(rod.length, minus(times(1.0 - rod.sigma, second), times(rod.sigma, first)))
        write_coordinates(rod, link.nz, plus(first, second), t_b, u)


@borrowing
def _gap_rates(linked: Any, joints: Any, kp: float, kd: float, right: Any) -> None:
    """What the closures' gaps must accelerate with beside what moved supports make of them, (3C,)."""
    for a in range(len(linked.gaps)):
        e = joints.closures[a]
        for x in range(3):
            right[3 * a + x] = -kd * linked.gaps[a, 1, x] - kp * linked.gaps[a, 0, x]
        for k in range(len(linked.links)):
            link = linked.links[k]
            drive = _drive_of(linked, link.drive)
            for x in range(3):
                if link.rod == joints.joints[e, 2]:
                    right[3 * a + x] -= drive[x]
                if link.rod == joints.joints[e, 0]:
                    right[3 * a + x] += drive[x]


@owning
def _solve_semidefinite(S: Any, scales: Any, x: Any) -> None:
    """x of S x = x in place, S (n, n) symmetric positive semidefinite; redundant rows get no force.

    `scales` (n,) is what each pivot is compared with: the diagonal before anything was eliminated.
    """
    n = len(x)
    pivots = np.zeros(n)
    for r in range(n):
        block = 3 * (r // 3)
        if S[r, r] > LEAST_PIVOT * np.max(scales[block : block + 3]):
            pivots[r] = 1.0 / S[r, r]
            for i in range(r + 1, n):
                factor = S[i, r] * pivots[r]
                for j in range(r + 1, i + 1):
                    S[i, j] -= factor * S[j, r]
                x[i] -= factor * x[r]
    for r in range(n - 1, -1, -1):
        total = x[r]
        for i in range(r + 1, n):
            total -= S[i, r] * x[i]
        x[r] = total * pivots[r]


@owning
def dense_accelerations(model: Any, q: Any, rates: Any, out: Any) -> float:
    """As `joint_accelerations`, by (3.19)-(3.22) with a K x K matrix; closures by a Schur complement on top of it."""
    linked, joints, tree = Linked(model.linked), Joints(model.joints), Tree(model.tree)
    forces, kp, kd, multipliers = model.forces, model.kp, model.kd, model.multipliers
    inverse, loops = tree.mass, tree.loops
    R, n, size = len(linked.rods), inverse.shape[0], len(loops)
    u, right = np.zeros(n), np.zeros(size)
    _load_ends(model.linked, model.joints, forces, model.gravity)
    _pull_through_hinges(model.linked, model.joints, u)
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
        force = right - np.dot(loops, free - np.dot(known, answers))
        _solve_semidefinite(stiff, np.diag(whole).copy(), force)
        multipliers[:R] = known + np.dot(turned, force)
        acceleration = free + np.dot(force, pulled) - np.dot(multipliers[:R], answers)
        for a in range(size):
            joints.closure_forces[a // 3, a % 3] = force[a]
    out[:n] = acceleration
    accelerate_points(forces, linked.points, model.gravity, out)
    return _supports_power(model, q, out, None)


@owning
def full_accelerations(model: Any, added: Any, q: Any, rates: Any, out: Any) -> float:
    """As `joint_accelerations`, by one matrix (3.17) of M̄, Y, and rows of supports, planes and closures.

    The matrix is scaled to unit diagonals and rows. With closures, which may be redundant, the solution of least norm
    is taken.
    """
    linked, joints, tree = Linked(model.linked), Joints(model.joints), Tree(model.tree)
    forces, kp, kd, multipliers = model.forces, model.kp, model.kd, model.multipliers
    R, n, size, held = len(linked.rods), tree.mass.shape[0], len(tree.loops), len(tree.held)
    total = n + R + held + size
    matrix, x = np.zeros((total, total)), np.zeros(total)
    _load_ends(model.linked, model.joints, forces, model.gravity)
    x[:n] = np.dot(joints.ends.copy().reshape(-1), tree.maps)
    matrix[:n, :n] = tree.mass
    if added is not None:
        _add_mass(linked, tree, added[0], q, matrix, x)
    for k in range(R):
        link = linked.links[k]
        rod, row, place = linked.rods[link.rod], n + link.rod, linked.rods[link.rod].q + link.nz
        b, b_rate = direction_of(rod, q, place), direction_of(rod, rates, place)
        for p in range(3):
            matrix[row, tree.at[link.rod] + p] = rod.rigid * rod.J * b[p]
        matrix[row, row] = 1.0 - rod.rigid  # of an elastic rod: λ = 0
        x[row] = -rod.J * dot(b, b) * stretch_term(rod, b, b_rate, kp, kd)
    matrix[n + R : n + R + held, :n] = tree.held
    matrix[n + R + held :, :n] = tree.loops
    _gap_rates(linked, joints, kp, kd, x[n + R + held :])
    scale = np.ones(total)
    for i in range(n):
        scale[i] = 1.0 / np.sqrt(matrix[i, i])
    for i in range(n, total):
        square = matrix[i, i]
        for j in range(n):
            square += (matrix[i, j] * scale[j]) ** 2
        scale[i] = 1.0 / np.sqrt(square)
    for i in range(n, total):
        matrix[:n, i] = matrix[i, :n]
    for i in range(total):
        for j in range(total):
            matrix[i, j] *= scale[i] * scale[j]
        x[i] *= scale[i]
    solved = np.linalg.solve(matrix, x) if size == 0 else np.linalg.lstsq(matrix, x, LEAST_SINGULAR_VALUE)[0]
    for i in range(total):
        solved[i] *= scale[i]
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        r_at, b_at = tree.roots[link.rod], tree.at[link.rod]
        r_acc = vector(solved[r_at : r_at + 3]) if link.nz > 0 else ZERO
        write_coordinates(rod, link.nz, r_acc, vector(solved[b_at : b_at + 3]), out)
        multipliers[link.rod] = solved[n + link.rod]
    for a in range(size):
        joints.closure_forces[a // 3, a % 3] = -solved[n + R + held + a]
    accelerate_points(forces, linked.points, model.gravity, out)
    return _supports_power(model, q, out, added)


@owning
def _add_mass(linked: Any, tree: Any, added: Any, q: Any, matrix: Any, x: Any) -> None:
    """Σ Φᵀ_i α_ij P Φ_j to the mass matrix, and what moved supports make of it to the right-hand side."""
    n = tree.mass.shape[0]
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        b = direction_of(rod, q, rod.q + link.nz)
        square, W, lead = dot(b, b), np.empty((6, 6)), np.empty(6)
        drive = _drive_of(linked, link.drive)
        for i in range(6):
            lead[i] = drive[i % 3]
            for j in range(6):
                across = (1.0 if i % 3 == j % 3 else 0.0) - b[i % 3] * b[j % 3] / square
                W[i, j] = added[link.rod, 2 * (i // 3) + j // 3] * across
        maps = np.ascontiguousarray(tree.maps[6 * link.rod : 6 * link.rod + 6])
        weighted = np.dot(maps.T, W)
        matrix[:n, :n] += np.dot(weighted, maps)
        x[:n] -= np.dot(weighted, lead)


@owning
def _supports_power(model: Any, q: Any, accelerations: Any, added: Any) -> float:
    """Power of the moved supports [W]: what each tree's momentum takes that loads and closures do not give it.

    Writes the forces of the added mass, where there is any.
    """
    linked, joints, forces, gravity = Linked(model.linked), Joints(model.joints), model.forces, model.gravity
    power = moved_nodes_power(model.linked, forces)
    if added is not None:
        added[1][:] = 0.0
    elif len(linked.motions) == 0:
        return power
    set_ends(model.linked, forces, model.joints)
    for a in range(len(joints.closures)):
        push_joint(joints, joints.closures[a], joints.closure_forces[a])
    R = len(linked.links)
    ends = np.zeros((R, 2, 3))  # accelerations of the ends, by links
    reactions = np.zeros((len(linked.motions), 3))
    for k in range(R):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        b_acc = direction_of(rod, accelerations, rod.q + link.nz)
        if link.parent >= 0:
            hinge = row_of(ends[link.parent], link.parent_end)
            first = hinge if link.hinge == 0 else minus(hinge, times(rod.length, b_acc))
        else:
            r_acc = _drive_of(linked, link.motion)
            for p in range(link.nz):
                z = accelerations[rod.q + p]
                r_acc = plus(r_acc, (rod.E[0, p] * z, rod.E[1, p] * z, rod.E[2, p] * z))
            first = minus(r_acc, times(rod.sigma * rod.length, b_acc))
        second = plus(first, times(rod.length, b_acc))
        wet = ZERO
        if added is not None:
            b = direction_of(rod, q, rod.q + link.nz)
            pair = forces_of_ends(b, own_mass(added, link.rod), first, second)
            wet = plus(pair[0], pair[1])
            hold(rod, pair, added[1])
        for x in range(3):
            ends[k, 0, x], ends[k, 1, x] = first[x], second[x]
            if link.drive >= 0:
                middle = (1.0 - rod.center) * first[x] + rod.center * second[x]
                need = rod.mass * (middle - gravity[x]) - wet[x]
                reactions[link.drive, x] += need - joints.ends[link.rod, 0, x] - joints.ends[link.rod, 1, x]
    for m in range(len(linked.motions)):
        power += dot(row_of(reactions, m), row_of(linked.motions[m], 1))
    return power
