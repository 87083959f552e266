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
from tensegrity_mj.basics.functions import function_of
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.vibration.bodies import SLOTS, Bodies
from tensegrity_mj.vibration.small_motions import Vibration, vibration

PLANE = (0.0, 0.0, 1.0)
ATTEMPTS = 60
PRUNINGS = 20  # in an attempt: of strings that become very short, and leaves taken of saddles
KICK = 0.1  # of the mean rod length
SHORTEST = 0.08  # of the mean rod length: a shorter string turns by much in a small motion
SOFTEST = 1e-4  # of the stiffest: the least stiffness of a structure that counts as stable
ANCHOR_PULL = 3.0  # how much stronger than the others strings to fixed nodes pull, so that they keep the whole open
BALANCED = 1e-13  # of the largest force


@dataclass(frozen=True, eq=False)
class RandomTautStructure:
    """A random class 1 structure whose strings are all taut at its reference nodes, in a stable equilibrium.

    Attributes:
        rods: how many.
        planar: everything lies and moves in the plane z = 0.
        pinned: the part of the rods that turn about one of their ends, which is fixed.
        stiffness: [N/m] the median of the strings'.
        prestrain: range of u/k, the elongation over the length, within (0, 1).
        mass_ratio: of the heaviest to the lightest rod, about 1 kg; log-uniform.
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
            stiffness=1.0,
            supports=supports,
            fixed_nodes=range(2 * rods, len(nodes)),
        )
        model = _settled(net, u)
        if model is None:
            return None
        nodes, long_enough = model.nodes, model.length >= SHORTEST * size
        if long_enough.all():
            stiffness, motion = _softest(model)
            if stiffness > SOFTEST:
                return net, nodes, u
            # Newton's steps may end at a saddle: on from beside it.
            nodes = _moved(model, motion * (KICK * size / np.abs(model.motion(motion)).max()))
            continue
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


def _settled(net: Structure, u: Array) -> Vibration | None:
    """The model of the equilibrium where Σ u L²/2 is least, by damped Newton steps; None if it is not met."""
    bodies, scene = Bodies.of(net), Scene(net)
    nodes, still = np.array(net.positions), np.zeros_like(net.positions)
    pairs = net.string_nodes

    def model_at(nodes: Array) -> Vibration:
        # L0 = 0 and k = u: the force of a string is u s.
        return _with_densities(scene, nodes, still, u, bodies)

    def energy(nodes: Array) -> float:
        span = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
        return float(0.5 * np.sum(u * np.sum(span * span, axis=1)))

    model, here = model_at(nodes), energy(nodes)
    shift = 1.0
    for _ in range(300):
        force = _forces(model, u)
        stiffness = model.material + model.geometric
        largest = float(np.abs(force).max())
        if largest <= BALANCED * float(np.max(u * model.length) * 4):
            return model
        # What is not convex is made so by a shift, which falls as the steps succeed.
        while True:
            step = _solved(stiffness, shift, force)
            ahead = _moved(model, step)
            there = energy(ahead)
            if there <= here * (1 + 1e-14):
                break
            shift = max(10 * shift, 1e-6)
            if shift > 1e12:
                return None
        nodes, here = ahead, there
        model = model_at(nodes)
        shift = shift / 10 if shift > 1e-9 else 0.0
    return None


def _with_densities(scene: Scene, nodes: Array, still: Array, u: Array, bodies: Bodies) -> Vibration:
    """The model with tensions u L, all of whose strings resist with u in every direction."""
    k = scene.structure.stiffness
    length = scene.structure.string_lengths(nodes)
    return vibration(scene, nodes, still, length * (1 - u / k), force_densities=u, bodies=bodies)


def _forces(model: Vibration, u: Array) -> Array:
    """(n,) on the coordinates of the model."""
    i, j = model.scene.structure.string_nodes.T
    pull = (u * model.length)[:, None] * model.segments.directions
    forces = np.zeros_like(model.nodes)
    np.add.at(forces, i, pull)
    np.subtract.at(forces, j, pull)
    out = np.zeros((len(model.bodies.mass) + 1, SLOTS))
    np.add.at(out, model.bodies.body, np.einsum("nxs,nx->ns", model.turned, forces))
    return out[:-1].ravel()


def _solved(stiffness: object, shift: float, force: Array) -> Array:
    """(K + shift)⁻¹ f. Coordinates that supports forbid have no stiffness and no force."""
    n = len(force)
    tiny = 1e-12
    if isinstance(stiffness, np.ndarray):
        return np.asarray(np.linalg.solve(stiffness + (shift + tiny) * np.eye(n), force))
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import spsolve

    return np.asarray(spsolve((stiffness + (shift + tiny) * eye_array(n)).tocsc(), force))


def _moved(model: Vibration, y: Array) -> Array:
    """Nodes (N, 3) after a step y, rods as long as they were and points at σ where translations take them."""
    structure, nodes = model.scene.structure, model.nodes + model.motion(y)
    for rod, (i, j), length in zip(structure.rods, structure.rod_nodes.tolist(), structure.rod_lengths, strict=True):
        sigma, span = rod.support.sigma, nodes[j] - nodes[i]
        point = (1 - sigma) * nodes[i] + sigma * nodes[j]
        span = span * (length / np.linalg.norm(span))
        nodes[i], nodes[j] = point - sigma * span, point + (1 - sigma) * span
    return nodes


def _softest(model: Vibration) -> tuple[float, Array]:
    """The least stiffness of all motions that supports allow, as a part of the largest, and that motion y (n,)."""
    stiffness = model.material + model.geometric
    moves = np.flatnonzero(abs(stiffness).sum(axis=0) > 0)
    y = np.zeros(model.size)
    if isinstance(stiffness, np.ndarray):
        values, vectors = np.linalg.eigh(stiffness[np.ix_(moves, moves)])
        y[moves] = vectors[:, 0]
        return float(values[0] / values[-1]), y
    from scipy.sparse.linalg import eigsh

    held = stiffness[moves][:, moves].tocsc()
    start = np.cos(np.arange(len(moves)) ** 1.5) + 0.1
    most = float(eigsh(held, k=1, which="LA", v0=start, return_eigenvectors=False)[0])
    # By inversion below all eigenvalues, where the nearest is the least: -bound of what a rod's compression takes.
    low = -1.01 * float(abs(model.geometric).sum(axis=0).max())
    values, vectors = eigsh(held, k=1, sigma=low, v0=start)
    y[moves] = vectors[:, 0]
    return float(values[0] / most), y
