"""Layout of the linear system of joint forces for one structure; `joint_forces` solves the system."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import IntArray
from tensegrity_mj.dynamics.linked import LinkedRecords
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
