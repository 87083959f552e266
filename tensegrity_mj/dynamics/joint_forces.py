"""Joint forces of rods that share nodes, in a time proportional to their number.

At each joint an unknown force acts on the end of one rod, and its opposite on the end of the node's owner. A rod's ends
accelerate by what acts on the rod anyway plus a symmetric (6, 6) matrix times the forces at its two ends, so that
"both ends of a joint accelerate alike" is a symmetric positive semidefinite system S x = y with a (3, 3) block for each
two joints of one rod. It is held by its skyline after reverse Cuthill-McKee, block tridiagonal for a chain, and
solved by LDLᵀ.

Where joints say more than rods have freedoms (a planar loop in space, a braced square), S is singular. A pivot below
`LEAST_PIVOT` of the block's largest entry is one of a joint that the others satisfy already: its force is zero, and the
accelerations are right all the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import IntArray
from tensegrity_mj.dynamics.kernels import accelerate_points, direction_of, rod_accelerations
from tensegrity_mj.dynamics.linked import (
    LinkedRecords,
    read_linked,
    stretch_term,
    write_coordinates,
)
from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, floats, inlined, integers
from tensegrity_mj.dynamics.native.vectors import ZERO, dot, minus, plus, row_of, times, vector

# Round-off leaves about 1e-15 of a pivot that should be zero. An error ε of the nodes makes a redundant joint's pivot
# of the order of ε², so that drifts up to a millionth are recognized.
LEAST_PIVOT = 1e-12


class JointArrays(NamedTuple):
    """What compiled code sees of a `JointPlan`; joints are numbered as they are eliminated, rods as in the structure.

    Attributes:
        joints: (E, 4) rod row and end of the owner, rod row and end of the other.
        first: (3E,) first column of each row of S that is not zero.
        start: (3E,) where in `values` each row's first column is.
        attached: (R + 1,) where each link's entries of `attachments` start.
        attachments: (2E, 3) joint, end of the rod, and +1 for the other or -1 for the owner; joints ascend.
        closures: (C,) the joint of each closure.
        values: S, and later L.
        pivots: (3E,) 1 / D, or 0.
        x: (3E,) right-hand side, and later the forces on the others [N].
        ends: (R, 2, 3) forces at the rods' ends [N].
        free: (R, 2, 3) accelerations of the ends without forces of joints [m/s²].
        b: (R, 3) in world components.
        c: (R,) of `stretch_term`.
        closure_forces: (C, 3) forces of the closures on the others [N].
        blocks: (3, 3, 3) room for `_compliance`.
    """

    joints: Any
    first: Any
    start: Any
    attached: Any
    attachments: Any
    closures: Any
    values: Any
    pivots: Any
    x: Any
    ends: Any
    free: Any
    b: Any
    c: Any
    closure_forces: Any
    blocks: Any


@dataclass(frozen=True, eq=False)
class JointPlan:
    """Where everything of S is, for one structure.

    Attributes:
        arrays: see `JointArrays`.
        table: sizes and addresses of them.
    """

    arrays: JointArrays
    table: IntArray

    @classmethod
    def of(cls, records: LinkedRecords) -> JointPlan:
        """The plan of some records."""
        rods, count = records.rods, len(records.rods)
        joints = np.array(
            [
                (owner, int(rods[owner]["j"] == node), other, int(rods[other]["j"] == node))
                for node, owner, other in records.forest.joints
            ],
            np.int64,
        ).reshape(-1, 4)
        size = len(joints)
        at_rod: list[list[int]] = [[] for _ in range(count)]
        for number, (owner, _, other, _) in enumerate(joints):
            at_rod[owner].append(number)
            at_rod[other].append(number)
        order = _elimination_order(at_rod, size)
        places = np.empty(size, np.int64)
        places[order] = np.arange(size)
        first_block = np.arange(size)
        for numbers in at_rod:
            if numbers:
                lowest = int(places[numbers].min())
                first_block[places[numbers]] = np.minimum(first_block[places[numbers]], lowest)
        first = np.repeat(3 * first_block, 3)
        lengths = np.arange(3 * size) - first + 1
        start = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        attached, attachments = [0], []
        for link in records.links:
            row = int(link["rod"])
            for place in sorted(int(places[number]) for number in at_rod[row]):
                owner, end, other, other_end = joints[order[place]]
                attachments.append((place, other_end, 1) if other == row else (place, end, -1))
            attached.append(len(attachments))
        closures = len(records.forest.closures)
        arrays = JointArrays(
            joints=np.ascontiguousarray(joints[order]),
            first=first.astype(np.int64),
            start=start[:-1].copy(),
            attached=np.array(attached, np.int64),
            attachments=np.array(attachments, np.int64).reshape(-1, 3),
            closures=places[size - closures :].copy(),
            values=np.zeros(int(start[-1])),
            pivots=np.zeros(3 * size),
            x=np.zeros(3 * size),
            ends=np.zeros((count, 2, 3)),
            free=np.zeros((count, 2, 3)),
            b=np.zeros((count, 3)),
            c=np.zeros(count),
            closure_forces=np.zeros((closures, 3)),
            blocks=np.zeros((3, 3, 3)),
        )
        table = np.array([size, count, closures, start[-1], *(address_of(array) for array in arrays)], np.int64)
        return cls(arrays, table)


def _elimination_order(at_rod: list[list[int]], size: int) -> IntArray:
    """Joints by reverse Cuthill-McKee on the graph of joints that share a rod."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    pairs = np.array([(a, b) for numbers in at_rod for a in numbers for b in numbers if a != b]).reshape(-1, 2)
    if len(pairs) == 0:
        return np.arange(size)
    graph = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    return np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True), np.int64)


