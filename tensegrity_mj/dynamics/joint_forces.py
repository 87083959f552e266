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

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import IntArray
from tensegrity_mj.dynamics.kernels import (
    accelerate_points,
    accelerate_rod,
    added_forces,
    direction_of,
    forces_on_rod,
    hold,
    in_plane,
    own_mass,
    stretch_term,
    write_coordinates,
)
from tensegrity_mj.dynamics.linked import Linked, LinkedRecords, normalize_linked, place_linked
from tensegrity_mj.dynamics.native.elements import clear
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, add, column_of, dot, minus, plus, put, row_of, times, vector
from tensegrity_mj.dynamics.native.views import Table, view_of

# The plan for compiled code; joints are numbered as they are eliminated, rods as in the structure.
Joints, _pack_joints = view_of(
    "JointPlan",
    joints=("i8", "joint_count", 4),  # rod row and end of the owner, rod row and end of the other
    first=("i8", "row_count"),  # first column of each row of S, three rows a joint, that is not zero
    start=("i8", "row_count"),  # where in `values` each row's first column is
    attached=("i8", "start_count"),  # where each link's entries of `attachments` start, and the last one's end
    attachments=("i8", "attachment_count", 3),  # joint, end of the rod, +1 for the other, -1 for the owner; by joints
    closures=("i8", "closure_count"),  # the joint of each closure
    values=("f8", "value_count"),  # S, and later L
    pivots=("f8", "row_count"),  # 1 / D, or 0
    x=("f8", "row_count"),  # right-hand side, and later the forces on the others [N]
    ends=("f8", "rod_count", 2, 3),  # forces at the rods' ends [N]
    free=("f8", "rod_count", 2, 3),  # accelerations of the ends without forces of joints [m/s²]
    b=("f8", "rod_count", 3),  # in world components
    c=("f8", "rod_count"),  # of `stretch_term`
    blocks=("f8", 3, 3, 3),  # room for `_compliance`
)


def plan_joints(records: LinkedRecords) -> Table:
    """Lay out the matrix S of one structure: return a `Joints`."""
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
    return _pack_joints(
        joints=joints[order],
        first=first,
        start=start[:-1],
        attached=attached,
        attachments=np.array(attachments, np.int64).reshape(-1, 3),
        closures=places[size - closures :],
        values=np.zeros(int(start[-1])),
        pivots=np.zeros(3 * size),
        x=np.zeros(3 * size),
        ends=np.zeros((count, 2, 3)),
        free=np.zeros((count, 2, 3)),
        b=np.zeros((count, 3)),
        c=np.zeros(count),
        blocks=np.zeros((3, 3, 3)),
    )


