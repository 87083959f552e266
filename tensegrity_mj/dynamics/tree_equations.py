"""The thesis' own forms of the equations of chapter 3, for any forest of rods: one large matrix, or one of K x K.

Both are independent of `joint_forces`, which is faster, and serve as checks on it and as what the thesis describes.
The mass matrix is constant: with Φ_i, Φ_j the (constant) derivatives of a rod's ends to q, it is the sum of
m/3 (Φ_iᵀΦ_i + Φ_jᵀΦ_j + (Φ_iᵀΦ_j + Φ_jᵀΦ_i)/2) over the rods, a linear profile of velocities integrated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.joint_forces import LEAST_PIVOT, moved_nodes_power, push_joint, read_joints, set_ends
from tensegrity_mj.dynamics.kernels import accelerate_points, direction_of
from tensegrity_mj.dynamics.linked import LinkedRecords, read_linked, stretch_term, write_coordinates
from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, floats, inlined, integers, owning
from tensegrity_mj.dynamics.native.vectors import ZERO, dot, minus, plus, row_of, times, vector

# Singular values of the scaled matrix (3.17) below this part of the largest are those of redundant closures.
LEAST_SINGULAR_VALUE = 1e-11


class TreeArrays(NamedTuple):
    """What compiled code sees of a `TreeEquations`; n coordinates of the rods, C closures.

    Attributes:
        mass: (n, n) M, or its inverse for the K x K form.
        loops: (3C, n) derivatives of the closures' gaps to the coordinates.
        maps: (6R, n) derivatives of the rods' ends, for the full form alone.
        held: (h, n) rows of supports and planes, for the full form alone.
        at: (R,) where each rod's b starts among the coordinates.
        roots: (R,) where each root's r starts, -1 for other rods; for the full form alone.
    """

    mass: Any
    loops: Any
    maps: Any
    held: Any
    at: Any
    roots: Any


@dataclass(frozen=True, eq=False)
class TreeEquations:
    """Constant matrices of one structure.

    Attributes:
        arrays: see `TreeArrays`.
        table: sizes and addresses of them.
    """

    arrays: TreeArrays
    table: IntArray

    @classmethod
    def dense(cls, records: LinkedRecords) -> TreeEquations:
        """For (3.19)-(3.22): the coordinates are q of the records."""
        maps = end_maps(records, full=False)
        inverse = np.linalg.inv(mass_matrix(records, maps))
        at = np.array([records.rods[row]["q"] for row in range(len(records.rods))], np.int64)
        for link in records.links:
            at[link["rod"]] += link["nz"]
        nothing = np.zeros((0, records.rod_coordinates))
        return cls._packed(0.5 * (inverse + inverse.T), loop_matrix(records, maps), nothing, nothing, at, at)

    @classmethod
    def full(cls, records: LinkedRecords) -> TreeEquations:
        """For (3.17): b of every rod and r of every root, all in world components; supports are rows."""
        maps = end_maps(records, full=True)
        at, roots, size = _full_places(records)
        rows = []
        for number, rod in enumerate(records.structure.rods):
            supported = rod.support.constraint_rows if roots[number] >= 0 else np.zeros((0, 3))
            plane = [] if rod.support.plane is None else [rod.support.plane]
            for where, directions in ((roots[number], supported), (at[number], np.array(plane).reshape(-1, 3))):
                for direction in directions:
                    row = np.zeros(size)
                    row[where : where + 3] = direction / np.linalg.norm(direction)
                    rows.append(row)
        held = np.array(rows, float).reshape(-1, size)
        flat = np.ascontiguousarray(maps.reshape(-1, size))
        return cls._packed(mass_matrix(records, maps), loop_matrix(records, maps), flat, held, at, roots)

    @classmethod
    def _packed(cls, *arrays: Any) -> TreeEquations:
        packed = TreeArrays(*(np.ascontiguousarray(array) for array in arrays))
        sizes = (packed.mass.shape[1], *(len(array) for array in packed))
        return cls(packed, np.array([*sizes, *(address_of(array) for array in packed)], np.int64))


def _full_places(records: LinkedRecords) -> tuple[IntArray, IntArray, int]:
    """Where b of each rod and r of each root start among the coordinates of the full form, and how many there are."""
    at, roots, size = np.zeros(len(records.rods), np.int64), np.full(len(records.rods), -1, np.int64), 0
    for row in range(len(records.rods)):
        if records.forest.parent[row] < 0:
            roots[row] = size
            size += 3
        at[row] = size
        size += 3
    return at, roots, size


def end_maps(records: LinkedRecords, full: bool) -> Array:
    """(R, 2, 3, n): derivatives of the ends of every rod to q, or to the coordinates of the full form."""
    at, roots, size = _full_places(records)
    maps = np.zeros((len(records.rods), 2, 3, size if full else records.rod_coordinates))
    for link in records.links:
        row = int(link["rod"])
        rod = records.rods[row]
        if full:
            z, E, b, B = roots[row], np.eye(3), at[row], np.eye(3)
        else:
            z, E = rod["q"], rod["E"][:, : link["nz"]]
            b, B = rod["q"] + link["nz"], rod["B"][:, : rod["nb"]]
        ends = maps[row]
        if link["parent"] >= 0:
            start = int(link["hinge"])
            hung = maps[records.links[link["parent"]]["rod"], link["parent_end"]]
            ends[0], ends[1] = hung, hung
            ends[1 - start][:, b : b + B.shape[1]] += (1 if start == 0 else -1) * rod["length"] * B
        else:
            for end, lever in ((0, -rod["sigma"]), (1, 1 - rod["sigma"])):
                ends[end][:, z : z + E.shape[1]] = E
                ends[end][:, b : b + B.shape[1]] = lever * rod["length"] * B
    return maps


def mass_matrix(records: LinkedRecords, maps: Array) -> Array:
    """M (n, n), constant; for a chain of free rods (3.13) with the corrections of its misprints."""
    weighted = np.sqrt(records.rods["mass"] / 3)[:, None, None, None] * maps
    first, second = (weighted[:, end].reshape(-1, maps.shape[-1]) for end in (0, 1))
    cross = first.T @ second
    return np.asarray(first.T @ first + second.T @ second + 0.5 * (cross + cross.T))


def loop_matrix(records: LinkedRecords, maps: Array | None = None) -> Array:
    """(3C, n): derivatives of the closures' gaps to the rods' coordinates; the gaps are linear in them."""
    if not records.forest.closures:
        return np.zeros((0, records.rod_coordinates if maps is None else maps.shape[-1]))
    maps = end_maps(records, full=False) if maps is None else maps
    rows = [
        maps[other, int(records.rods[other]["j"] == node)] - maps[owner, int(records.rods[owner]["j"] == node)]
        for node, owner, other in records.forest.closures
    ]
    return np.array(rows).reshape(-1, maps.shape[-1])


@inlined
def read_tree(address: int) -> Any:
    """The arrays of a `TreeEquations`."""
    table = integers(address, (13,))
    n = table[0]
    return TreeArrays(
        floats(table[7], (table[1], n)),
        floats(table[8], (table[2], n)),
        floats(table[9], (table[3], n)),
        floats(table[10], (table[4], n)),
        integers(table[11], (table[5],)),
        integers(table[12], (table[6],)),
    )


@inlined
def _drive_of(linked: Any, motion: int) -> Any:
    return row_of(linked.motions[motion], 2) if motion >= 0 else ZERO


@borrowing
def _load_ends(address: int, joints_at: int, forces: Any, gravity: Any) -> None:
    """Forces at the rods' ends with half the rod's weight at each, in the frame that moves with the tree's support."""
    set_ends(address, forces, joints_at)
    linked, joints = read_linked(address), read_joints(joints_at)
    for k in range(len(linked.links)):
        link = linked.links[k]
        half = times(0.5 * linked.rods[link.rod].mass, minus(vector(gravity), _drive_of(linked, link.drive)))
        for end in range(2):
            for x in range(3):
                joints.ends[link.rod, end, x] += half[x]