@inlined
def read_joints(address: int) -> Any:
    """The arrays of a `JointPlan`."""
    table = integers(address, (19,))
    E, R, C = table[0], table[1], table[2]
    return JointArrays(
        integers(table[4], (E, 4)),
        integers(table[5], (3 * E,)),
        integers(table[6], (3 * E,)),
        integers(table[7], (R + 1,)),
        integers(table[8], (2 * E, 3)),
        integers(table[9], (C,)),
        floats(table[10], (table[3],)),
        floats(table[11], (3 * E,)),
        floats(table[12], (3 * E,)),
        floats(table[13], (R, 2, 3)),
        floats(table[14], (R, 2, 3)),
        floats(table[15], (R, 3)),
        floats(table[16], (R,)),
        floats(table[17], (C, 3)),
        floats(table[18], (3, 3, 3)),
    )


@inlined
def _in_plane(rod: Any, v: Any) -> Any:
    """B Bᵀ v."""
    if rod.nb == 3:
        return v
    B = rod.B
    p = B[0, 0] * v[0] + B[1, 0] * v[1] + B[2, 0] * v[2]
    q = B[0, 1] * v[0] + B[1, 1] * v[1] + B[2, 1] * v[2]
    return B[0, 0] * p + B[0, 1] * q, B[1, 0] * p + B[1, 1] * q, B[2, 0] * p + B[2, 1] * q


@inlined
def answer_of_rod(rod: Any, held: int, b: Any, c: float, first: Any, second: Any, g: Any) -> Any:
    """r̈ at σ, b̈ and Jλ of a rod with forces at its ends under a gravity g, all as tuples.

    A rod that is not held answers as a body about its centre of mass, where r and b do not mix.
    """
    if held:
        t_r = plus(plus(first, second), times(rod.mass, g))
        t_b = plus(times(rod.length, minus(times(1.0 - rod.sigma, second), times(rod.sigma, first))), times(rod.f, g))
        r_acc, b_acc = rod_accelerations(rod, b, c, t_r, t_b)
        along = rod.J * c - dot(b, minus(times(rod.f, r_acc), t_b)) / dot(b, b)
        return r_acc, b_acc, along
    torque = times(0.5 * rod.length, minus(second, first))
    inertia = rod.mass * rod.length * rod.length / 12.0
    along = dot(b, torque) / dot(b, b)
    centre = _in_plane(rod, plus(times(1.0 / rod.mass, plus(first, second)), g))
    b_acc = minus(times(1.0 / inertia, _in_plane(rod, torque)), times(along / inertia + c, b))
    return plus(centre, times((rod.sigma - 0.5) * rod.length, b_acc)), b_acc, inertia * c + along


