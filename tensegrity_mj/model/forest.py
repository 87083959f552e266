"""Rods that share nodes, as a forest: which rod hangs on which, and which joints close loops.

A node where k rods meet is k - 1 ball joints. The forest satisfies as many of them as it can by itself, so that the
directions b of all rods and the places of the roots say where every node is; the rest are closures. Both engines use
it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import IntArray
from tensegrity_mj.basics.remembered import once
from tensegrity_mj.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Forest:
    """A spanning forest of the rods of a structure.

    Attributes:
        order: (R,) rod rows; parents come before their children.
        parent: (R,) row of the rod that each rod hangs on, or -1 for a root.
        hinge: (R,) row of the node where it hangs there, or -1 for a root.
        flipped: (R,) whether that is the rod's second node.
        closures: (node row, rod row a, rod row b) of every joint that the forest leaves open; a comes first in `order`.
        owner: (N,) the first rod in `order` at each node, or -1: all other rods of the node are joined to this one.
    """

    order: IntArray
    parent: IntArray
    hinge: IntArray
    flipped: NDArray[np.bool_]
    closures: tuple[tuple[int, int, int], ...]
    owner: IntArray

    @property
    def roots(self) -> IntArray:
        """Rows of the roots, in order."""
        return self.order[self.parent[self.order] < 0]

    @property
    def joints(self) -> list[tuple[int, int, int]]:
        """(node row, owner, other rod) of every joint, hinges first, then closures."""
        hinges = [(int(self.hinge[a]), int(self.parent[a]), int(a)) for a in self.order if self.parent[a] >= 0]
        return hinges + list(self.closures)


@once
def spanning_forest(structure: Structure) -> Forest:
    """The forest of a structure: breadth first, the same for the same structure.

    Roots are, in this sequence: rods pinned, rods held otherwise, and for what is left the rod in the middle of a
    longest path (found by two sweeps). A rod that is held is always a root, for a support says where r is. A planar
    rod has its height from the rod that it hangs on, which is planar, too: structures see to that.
    """
    pairs = structure.rod_nodes.tolist()
    count = len(pairs)
    at_node: list[list[int]] = [[] for _ in structure.nodes]
    for rod, (i, j) in enumerate(pairs):
        at_node[i].append(rod)
        at_node[j].append(rod)
    held = np.array([len(rod.support.directions) for rod in structure.rods], np.int64)
    parent, hinge = np.full(count, -1, np.int64), np.full(count, -1, np.int64)
    owner = np.full(len(at_node), -1, np.int64)
    order: list[int] = []
    seen = np.zeros(count, bool)

    def grow(roots: Iterable[int]) -> None:
        queue = deque(roots)
        seen[list(queue)] = True
        while queue:
            rod = queue.popleft()
            order.append(rod)
            for node in pairs[rod]:
                if owner[node] >= 0:
                    continue
                owner[node] = rod
                for other in at_node[node]:
                    if not seen[other]:
                        seen[other] = True
                        parent[other], hinge[other] = rod, node
                        queue.append(other)

    grow(sorted(np.flatnonzero(held).tolist(), key=lambda rod: -int(held[rod])))
    for first in range(count):
        if not seen[first]:
            grow([_middle(first, pairs, at_node)])
    flipped = np.array([hinge[rod] == pairs[rod][1] for rod in range(count)], bool)
    closures = [
        (node, int(owner[node]), rod)
        for rod in order
        for node in pairs[rod]
        if owner[node] != rod and hinge[rod] != node
    ]
    return Forest(np.array(order, np.int64), parent, hinge, flipped, tuple(closures), owner)


def _middle(first: int, pairs: list[list[int]], at_node: list[list[int]]) -> int:
    """The rod in the middle of a longest path among those that hang together with a rod, none of which is held."""

    def sweep(start: int) -> dict[int, int]:
        """Every rod, by distance, with the one before it on a shortest path from `start`."""
        before = {start: start}
        queue = deque([start])
        while queue:
            rod = queue.popleft()
            for node in pairs[rod]:
                for other in at_node[node]:
                    if other not in before:
                        before[other] = rod
                        queue.append(other)
        return before

    far = list(sweep(first))[-1]
    before = sweep(far)
    path = [list(before)[-1]]
    while path[-1] != far:
        path.append(before[path[-1]])
    return path[len(path) // 2]