@borrowing
def _pull_through_hinges(address: int, joints_at: int, u: Any) -> None:
    """u of (3.15) for any forest: loads go from the leaves to the roots. Consumes the forces at the ends."""
    linked, joints = read_linked(address), read_joints(joints_at)
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
def dense_accelerations(at: Any, q: Any, rates: Any, forces: Any, constants: Any, out: Any, multipliers: Any) -> float:
    """As `joint_accelerations`, by (3.19)-(3.22) with a K x K matrix; closures by a Schur complement on top of it."""
    linked, joints, tree, kp, kd = read_linked(at[0]), read_joints(at[1]), read_tree(at[2]), constants[3], constants[4]
    inverse, loops = tree.mass, tree.loops
    R, n, size = len(linked.rods), inverse.shape[0], len(loops)
    u, right = np.zeros(n), np.zeros(size)
    _load_ends(at[0], at[1], forces, constants)
    _pull_through_hinges(at[0], at[1], u)
    _gap_rates(linked, joints, kp, kd, right)
    Y = np.zeros((R, 3))
    y = np.zeros(R)
    for k in range(len(linked.links)):
        rod = linked.rods[linked.links[k].rod]
        row, place = linked.links[k].rod, tree.at[linked.links[k].rod]
        b, b_rate = direction_of(rod, q, place), direction_of(rod, rates, place)
        for p in range(rod.nb):
            Y[row, p] = rod.J * q[place + p]
        y[row] = -rod.J * dot(b, b) * stretch_term(b, b_rate, kp, kd)
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
    accelerate_points(forces, linked.points, constants, out)
    return _supports_power(at[0], at[1], forces, constants, out)