@borrowing
def _compliance(rod: Any, held: int, b: Any, A: Any) -> None:
    """(3, 3) blocks of how the ends answer forces at the ends: A[0] of i to i, A[1] of i to j, A[2] of j to j."""
    if not held:
        per_square, per_mass = 1.0 / dot(b, b), 1.0 / rod.mass
        for x in range(3):
            for y in range(3):
                plane = 1.0 if x == y else 0.0
                if rod.nb == 2:
                    plane = rod.B[x, 0] * rod.B[y, 0] + rod.B[x, 1] * rod.B[y, 1]
                turn = 3.0 * (plane - b[x] * b[y] * per_square)
                A[0, x, y] = A[2, x, y] = per_mass * (plane + turn)
                A[1, x, y] = per_mass * (plane - turn)
        return
    back, ahead = rod.sigma * rod.length, (1.0 - rod.sigma) * rod.length
    for y in range(3):
        unit = (1.0 if y == 0 else 0.0, 1.0 if y == 1 else 0.0, 1.0 if y == 2 else 0.0)
        r_acc, b_acc = rod_accelerations(rod, b, 0.0, unit, times(-back, unit))
        first = minus(r_acc, times(back, b_acc))
        r_acc, b_acc = rod_accelerations(rod, b, 0.0, unit, times(ahead, unit))
        other, second = minus(r_acc, times(back, b_acc)), plus(r_acc, times(ahead, b_acc))
        A[0, 0, y], A[0, 1, y], A[0, 2, y] = first[0], first[1], first[2]
        A[1, 0, y], A[1, 1, y], A[1, 2, y] = other[0], other[1], other[2]
        A[2, 0, y], A[2, 1, y], A[2, 2, y] = second[0], second[1], second[2]


