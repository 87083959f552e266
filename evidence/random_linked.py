"""Random structures of class k, built so that they are valid: rods that share nodes, as trees and with loops.

    structure = random_linked_structure(np.random.default_rng(7), rods=4, loops=1, planar=True)

`random_velocities` move any structure the way its supports and rigid rods allow.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array, unit
from tensegrity_mj.basics.checks import MOST_FOUND, check_nodes, whole
from tensegrity_mj.basics.fields import function_of
from tensegrity_mj.model.members import Rod, String, Support, null_space_basis
from tensegrity_mj.model.moved_supports import velocities_with_supports
from tensegrity_mj.model.structure import Structure

FIXED = "f"  # the node in space that strings are tied to
CLEAR = 0.15  # [m] between any two nodes
ATTEMPTS = 1000


@dataclass(frozen=True, eq=False)
class RandomLinkedStructure:
    """A random tree of rods of 0.3 to 0.8 m and 0.2 to 2 kg, with rods that close loops, and strings.

    Attributes:
        rods: number of rods of the tree, at least 1; their ends come in any sequence.
        loops: further rods between nodes of the tree that no rod joins; fewer where there are no such nodes, or where
            one more would leave the structure no motion but as a whole.
        planar: everything lies and moves in one plane of random normal.
        pinned: whether the first rod is held at its first node; otherwise nothing is.
        strings: how many, at least 1, between nodes and to a fixed one; fewer where there are no more pairs.
        stretch: range of (L - L0) / L.
        stiffness, damping: ranges [N/m], [N s/m].

    Raises:
        OptionError: for less than one rod or string.
    """

    rng: np.random.Generator
    _: KW_ONLY
    rods: int = 3
    loops: int = 0
    planar: bool = False
    pinned: bool = True
    strings: int = 3
    stretch: tuple[float, float] = (-0.1, 0.4)
    stiffness: tuple[float, float] = (10.0, 50.0)
    damping: tuple[float, float] = (0.0, 0.0)

    def __call__(self) -> Structure:
        count = whole("random_linked_structure: rods", self.rods, 1)
        check_nodes("random_linked_structure: rods", self.rods, count + 2, MOST_FOUND)
        whole("random_linked_structure: strings", self.strings, 1)
        normal = unit(self.rng.normal(size=3)) if self.planar else None
        basis: Array = np.eye(3) if normal is None else null_space_basis(normal[None])
        plane = None if normal is None else normal.tolist()

        def towards() -> Array:
            return np.asarray(basis @ unit(np.asarray(self.rng.normal(size=basis.shape[1]))))

        places: list[Array] = [np.zeros(3)]
        pairs: list[tuple[int, int]] = []
        for _ in range(self.rods):
            while True:
                at = int(self.rng.integers(len(places)))
                place = places[at] + self.rng.uniform(0.3, 0.8) * towards()
                if all(np.linalg.norm(place - other) > CLEAR for other in places):
                    break
            places.append(place)
            pairs.append((at, len(places) - 1))
        # Each rod of a loop takes one of the ways to move that a tree of n nodes has within itself: in the plane n - 2.
        spare = max(0, (len(places) - 2 if self.planar else 2 * len(places) - 5) - 1)
        left = [(i, j) for i in range(len(places)) for j in range(i + 1, len(places)) if (i, j) not in pairs]
        chosen = [left[int(k)] for k in self.rng.permutation(len(left))[: min(self.loops, spare)]]
        pairs += chosen
        fixed = towards() * 1.5
        for _ in range(ATTEMPTS):
            if all(np.linalg.norm(fixed - place) > CLEAR for place in places):
                break
            fixed = towards() * self.rng.uniform(1.0, 3.0)
        members = []
        for number, (i, j) in enumerate(pairs):
            swapped = bool(self.rng.integers(2))
            ends = (f"n{j}", f"n{i}") if swapped else (f"n{i}", f"n{j}")
            support = Support.free(float(self.rng.uniform()), plane)
            if number == 0 and self.pinned:
                support = Support.pinned(float(swapped), plane)
            members.append(Rod(f"r{number}", ends, float(self.rng.uniform(0.2, 2.0)), 0.005, support))
        free = [pair for pair in left if pair not in chosen]
        first = 1 if self.pinned else 0  # no string from one point that stands still to another
        ties = [(f"n{i}", f"n{j}") for i, j in free] + [(FIXED, f"n{k}") for k in range(first, len(places))]
        order = [ties[int(k)] for k in self.rng.permutation(len(ties))]
        tied = next(pair for pair in order if FIXED in pair)  # one at least: a node must be used
        order = [tied, *(pair for pair in order if pair != tied)]
        nodes = {f"n{k}": place for k, place in enumerate(places)} | {FIXED: fixed}
        cords = []
        for number, (one, other) in enumerate(order[: self.strings]):
            length = float(np.linalg.norm(nodes[one] - nodes[other]))
            rest = length * (1 - float(self.rng.uniform(*self.stretch)))
            k, c = float(self.rng.uniform(*self.stiffness)), float(self.rng.uniform(*self.damping))
            cords.append(String(f"s{number}", (one, other), k, c, rest_length=rest))
        return Structure(
            "random linked",
            {name: place.tolist() for name, place in nodes.items()},
            tuple(members),
            tuple(cords),
            fixed_nodes=(FIXED,),
        )


random_linked_structure = function_of(RandomLinkedStructure)


def random_velocities(rng: np.random.Generator, structure: Structure, nodes: Array, speed: float) -> Array:
    """Node velocities (N, 3) [m/s] that stretch no rigid rod and break no support at the given nodes, of that order."""
    if structure.class_number > 1 or structure.constraints:
        return _linked_velocities(rng, structure, nodes, speed)
    velocities = np.zeros((len(structure.nodes), 3))
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
        support, span = rod.support, nodes[j] - nodes[i]
        middle = support.translation_basis @ (speed * rng.uniform(-1, 1, support.translation_basis.shape[1]))
        axis = unit(rng.normal(size=3)) if support.plane is None else unit(np.array(support.plane))
        turning = np.cross(speed * rng.uniform(-1, 1) * axis, span)
        turning += span * (0.0 if rod.stiffness is None else speed * rng.uniform(-1, 1))
        velocities[i], velocities[j] = middle - support.sigma * turning, middle + (1 - support.sigma) * turning
    for point in structure.lone_masses:
        basis = point.translation_basis
        velocities[structure.node_index[point.node]] = basis @ (speed * rng.uniform(-1, 1, basis.shape[1]))
    for frame in structure.moving_frames:
        velocities += frame.motions(nodes) @ (speed * rng.uniform(-1, 1, 6))
    return velocities


def _linked_velocities(rng: np.random.Generator, structure: Structure, nodes: Array, speed: float) -> Array:
    """Draw random velocities, and keep the part that rods, joints, supports and planes allow."""
    wild = speed * rng.uniform(-1, 1, (len(structure.nodes), 3))
    for rod, pair in zip(structure.rods, structure.rod_nodes, strict=True):
        if rod.support.plane is not None:
            normal = unit(np.array(rod.support.plane))
            wild[pair] -= np.outer(wild[pair] @ normal, normal)
    return velocities_with_supports(structure, nodes, (), wild)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number from low to high, evenly in its logarithm."""
    return float(10 ** rng.uniform(math.log10(low), math.log10(high)))
