"""Random structures that stand still, with every string taut, in a stable equilibrium: by construction.

    structure = random_taut_structure(np.random.default_rng(7), rods=5, planar=False)

Rods are strewn about, their ends tied to near ones and to fixed nodes around, and every string gets a force density
u > 0. The structure is then let go until Σ u L²/2 is least: there it is in equilibrium with just these u, and stable.
A stiffness k > u gives each string the rest length L (1 - u/k). It only adds k - u >= 0 to what a string resists along
itself, so that the equilibrium stays stable. The nodes there are the structure's reference.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import MOST_FOUND, check_nodes, positive, whole
from tensegrity_mj.basics.fields import function_of
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.model import StaticModel

PLANE = (0.0, 0.0, 1.0)
ATTEMPTS = 60
PRUNINGS = 20  # in an attempt: of strings that become very short
SHORTEST = 0.08  # of the mean rod length: a shorter string turns by much in a small motion
SOFTEST = 1e-4  # of the largest force density: the least stiffness of a structure that counts as stable
ANCHOR_PULL = 3.0  # how much stronger than the others strings to fixed nodes pull, so that they keep the whole open


@dataclass(frozen=True, eq=False)
class RandomTautStructure:
    """A random class 1 structure whose strings are all taut at its reference nodes, in a stable equilibrium.

    Attributes:
        rods: how many.
        planar: everything lies and moves in the plane z = 0.
        pinned: the part of the rods that turn about one of their ends, which is fixed.
        stiffness: [N/m] the median of the strings'.
        prestrain: range of u/k, the elongation over the length, within (0, 1).
        mass_ratio: ratio of the heaviest to the lightest rod, about 1 kg; log-uniform.
        damping_ratio: range of ζ; a string's c is 2 ζ √(k m) with the mean mass of its ends, m/4 of their rods.
        size: [m] mean length of the rods.

    Raises:
        OptionError: for options out of range.
        InfeasibleError: if no attempt ends in a stable equilibrium without very short strings (not seen so far).
    """

    rng: np.random.Generator
    _: KW_ONLY
    rods: int = 3
    planar: bool = False
    pinned: float = 0.3
    stiffness: float = 1000.0
    prestrain: tuple[float, float] = (1e-3, 1e-1)
    mass_ratio: float = 4.0
    damping_ratio: tuple[float, float] = (0.0, 0.0)
    size: float = 1.0

    def __call__(self) -> Structure:
        check_nodes(
            "random_taut_structure: rods", self.rods, 2 * whole("random_taut_structure: rods", self.rods, 1), MOST_FOUND
        )
        low, high = self.prestrain
        if not 0 < low <= high < 1:
            raise OptionError(f"prestrain = {self.prestrain!r}; it must be a range within (0, 1)")
        if not self.mass_ratio >= 1 or not 0 <= self.damping_ratio[0] <= self.damping_ratio[1]:
            raise OptionError(
                f"mass_ratio = {self.mass_ratio!r} and damping_ratio = {self.damping_ratio!r}: >= 1, and a range >= 0"
            )
        positive("stiffness", self.stiffness, "N/m")
        positive("size", self.size, "m")
        for _ in range(ATTEMPTS):
            found = _drawn(self.rng, self.rods, self.planar, self.pinned, self.size)
            if found is None:
                continue
            net, nodes, u = found
            k = u / np.exp(self.rng.uniform(np.log(low), np.log(high), len(u)))
            scale = self.stiffness / float(np.median(k))
            masses = np.exp(self.rng.uniform(-0.5, 0.5, self.rods) * np.log(self.mass_ratio))
            if self.rods > 1 and self.mass_ratio > 1:  # the two that make the ratio
                masses[:2] = self.mass_ratio**0.5, self.mass_ratio**-0.5
            at_ends = np.append(np.repeat(0.25 * masses, 2), np.zeros(len(nodes) - 2 * self.rods))
            pairs = net.string_nodes
            mass = at_ends[pairs].sum(axis=1) / np.maximum(1, (at_ends[pairs] > 0).sum(axis=1))
            zeta = self.rng.uniform(*self.damping_ratio, len(u))
            return Structure.from_arrays(
                nodes,
                net.rod_nodes,
                pairs,
                rod_mass=masses,
                stiffness=scale * k,
                damping=2 * zeta * np.sqrt(scale * k * mass),
                force_density=scale * u,
                rod_radius=0.01 * self.size,
                supports=[rod.support for rod in net.rods],
                fixed_nodes=range(2 * self.rods, len(nodes)),
                name="random taut",
            )
        raise InfeasibleError(f"{ATTEMPTS} attempts gave no stable structure of {self.rods} rods; use another seed")


random_taut_structure = function_of(RandomTautStructure)


def _drawn(
    rng: np.random.Generator, rods: int, planar: bool, pinned: float, size: float
) -> tuple[Structure, Array, Array] | None:
    """A net of rods and strings, the nodes (N, 3) of its equilibrium, and u (M,); None where that is no good."""
    axes = 2 if planar else 3
    half = 0.6 * size * (2 * rods) ** (1 / axes)

    def points(count: int) -> Array:
        return np.pad(rng.uniform(-half, half, (count, axes)), ((0, 0), (0, 3 - axes)))

    def directions(count: int) -> Array:
        x = np.pad(rng.normal(size=(count, axes)), ((0, 0), (0, 3 - axes)))
        return x / np.linalg.norm(x, axis=1)[:, None]

    centers, spans = points(rods), directions(rods) * size * rng.uniform(0.6, 1.4, rods)[:, None]
    anchors = max(axes + 1, round(2.5 * rods ** ((axes - 1) / axes)))
    around = directions(anchors) * (1.2 * half * axes**0.5)
    ends = np.stack([centers - 0.5 * spans, centers + 0.5 * spans], axis=1).reshape(-1, 3)
    nodes = np.concatenate([ends, around])
    held = rng.uniform(size=rods) < pinned
    pairs = np.array(_ties(nodes, rods, near=axes, held=held))
    u = np.exp(rng.uniform(-0.7, 0.7, len(pairs)))
    u[(pairs >= 2 * rods).any(axis=1)] *= ANCHOR_PULL
    plane = PLANE if planar else None
    supports = [Support.pinned(0.0, plane) if one else Support.free(0.5, plane) for one in held]
    for _ in range(PRUNINGS):
        net = Structure.from_arrays(
            nodes,
            np.arange(2 * rods).reshape(-1, 2),
            pairs,
            rod_mass=1.0,
            stiffness=u,
            supports=supports,
            fixed_nodes=range(2 * rods, len(nodes)),
        )
        try:
            # L0 = 0 and k = u: the force of a string is u times its span.
            state = find_equilibrium(StaticModel.of(net, rest_lengths=np.zeros(len(u))))
        except InfeasibleError:
            return None
        nodes, long_enough = state.nodes, state.lengths >= SHORTEST * size
        if long_enough.all():
            return (net, nodes, u) if state.lowest_stiffness > SOFTEST * u.max() else None
        # Without the strings that have become very short it goes on from here; every end keeps two.
        pairs, u = pairs[long_enough], u[long_enough]
        used = np.bincount(pairs.ravel(), minlength=len(nodes))
        needed = np.ones(len(nodes), bool)
        needed[0 : 2 * rods : 2] = ~held
        if np.any(used[needed] < np.where(np.arange(len(nodes)) < 2 * rods, 2, 1)[needed]):
            return None
    return None


def _ties(nodes: Array, rods: int, near: int, held: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Pairs of nodes: every end with the nearest ends of other rods, every fixed node with the nearest ends."""
    ends, count = 2 * rods, len(nodes)
    pairs: set[tuple[int, int]] = set()
    fixed_end = np.zeros(count, bool)
    fixed_end[0:ends:2] = held  # the end that a pinned rod turns about needs no string
    for a in range(count):
        if fixed_end[a]:
            continue
        distance = np.linalg.norm(nodes[:ends] - nodes[a], axis=1)
        distance[fixed_end[:ends]] = np.inf
        if a < ends:
            distance[2 * (a // 2) : 2 * (a // 2) + 2] = np.inf
        for b in np.argsort(distance, kind="stable")[:near].tolist():
            if np.isfinite(distance[b]):
                pairs.add((min(a, b), max(a, b)))
    for a in range(ends):  # a fixed node for every end that has less than two strings
        if not fixed_end[a] and sum(a in pair for pair in pairs) < 2:
            order = np.argsort(np.linalg.norm(nodes[ends:] - nodes[a], axis=1), kind="stable")
            pairs.update((a, ends + b) for b in order[:2].tolist())
    return sorted(pairs)
