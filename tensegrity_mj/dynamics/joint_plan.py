"""Where everything of the system of joint forces is, for one structure (`joint_forces`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import IntArray
from tensegrity_mj.dynamics.linked import LinkedRecords
from tensegrity_mj.dynamics.native.pointers import address_of, floats, inlined, integers


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