@owning
def full_accelerations(at: Any, q: Any, rates: Any, forces: Any, constants: Any, out: Any, multipliers: Any) -> float:
    """As `joint_accelerations`, by one matrix (3.17) of M̄, Y, and rows of supports, planes and closures.

    The matrix is scaled to unit diagonals and rows. With closures, which may be redundant, the solution of least norm
    is taken.
    """
    linked, joints, tree, kp, kd = read_linked(at[0]), read_joints(at[1]), read_tree(at[2]), constants[3], constants[4]
    R, n, size, held = len(linked.rods), tree.mass.shape[0], len(tree.loops), len(tree.held)
    total = n + R + held + size
    matrix, x = np.zeros((total, total)), np.zeros(total)
    _load_ends(at[0], at[1], forces, constants)
    x[:n] = np.dot(joints.ends.copy().reshape(-1), tree.maps)
    matrix[:n, :n] = tree.mass
    for k in range(R):
        link = linked.links[k]
        rod, row, place = linked.rods[link.rod], n + link.rod, linked.rods[link.rod].q + link.nz
        b, b_rate = direction_of(rod, q, place), direction_of(rod, rates, place)
        for p in range(3):
            matrix[row, tree.at[link.rod] + p] = rod.J * b[p]
        x[row] = -rod.J * dot(b, b) * stretch_term(b, b_rate, kp, kd)
    matrix[n + R : n + R + held, :n] = tree.held
    matrix[n + R + held :, :n] = tree.loops
    _gap_rates(linked, joints, kp, kd, x[n + R + held :])
    scale = np.ones(total)
    for i in range(n):
        scale[i] = 1.0 / np.sqrt(matrix[i, i])
    for i in range(n, total):
        square = 0.0
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
    accelerate_points(forces, linked.points, constants, out)
    return _supports_power(at[0], at[1], forces, constants, out)


@owning
def _supports_power(address: int, joints_at: int, forces: Any, gravity: Any, accelerations: Any) -> float:
    """Power of the moved supports [W]: what each tree's momentum takes that loads and closures do not give it."""
    linked, joints = read_linked(address), read_joints(joints_at)
    power = moved_nodes_power(address, forces)
    if len(linked.motions) == 0:
        return power
    set_ends(address, forces, joints_at)
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
        for x in range(3):
            ends[k, 0, x], ends[k, 1, x] = first[x], second[x]
            if link.drive >= 0:
                need = rod.mass * (0.5 * (first[x] + second[x]) - gravity[x])
                reactions[link.drive, x] += need - joints.ends[link.rod, 0, x] - joints.ends[link.rod, 1, x]
    for m in range(len(linked.motions)):
        power += dot(row_of(reactions, m), row_of(linked.motions[m], 1))
    return power