@borrowing
def _factor(joints: Any) -> None:
    """S = L D Lᵀ within its skyline, with 1/D = 0 for pivots of redundant joints."""
    first, start, values, pivots = joints.first, joints.start, joints.values, joints.pivots
    for block in range(len(pivots) // 3):
        scale = 0.0
        for r in range(3 * block, 3 * block + 3):
            scale = max(scale, values[start[r] + r - first[r]])
        for r in range(3 * block, 3 * block + 3):
            low, row = first[r], start[r] - first[r]
            for c in range(low, r):
                total, other = values[row + c], start[c] - first[c]
                for k in range(max(low, first[c]), c):
                    total -= values[row + k] * values[other + k]
                values[row + c] = total
            pivot = values[row + r]
            for c in range(low, r):
                factor = values[row + c] * pivots[c]
                pivot -= factor * values[row + c]
                values[row + c] = factor
            pivots[r] = 1.0 / pivot if pivot > LEAST_PIVOT * scale else 0.0


@borrowing
def _solve(joints: Any) -> None:
    """x of S x = y, in place."""
    first, start, values, x = joints.first, joints.start, joints.values, joints.x
    for r in range(len(x)):
        total, row = x[r], start[r] - first[r]
        for c in range(first[r], r):
            total -= values[row + c] * x[c]
        x[r] = total
    for r in range(len(x)):
        x[r] *= joints.pivots[r]
    for r in range(len(x) - 1, -1, -1):
        value, row = x[r], start[r] - first[r]
        for c in range(first[r], r):
            x[c] -= values[row + c] * value


@borrowing
def _assemble(linked: Any, joints: Any) -> None:
    """S of the directions b of the moment."""
    values, first, start, attachments = joints.values, joints.first, joints.start, joints.attachments
    for k in range(len(values)):
        values[k] = 0.0
    for k in range(len(linked.links)):
        low, high = joints.attached[k], joints.attached[k + 1]
        if low == high:
            continue
        link = linked.links[k]
        _compliance(linked.rods[link.rod], link.held, row_of(joints.b, link.rod), joints.blocks)
        for p in range(low, high):
            row_end, row_sign = attachments[p, 1], attachments[p, 2]
            for q in range(low, p + 1):
                end, sign = attachments[q, 1], float(row_sign * attachments[q, 2])
                block, turned = joints.blocks[row_end + end], row_end > end
                column = 3 * attachments[q, 0]
                for x in range(3):
                    r = 3 * attachments[p, 0] + x
                    at = start[r] - first[r] + column
                    for y in range(x + 1 if p == q else 3):
                        values[at + y] += sign * (block[y, x] if turned else block[x, y])


@inlined
def push_joint(joints: Any, e: int, force: Any) -> None:
    """Add a force (3,) to the end of the joint's other rod, and its opposite to the owner's."""
    for x in range(3):
        joints.ends[joints.joints[e, 2], joints.joints[e, 3], x] += force[x]
        joints.ends[joints.joints[e, 0], joints.joints[e, 1], x] -= force[x]


@borrowing
def _add_joint_forces(joints: Any) -> None:
    """Add the forces x of the joints to the ends of the rods, and keep those of the closures."""
    for e in range(len(joints.joints)):
        push_joint(joints, e, joints.x[3 * e : 3 * e + 3])
    for a in range(len(joints.closures)):
        for x in range(3):
            joints.closure_forces[a, x] = joints.x[3 * joints.closures[a] + x]


@borrowing
def set_ends(address: int, forces: Any, joints_at: int) -> None:
    """The forces at the rods' ends: those on the nodes (N, 3) [N], which the node's owner takes."""
    linked, joints = read_linked(address), read_joints(joints_at)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        for x in range(3):
            joints.ends[link.rod, 0, x] = forces[rod.i, x] if link.owns[0] else 0.0
            joints.ends[link.rod, 1, x] = forces[rod.j, x] if link.owns[1] else 0.0


@borrowing
def joint_accelerations(at: Any, q: Any, rates: Any, forces: Any, constants: Any, out: Any, multipliers: Any) -> float:
    """q̈ (nq,) and λ (R,) for nodal forces (N, 3) [N] at a state that `place_linked` has placed.

    Args:
        at: (3,) addresses of the tables of `LinkedRecords`, `JointPlan` and `TreeEquations`.
        q, rates: the state.
        forces: on the nodes.
        constants: (5,) gravity [m/s²], and Baumgarte's gains k_p, k_d of (3.25) for lengths and closures, or zero.
        out, multipliers: q̈ and λ.

    Returns:
        The power of the moved supports [W].
    """
    linked, joints = read_linked(at[0]), read_joints(at[1])
    g, kp, kd = vector(constants), constants[3], constants[4]
    set_ends(at[0], forces, at[1])
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        place = rod.q + link.nz
        b, b_rate = direction_of(rod, q, place), direction_of(rod, rates, place)
        c = stretch_term(b, b_rate, kp, kd)
        joints.c[link.rod] = c
        joints.b[link.rod, 0], joints.b[link.rod, 1], joints.b[link.rod, 2] = b[0], b[1], b[2]
        if joints.attached[k] == joints.attached[k + 1]:
            continue
        drive = _acceleration_of(linked, link.motion)
        ends = joints.ends[link.rod]
        r_acc, b_acc, _ = answer_of_rod(rod, link.held, b, c, row_of(ends, 0), row_of(ends, 1), minus(g, drive))
        r_acc = plus(r_acc, drive)
        free = joints.free[link.rod]
        for x in range(3):
            free[0, x] = r_acc[x] - rod.sigma * rod.length * b_acc[x]
            free[1, x] = r_acc[x] + (1.0 - rod.sigma) * rod.length * b_acc[x]
    if len(joints.joints) > 0:
        _assemble(linked, joints)
        _factor(joints)
        for e in range(len(joints.joints)):
            for x in range(3):
                joints.x[3 * e + x] = (
                    joints.free[joints.joints[e, 0], joints.joints[e, 1], x]
                    - joints.free[joints.joints[e, 2], joints.joints[e, 3], x]
                )
        for a in range(len(joints.closures)):
            for x in range(3):
                joints.x[3 * joints.closures[a] + x] -= kd * linked.gaps[a, 1, x] + kp * linked.gaps[a, 0, x]
        _solve(joints)
        _add_joint_forces(joints)
    power = 0.0
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        b, ends = row_of(joints.b, link.rod), joints.ends[link.rod]
        here = minus(g, _acceleration_of(linked, link.motion))
        first, second = row_of(ends, 0), row_of(ends, 1)
        r_acc, b_acc, along = answer_of_rod(rod, link.held, b, joints.c[link.rod], first, second, here)
        multipliers[link.rod] = along * rod.per_J
        write_coordinates(rod, link.nz, r_acc, b_acc, out)
        if link.motion >= 0:
            # What the support must pull with, for r to move as it does: m r̈ + f b̈ = t_r + reaction.
            t_r = plus(plus(first, second), times(rod.mass, here))
            reaction = minus(plus(times(rod.mass, r_acc), times(rod.f, b_acc)), t_r)
            power += dot(reaction, row_of(linked.motions[link.motion], 1))
    accelerate_points(forces, linked.points, constants, out)
    return power + moved_nodes_power(at[0], forces)


@inlined
def _acceleration_of(linked: Any, motion: int) -> Any:
    """d̈ of a motion, zero for none."""
    return row_of(linked.motions[motion], 2) if motion >= 0 else ZERO


@borrowing
def moved_nodes_power(address: int, forces: Any) -> float:
    """Power [W] of what moves the fixed nodes against the forces (N, 3) on them."""
    linked = read_linked(address)
    power = 0.0
    for n in range(len(linked.moved_nodes)):
        moved = linked.motions[linked.moved_nodes[n, 1]]
        power -= dot(row_of(forces, linked.moved_nodes[n, 0]), row_of(moved, 1))
    return power
