"""Random valid structures and scenes, built so that they are valid.

    rng = np.random.default_rng(7)
    structure = random_structure(rng, rods=3, support="constrained", planar=True, strings=8)
    scene = random_scene(rng, structure, moving=True, gravity=True, loads=2)

`random_configuration` moves a structure the way its supports and rigid rods allow; `random_velocities` of
`evidence.random_linked` sets it in motion so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np

from evidence.random_linked import random_velocities
from tensegrity_mj.basics.arrays import Array, unit
from tensegrity_mj.basics.checks import MOST_FOUND, check_nodes, whole
from tensegrity_mj.basics.fields import function_of
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.members import PointMass, Rod, String, Support, null_space_basis
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure

SUPPORTS = ("free", "pinned", "constrained")


@dataclass(frozen=True, eq=False)
class RandomStructure:
    """A random structure of about 1 kg and 1 m a rod.

    Attributes:
        rods: how many; 0 needs point masses.
        support: "free", "pinned" or "constrained", or several to draw from for each rod. Constrained ones get
            one or two random oblique directions.
        planar: everything lies and moves in one plane of random normal.
        own_planes: probability that a rod turns in a random plane of its own, where not all is planar.
        strings: how many; None for two a rod and one a point mass. Raised to what it takes to use every fixed
            node and every point mass, and cut to as many pairs of nodes as there are.
        stretch: range of (L - L0) / L at the reference; negative ones are slack.
        fixed_nodes, point_masses: how many.
        stiffness, damping: ranges [N/m], [N s/m].
        sigma: σ of every rod; None for random ones in [0, 1], the ends among them.
        size: [m] length of everything.

    Raises:
        OptionError: for numbers of members that are none, or too many.
    """

    rng: np.random.Generator
    _: KW_ONLY
    rods: int = 3
    support: str | Sequence[str] = SUPPORTS
    planar: bool = False
    own_planes: float = 0.0
    strings: int | None = None
    stretch: tuple[float, float] = (-0.1, 0.4)
    fixed_nodes: int = 1
    point_masses: int = 0
    stiffness: tuple[float, float] = (10.0, 50.0)
    damping: tuple[float, float] = (0.0, 0.0)
    law: StringLaw = StringLaw.CLIPPED
    sigma: float | None = None
    size: float = 1.0

    def __call__(self) -> Structure:
        counts = (self.rods, self.fixed_nodes, self.point_masses)
        for what, number in zip(("rods", "fixed_nodes", "point_masses"), counts, strict=True):
            whole(f"random_structure: {what}", number, 0)
        nodes = self.rods + sum(counts)
        check_nodes("random_structure: (rods, fixed_nodes, point_masses)", counts, nodes, MOST_FOUND)
        normal = unit(self.rng.normal(size=3)) if self.planar else None
        basis = np.eye(3) if normal is None else null_space_basis(normal[None])
        origin = self.size * self.rng.uniform(-1, 1, 3)
        plane = None if normal is None else normal.tolist()
        positions: dict[str, Array] = {}

        def place(near: Array | None = None) -> Array:
            """A point 0.6 to 1.4 sizes from another one, or anywhere in a box that has room for all of them."""
            if near is None:
                half = nodes ** (1 / basis.shape[1])
                return origin + basis @ (0.5 * self.size * half * self.rng.uniform(-1, 1, basis.shape[1]))
            distance = self.size * self.rng.uniform(0.6, 1.4)
            return np.asarray(near + distance * (basis @ unit(self.rng.normal(size=(basis.shape[1],)))))

        def is_clear(points: list[Array]) -> bool:
            return all(np.linalg.norm(p - q) > 0.2 * self.size for p in points for q in positions.values())

        members = []
        kinds = [self.support] if isinstance(self.support, str) else list(self.support)
        for number in range(self.rods):
            i, j = f"a{number + 1}", f"b{number + 1}"
            ends = [(first := place()), place(first)]
            while not is_clear(ends):
                ends = [(first := place()), place(first)]
            positions[i], positions[j] = ends
            own = unit(np.cross(ends[1] - ends[0], self.rng.normal(size=3)))
            turning = own.tolist() if self.rng.uniform() < self.own_planes else None
            where = float(self.rng.choice([0.0, 1.0, 0.5, self.rng.uniform()])) if self.sigma is None else self.sigma
            held = _random_support(self.rng, str(self.rng.choice(kinds)), where, plane or turning)
            members.append(Rod(f"rod {number + 1}", (i, j), float(self.rng.uniform(0.5, 2.0)), 0.01 * self.size, held))
        anchors = [f"f{number + 1}" for number in range(self.fixed_nodes)]
        masses = [f"m{number + 1}" for number in range(self.point_masses)]
        for name in anchors + masses:
            point = place()
            while not is_clear([point]):
                point = place()
            positions[name] = point

        pairs = _random_pairs(self.rng, list(positions), self.rods, anchors, masses, self.strings)
        cords = []
        for number, (i, j) in enumerate(pairs):
            k, c = float(self.rng.uniform(*self.stiffness)), float(self.rng.uniform(*self.damping))
            length = float(np.linalg.norm(positions[j] - positions[i]))
            part = float(self.rng.uniform(*self.stretch))
            name = f"s{number + 1}"
            # Every way to state the prestress that can: force density and tension are never negative.
            way = int(self.rng.integers(3)) if part >= 0 else 0
            if way == 0:
                cords.append(String(name, (i, j), k, c, rest_length=length * (1 - part)))
            elif way == 1:
                cords.append(String(name, (i, j), k, c, tension=k * length * part))
            else:
                cords.append(String(name, (i, j), k, c, force_density=k * part))
        return Structure(
            name="random",
            nodes={name: place.tolist() for name, place in positions.items()},
            rods=tuple(members),
            strings=tuple(cords),
            fixed_nodes=tuple(anchors),
            point_masses=tuple(PointMass(name, float(self.rng.uniform(0.2, 1.0)), plane) for name in masses),
            string_law=self.law,
        )


random_structure = function_of(RandomStructure)


@dataclass(frozen=True, eq=False)
class RandomScene:
    """A random experiment with a structure.

    Attributes:
        displaced: how far the start is from the reference [m and rad]; 0 starts there.
        moving: how fast it starts [m/s and rad/s].
        gravity: 9.81 m/s² in a random direction.
        loads: how many sinusoidal nodal forces.
    """

    rng: np.random.Generator
    structure: Structure
    _: KW_ONLY
    displaced: float = 0.0
    moving: float = 0.0
    gravity: bool = False
    loads: int = 0
    duration: float = 1.0

    def __call__(self) -> Scene:
        nodes = random_configuration(self.rng, self.structure, self.displaced) if self.displaced else None
        start = self.structure.positions if nodes is None else nodes
        return Scene(
            structure=self.structure,
            name="random scene",
            source="drawn by chance",
            gravity=tuple(9.81 * unit(self.rng.normal(size=3))) if self.gravity else (0.0, 0.0, 0.0),
            initial_nodes=nodes,
            initial_velocities=random_velocities(self.rng, self.structure, start, self.moving) if self.moving else None,
            loads=tuple(
                Load(
                    str(self.rng.choice(self.structure.node_names)),
                    tuple(self.rng.normal(size=3)),
                    float(self.rng.uniform(0, 5)),
                    float(self.rng.uniform(-3, 3)),
                )
                for _ in range(self.loads)
            ),
            duration=self.duration,
        )


random_scene = function_of(RandomScene)


def random_configuration(rng: np.random.Generator, structure: Structure, amount: float) -> Array:
    """Node positions (N, 3) that keep rod lengths, supports and planes, about `amount` [m, rad] from the reference."""
    nodes = np.array(structure.positions)
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes, strict=True):
        support, span = rod.support, nodes[j] - nodes[i]
        shift = support.translation_basis @ (amount * rng.uniform(-1, 1, support.translation_basis.shape[1]))
        middle = (1 - support.sigma) * nodes[i] + support.sigma * nodes[j] + shift
        axis = unit(rng.normal(size=3)) if support.plane is None else unit(np.array(support.plane))
        span = _turned(span, axis, amount * rng.uniform(-1, 1))
        nodes[i], nodes[j] = middle - support.sigma * span, middle + (1 - support.sigma) * span
    for point in structure.lone_masses:
        basis = point.translation_basis
        nodes[structure.node_index[point.node]] += basis @ (amount * rng.uniform(-1, 1, basis.shape[1]))
    return nodes


def random_rotation(rng: np.random.Generator) -> Array:
    """A rotation matrix (3, 3), all equally likely."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def _random_support(
    rng: np.random.Generator, kind: str, sigma: float, plane: tuple[float, float, float] | None
) -> Support:
    if kind == "free":
        return Support.free(sigma, plane)
    if kind == "pinned":
        return Support.pinned(sigma, plane)
    # One direction in a plane leaves the other; rows longer than 1 and oblique, as D need not be orthonormal.
    rows = int(rng.integers(1, 3)) if plane is None else 1
    if plane is None:
        matrix = random_rotation(rng)[:rows]
        if rows == 2:
            matrix[1] += 0.5 * matrix[0]
    else:
        matrix = (null_space_basis(np.array([plane])) @ unit(rng.normal(size=2)))[None]
    return Support.constrained(matrix * rng.uniform(0.5, 2.0, (rows, 1)), sigma, plane=plane)