def _elimination_order(at_rod: list[list[int]], size: int) -> IntArray:
    """Joints by reverse Cuthill-McKee on the graph of joints that share a rod."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    pairs = np.array([(a, b) for numbers in at_rod for a in numbers for b in numbers if a != b]).reshape(-1, 2)
    if len(pairs) == 0:
        return np.arange(size)
    graph = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    return np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True), np.int64)


# Round-off leaves about 1e-15 of a pivot that should be zero. An error ε of the nodes makes a redundant joint's pivot
# of the order of ε², so that drifts up to a millionth are recognized.
LEAST_PIVOT = 1e-12


@inlined
def answer_of_rod(rod: Any, link: Any, b: Any, c: float, ends: Any, g: Any, drive: Any, added: Any) -> Any:
    """r̈ at σ, b̈ and Jλ of a rod with forces at its ends under a gravity g; r̈ is seen from its support.

    The support accelerates by `drive`. A dry rod that is not held is uniform, and answers as a body about its centre of
    mass, where r and b do not mix.
    Added mass feels the whole acceleration, and acts across the rod, so that it has no part in λ.
    """
    first, second = ends
    g = minus(g, drive)
    if added is None:
        if not link.held:
            torque = times(0.5 * rod.length, minus(second, first))
            inertia = rod.mass * rod.length * rod.length / 12.0
            along = rod.rigid * dot(b, torque) / dot(b, b)
            centre = in_plane(rod, plus(times(1.0 / rod.mass, plus(first, second)), g))
            b_acc = minus(times(1.0 / inertia, in_plane(rod, torque)), times(along / inertia + c, b))
            return plus(centre, times((rod.sigma - 0.5) * rod.length, b_acc)), b_acc, inertia * c + along
    else:
        own = own_mass(added, link.rod)
        across = minus(drive, times(dot(b, drive) / dot(b, b), b))
        first = minus(first, times(own[0] + own[1], across))
        second = minus(second, times(own[2] + own[3], across))
    t_r, t_b = forces_on_rod(rod, first, second, g)
    r_acc, b_acc = accelerate_rod(rod, link.rod, b, c, t_r, t_b, added)
    return r_acc, b_acc, rod.J * c - dot(b, minus(times(rod.f, r_acc), t_b)) / dot(b, b)


@borrowing
def _compliance(rod: Any, link: Any, b: Any, added: Any, A: Any) -> None:
    """(3, 3) blocks of how the ends answer forces at the ends: A[0] of i to i, A[1] of i to j, A[2] of j to j.

    Of wet rods they are symmetric where α is.
    """
    if added is None and not link.held:
        per_square, per_mass = rod.rigid / dot(b, b), 1.0 / rod.mass
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
        r_acc, b_acc = accelerate_rod(rod, link.rod, b, 0.0, unit, times(-back, unit), added)
        first = minus(r_acc, times(back, b_acc))
        r_acc, b_acc = accelerate_rod(rod, link.rod, b, 0.0, unit, times(ahead, unit), added)
        other, second = minus(r_acc, times(back, b_acc)), plus(r_acc, times(ahead, b_acc))
        for x in range(3):
            A[0, x, y], A[1, x, y], A[2, x, y] = first[x], other[x], second[x]


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
def _assemble(linked: Any, joints: Any, added: Any) -> None:
    """S of the directions b of the moment."""
    values, first, start, attachments = joints.values, joints.first, joints.start, joints.attachments
    for k in range(len(values)):
        values[k] = 0.0
    for k in range(len(linked.links)):
        low, high = joints.attached[k], joints.attached[k + 1]
        if low == high:
            continue
        link = linked.links[k]
        _compliance(linked.rods[link.rod], link, row_of(joints.b, link.rod), added, joints.blocks)
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
    add(joints.ends[joints.joints[e, 2]], joints.joints[e, 3], force)
    add(joints.ends[joints.joints[e, 0]], joints.joints[e, 1], times(-1.0, force))


@borrowing
def _add_joint_forces(joints: Any) -> None:
    """Add the forces x of the joints to the ends of the rods."""
    for e in range(len(joints.joints)):
        push_joint(joints, e, joints.x[3 * e : 3 * e + 3])


@borrowing
def set_ends(address: int, forces: Any, joints_at: int) -> None:
    """The forces at the rods' ends: those on the nodes (N, 3) [N], which the node's owner takes."""
    linked, joints = Linked(address), Joints(joints_at)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        put(joints.ends[link.rod], 0, row_of(forces, rod.i) if link.owns[0] else ZERO)
        put(joints.ends[link.rod], 1, row_of(forces, rod.j) if link.owns[1] else ZERO)


@borrowing
def joint_accelerations(model: Any, added: Any, q: Any, rates: Any, out: Any) -> float:
    """q̈ (nq,) and λ (R,) for nodal forces (N, 3) [N] at a state that `place_linked` has placed.

    Args:
        model: a view with `linked`, `joints` and `tree`, addresses of a `Linked`, a `Joints` and a `Tree`; `forces` on
            the nodes; `gravity` (3,) [m/s²]; `kp` and `kd`, Baumgarte's gains of (3.25) for lengths and closures, or
            zero; and `multipliers`, λ, which are written.
        added: see `kernels`.
        q, rates: the state.
        out: q̈.

    Returns:
        The power of the moved supports [W].
    """
    linked, joints = Linked(model.linked), Joints(model.joints)
    forces, multipliers = model.forces, model.multipliers
    g, kp, kd = vector(model.gravity), model.kp, model.kd
    set_ends(model.linked, forces, model.joints)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        place = rod.q + link.nz
        b, b_rate = direction_of(rod, q, place), direction_of(rod, rates, place)
        c = stretch_term(rod, b, b_rate, kp, kd)
        joints.c[link.rod] = c
        put(joints.b, link.rod, b)
        if joints.attached[k] == joints.attached[k + 1]:
            continue
        drive = acceleration_of(linked, link.motion)
        ends = row_of(joints.ends[link.rod], 0), row_of(joints.ends[link.rod], 1)
        r_acc, b_acc, _ = answer_of_rod(rod, link, b, c, ends, g, drive, added)
        r_acc = plus(r_acc, drive)
        put(joints.free[link.rod], 0, minus(r_acc, times(rod.sigma * rod.length, b_acc)))
        put(joints.free[link.rod], 1, plus(r_acc, times((1.0 - rod.sigma) * rod.length, b_acc)))
    if len(joints.joints) > 0:
        _assemble(linked, joints, added)
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
    if added is not None:
        added[1][:] = 0.0
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        b, drive = row_of(joints.b, link.rod), acceleration_of(linked, link.motion)
        ends = row_of(joints.ends[link.rod], 0), row_of(joints.ends[link.rod], 1)
        r_acc, b_acc, along = answer_of_rod(rod, link, b, joints.c[link.rod], ends, g, drive, added)
        multipliers[link.rod] = along * rod.per_J
        write_coordinates(rod, link.nz, r_acc, b_acc, out)
        if added is not None:
            hold(rod, added_forces(rod, b, own_mass(added, link.rod), plus(r_acc, drive), b_acc), added[1])
        if link.motion >= 0:
            # The pull of the support that moves r as it does: m r̈ + f b̈ = t_r + reaction.
            t_r = plus(plus(ends[0], ends[1]), times(rod.mass, minus(g, drive)))
            if added is not None:
                pair = added_forces(rod, b, own_mass(added, link.rod), plus(r_acc, drive), b_acc)
                t_r = plus(t_r, plus(pair[0], pair[1]))
            reaction = minus(plus(times(rod.mass, r_acc), times(rod.f, b_acc)), t_r)
            power += dot(reaction, row_of(linked.motions[link.motion], 1))
    accelerate_points(forces, linked.points, model.gravity, out)
    return power + moved_nodes_power(model.linked, forces)


@inlined
def acceleration_of(linked: Any, motion: int) -> Any:
    """d̈ of a motion, zero for none."""
    return row_of(linked.motions[motion], 2) if motion >= 0 else ZERO


@borrowing
def moved_nodes_power(address: int, forces: Any) -> float:
    """Power [W] of what moves the fixed nodes against the forces (N, 3) on them."""
    linked = Linked(address)
    power = 0.0
    for n in range(len(linked.moved_nodes)):
        moved = linked.motions[linked.moved_nodes[n, 1]]
        power -= dot(row_of(forces, linked.moved_nodes[n, 0]), row_of(moved, 1))
    return power


NEWTON_STEPS = 12


@borrowing
def _close(address: int, joints_at: int, q: Any, change: Any, row: int) -> None:
    """Add to `change` (q itself, or q̇) the least change, weighted by masses, that takes the gaps of row 0 or 1 away."""
    linked, joints = Linked(address), Joints(joints_at)
    for e in range(len(joints.x)):
        joints.x[e] = 0.0
    for a in range(len(joints.closures)):
        for x in range(3):
            joints.x[3 * joints.closures[a] + x] = -linked.gaps[a, row, x]
    _solve(joints)
    for k in range(len(linked.rods)):
        clear(joints.ends[k])
    _add_joint_forces(joints)
    for k in range(len(linked.links)):
        link = linked.links[k]
        rod = linked.rods[link.rod]
        b, ends = row_of(joints.b, link.rod), (row_of(joints.ends[link.rod], 0), row_of(joints.ends[link.rod], 1))
        r, turn, _ = answer_of_rod(rod, link, b, 0.0, ends, ZERO, ZERO, None)
        for p in range(link.nz):
            change[rod.q + p] += dot(column_of(rod.E, p), r)
        for p in range(rod.nb):
            change[rod.q + link.nz + p] += dot(column_of(rod.B, p), turn)


@borrowing
def largest_gap(address: int, row: int) -> float:
    """The longest gap of any closure: its length [m] (row 0), or its rate [m/s] (row 1)."""
    linked = Linked(address)
    square = 0.0
    for a in range(len(linked.gaps)):
        gap = row_of(linked.gaps[a], row)
        square = max(square, dot(gap, gap))
    return np.sqrt(square)


@borrowing
def _prepare_to_close(address: int, joints_at: int, q: Any) -> None:
    """S of q, factored."""
    linked, joints = Linked(address), Joints(joints_at)
    for k in range(len(linked.links)):
        link = linked.links[k]
        b = direction_of(linked.rods[link.rod], q, linked.rods[link.rod].q + link.nz)
        put(joints.b, link.rod, b)
    _assemble(linked, joints, None)
    _factor(joints)


@borrowing
def project_linked(address: int, joints_at: int, q: Any, rates: Any, nodes: Any, velocities: Any) -> None:
    """Put q and q̇ back onto all constraints: (3.23)-(3.24) for the lengths, and Newton's method for the closures.

    The latter are the least changes in the metric of the masses, as impulses at the joints are; the former are not, and
    change momenta. The nodes and velocities (N, 3) are those of the corrected state afterwards.
    """
    normalize_linked(address, q, rates)
    place_linked(address, q, rates, nodes, velocities)
    joints = Joints(joints_at)
    if len(joints.closures) == 0:
        return
    before = np.inf
    for _ in range(NEWTON_STEPS):
        gap = largest_gap(address, 0)
        if not gap > 0.0 or gap > 0.5 * before:
            break  # round-off does not fall any further
        before = gap
        _prepare_to_close(address, joints_at, q)
        _close(address, joints_at, q, q, 0)
        normalize_linked(address, q, rates)
        place_linked(address, q, rates, nodes, velocities)
    _prepare_to_close(address, joints_at, q)
    _close(address, joints_at, q, rates, 1)
    place_linked(address, q, rates, nodes, velocities)