def _random_pairs(
    rng: np.random.Generator,
    names: list[str],
    rods: int,
    anchors: list[str],
    masses: list[str],
    strings: int | None,
) -> list[tuple[str, str]]:
    """Different pairs of nodes for strings, none along a rod or between fixed nodes, every anchor and mass in one."""

    def allowed(i: str, j: str) -> bool:
        along_rod = i[1:] == j[1:] and {i[0], j[0]} == {"a", "b"}
        return not along_rod and not (i in anchors and j in anchors)

    candidates = [(i, j) for a, i in enumerate(names) for j in names[a + 1 :] if allowed(i, j)]
    candidates = [
        candidates[k] if rng.uniform() < 0.5 else candidates[k][::-1] for k in rng.permutation(len(candidates))
    ]
    chosen: list[tuple[str, str]] = []
    for name in anchors + masses:
        if not any(name in pair for pair in chosen):
            chosen += [pair for pair in candidates if name in pair][:1]  # a lone point mass has no partner
    wanted = 2 * rods + len(masses) if strings is None else strings
    rest = [pair for pair in candidates if pair not in chosen]
    return chosen + rest[: max(0, wanted - len(chosen))]


def _turned(vector: Array, axis: Array, angle: float) -> Array:
    """Rodrigues' rotation of a vector about a unit axis."""
    cross = np.cross(axis, vector)
    return vector * np.cos(angle) + cross * np.sin(angle) + axis * (axis @ vector) * (1 - np.cos(angle))
