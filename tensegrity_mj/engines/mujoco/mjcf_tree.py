"""Tree of bodies of a scene's MuJoCo model, and its joint coordinates.

A rod that hangs on no other has its frame at the point of it that its support holds, and slides along the directions
that the support leaves, along those in which a motion drives the support, and turns. A rod that hangs on another has
its frame at the node where it hangs, in its parent's body, and only turns: a ball joint in space, a hinge in a plane.
Joints that the tree of bodies leaves open are for constraints.

Coordinates are in the order of the model: trees by their first rods, each rod before what hangs on it, then point
masses, then the moved nodes that belong to nothing, then bodies. Angular velocities are in a
body's own frame; that of a hanging rod is relative to its parent. No rod spins about its axis, which a relative
velocity must see to.
"""

from __future__ import annotations

import enum
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array, rotations_to, unit
from tensegrity_mj.basics.remembered import once
from tensegrity_mj.engines.table import make_engine
from tensegrity_mj.model.capabilities import refusal
from tensegrity_mj.model.forest import Forest, spanning_forest
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.moved_supports import held_directions
from tensegrity_mj.model.scene import Scene

# Two parallel frames whose places differ by less than 1e-6 m along each axis are one frame to MuJoCo's compiler: what
# stands 9e-7 m from its body's origin, or from its center of mass, then stands there. Frames that are not parallel stay
# apart, so what comes this near is turned, about an axis that does not matter to it. (The limit with some room.)
SNAP = 2e-6  # m
SAME = 1e-14  # of a size: what differs by less stands there, but for round-off
TURNED_SITE = "0.7071067811865476 0.7071067811865476 0 0"  # a site is a point: about x
TURNED_AXIS = "0.7071067811865476 0 0 0.7071067811865476"  # what is round about z: about z, and not as sites


def must_turn(place: ArrayLike, frames: Iterable[ArrayLike], size: float) -> bool:
    """Return whether MuJoCo would move a parallel frame at a place (3,) [m] onto one of these, which are elsewhere.

    Places are in the frame of the body; `size` [m] is that of the body, whose round-off is no distance.
    """
    gaps = [float(np.max(np.abs(np.asarray(place, float) - np.asarray(frame, float)))) for frame in frames]
    return any(SAME * size < gap < SNAP for gap in gaps)


def quaternion(rotation: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation matrix, from its largest component for accuracy."""
    r, products = rotation, np.empty((4, 4))
    x, y, z = np.diagonal(r)
    squares = np.array([1 + x + y + z, 1 + x - y - z, 1 - x + y - z, 1 - x - y + z])
    products[0, 1:] = products[1:, 0] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    products[1:, 1:] = r + r.T
    np.fill_diagonal(products, squares)
    largest = int(np.argmax(squares))
    q = products[largest] / (2 * math.sqrt(squares[largest]))
    return np.asarray(q / np.linalg.norm(q))


def numbers(values: Iterable[float]) -> str:
    """Values as MJCF has them, with all their digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0


def add(parent: ET.Element, tag: str, **attributes: Any) -> ET.Element:
    """Add an element with attributes: numbers and arrays become texts, and those that are None are left out."""
    given = {key: one for key, one in attributes.items() if one is not None}
    texts = {key: one if isinstance(one, str) else numbers(np.ravel(one)) for key, one in given.items()}
    return ET.SubElement(parent, tag, texts)


NOTHING = 1e-12  # of the largest displacement: one below it is no direction of its own


class Turn(enum.Enum):
    """Joints by which a rod turns in its parent."""

    FREE = "free"  # one joint for all six coordinates
    BALL = "ball"
    HINGE = "hinge"
    NONE = "none"  # of an elastic rod, whose second end slides relative to the first


@dataclass(frozen=True, eq=False)
class RodJoint:
    """Joint of a rod's body to its parent.

    Attributes:
        parent: row of the rod that it hangs on, or -1 for the world.
        sigma: where along the rod its frame is.
        slides: (3, n) directions in which that point moves freely, in the world.
        moved: (3, m) directions along which a motion drives it, in the world.
        turn: see `Turn`.
        stretches: (3, p) directions in which the other end of an elastic rod slides relative to that point, its first.
    """

    parent: int
    sigma: float
    slides: Array
    moved: Array
    turn: Turn
    stretches: Array = field(default_factory=lambda: np.zeros((3, 0)))

    @property
    def axes(self) -> Array:
        """Directions (3, n + m) of all slide joints, the driven ones last."""
        return np.hstack([self.slides, self.moved])


@dataclass(frozen=True, eq=False)
class BodyTree:
    """The bodies of a scene's model.

    Attributes:
        forest: how the rods hang together.
        order: rod rows in the order of their bodies.
        joints: of each rod, in the order of the structure.
        moved_nodes: (node row, directions (3, m)) of each fixed node that moves.
        built: (R, 3, 3) the rods' frames where the model is built, z along the rod.
        normals: (R, 3) unit normals of the planes that rods turn in; zero in space.
    """

    forest: Forest
    order: tuple[int, ...]
    joints: tuple[RodJoint, ...]
    moved_nodes: tuple[tuple[int, Array], ...]
    built: Array
    normals: Array

    @property
    def depth(self) -> int:
        """Largest number of bodies that hang on each other."""
        depths = np.zeros(len(self.order), int)
        for rod in self.order:
            parent = self.joints[rod].parent
            depths[rod] = 1 if parent < 0 else depths[parent] + 1
        return int(depths.max(initial=0))


LONG = 50  # rods in a row, from which a step of the DAE costs less than a tenth of MuJoCo's
# MuJoCo's step costs 8, 13, 63, 153, 365 DAE steps for n = 37, 50, 121, 192, 300; (n / EQUAL)² = 6, 11, 65, 164, 400.
EQUAL = 15.0


def cheaper(scene: Scene, tree: BodyTree) -> str:
    """Return a remark on a chain in space so long that its step is far cheaper in the DAE, or "".

    MuJoCo factors the inertia of a chain, which has no zeros, at every stage. No option of it is faster: sparse or
    dense Jacobian, CG or Newton, islands or none, no constraints at all (evidence/docs/speed.md).
    """
    row = tree.depth
    if row < LONG or tree.normals.any() or refusal(make_engine("dae", {}), scene) is not None:
        return ""
    part = (row / EQUAL) ** 2
    return (
        f"{row} rods hang on each other in a row, and MuJoCo factors their inertia, which has no zeros, at every "
        f"stage: a step of the DAE (--engine dae, tmj.DAE()) costs about 1/{part:.0f} of it"
    )


@once
def body_tree(scene: Scene) -> BodyTree:
    """The bodies of a scene's model."""
    structure = scene.structure
    forest = spanning_forest(structure)
    motions = {motion.support: motion for motion in scene.motions}
    joints = []
    for number, rod in enumerate(structure.rods):
        parent = int(forest.parent[number])
        flat = rod.support.plane is not None
        if parent >= 0:
            sigma = 1.0 if forest.flipped[number] else 0.0
            none = np.zeros((3, 0))
            joints.append(RodJoint(parent, sigma, none, none, Turn.HINGE if flat else Turn.BALL))
            continue
        slides, motion = rod.support.translation_basis, motions.get(rod.name)
        moved = np.zeros((3, 0)) if motion is None else moved_directions(motion, held_directions(rod))
        if rod.stiffness is not None:
            first = rod.support.sigma if rod.support.directions else 0.0
            joints.append(RodJoint(-1, first, slides, moved, Turn.NONE, rod.support.rotation_basis))
            continue
        turn = Turn.HINGE if flat else Turn.FREE if slides.shape[1] == 3 else Turn.BALL
        joints.append(RodJoint(-1, rod.support.sigma, slides, moved, turn))
    children: list[list[int]] = [[] for _ in structure.rods]
    for number in forest.order:
        if forest.parent[number] >= 0:
            children[forest.parent[number]].append(int(number))
    order: list[int] = []
    for root in sorted(int(row) for row in forest.roots):
        stack = [root]
        while stack:
            order.append(stack.pop())
            stack.extend(reversed(children[order[-1]]))
    fixed = [(structure.node_index[name], motions[name]) for name in structure.fixed_nodes if name in motions]
    moved_nodes = tuple((row, moved_directions(motion, np.eye(3))) for row, motion in fixed)
    built = _frames(scene, scene.nodes0)
    planes = [rod.support.plane for rod in structure.rods]
    normals = np.array([np.zeros(3) if plane is None else unit(np.array(plane)) for plane in planes]).reshape(-1, 3)
    return BodyTree(forest, tuple(order), tuple(joints), moved_nodes, built, normals)


def moved_directions(motion: Motion, held: Array) -> Array:
    """Orthonormal directions (3, m) that a motion makes use of, among those (k, 3) that the support holds.

    Of a function nothing is known but that: it may use them all.
    """
    if motion.function is not None:
        return np.array(held).T
    parts = [item.amplitude for item in motion.harmonics]
    parts += [row for rows in (motion.displacements, motion.velocities, motion.accelerations) for row in rows]
    rows = np.array(parts, float) @ held.T @ held
    largest = float(np.abs(rows).max(initial=0.0))
    found: list[Array] = []
    for row in rows:
        for axis in found:
            row = row - axis * (axis @ row)
        size = float(np.linalg.norm(row))
        if size > NOTHING * largest and len(found) < len(held):
            row = row / size
            for axis in found:  # once more: what was left may be little of what there was
                row = row - axis * (axis @ row)
            found.append(row / np.linalg.norm(row))
    return np.array(found).reshape(-1, 3).T


def initial_velocities(scene: Scene) -> Array:
    """MuJoCo's qvel (nv,) of the scene's start, in the order of its joints."""
    return joint_coordinates(scene, body_tree(scene), scene.nodes0, scene.velocities0)[1]


def joint_coordinates(scene: Scene, tree: BodyTree, nodes: Array, velocities: Array) -> tuple[Array, Array]:
    """MuJoCo's qpos (nq,) and qvel (nv,) of node positions and velocities (N, 3); the model is that of `scene`."""
    structure, start = scene.structure, scene.nodes0
    places: list[Array] = []
    rates: list[Array] = []
    pairs, lengths = structure.rod_nodes, structure.rod_lengths
    now, built = _frames(scene, nodes), tree.built
    # ω = b × ḃ: no spin about the axis.
    spins = np.cross(now[:, :, 2], (velocities[pairs[:, 1]] - velocities[pairs[:, 0]]) / lengths[:, None])
    # By how much each direction has turned about its normal, within (-π, π].
    before, after = built[:, :, 2], now[:, :, 2]
    angles = np.arctan2(np.sum(tree.normals * np.cross(before, after), axis=1), np.sum(before * after, axis=1))
    for number in tree.order:
        joint = tree.joints[number]
        parent, rotation, spin = joint.parent, now[number], spins[number]
        if parent < 0:
            (i, j), sigma, axes = pairs[number], joint.sigma, joint.axes
            r = (1 - sigma) * nodes[i] + sigma * nodes[j]
            r_rate = (1 - sigma) * velocities[i] + sigma * velocities[j]
            if joint.turn is Turn.FREE:
                places += [r, quaternion(rotation)]
                rates += [r_rate, rotation.T @ spin]
                continue
            # Slides and turns count from where the model was built.
            places.append(axes.T @ (r - ((1 - sigma) * start[i] + sigma * start[j])))
            rates.append(axes.T @ r_rate)
            if joint.turn is Turn.NONE:
                near, far = (j, i) if sigma else (i, j)
                places.append(joint.stretches.T @ (nodes[far] - nodes[near] - (start[far] - start[near])))
                rates.append(joint.stretches.T @ (velocities[far] - velocities[near]))
                continue
        else:
            spin = spin - spins[parent]
        if joint.turn is Turn.BALL:
            before, after = built[number], rotation
            if parent >= 0:
                before, after = built[parent].T @ before, now[parent].T @ after
            places.append(quaternion(before.T @ after))
            rates.append(rotation.T @ spin)
        else:
            normal, angle = tree.normals[number], angles[number]
            if parent >= 0:  # whose normal may be the opposite one
                angle = angle - np.sign(normal @ tree.normals[parent]) * angles[parent]
            places.append(np.array([angle]))
            rates.append(np.array([spin @ normal]))
    for point in structure.lone_masses:
        row, E = structure.node_index[point.node], point.translation_basis
        places.append(E.T @ (nodes[row] - start[row]))
        rates.append(E.T @ velocities[row])
    for row, axes in tree.moved_nodes:
        places.append(axes.T @ (nodes[row] - start[row]))
        rates.append(axes.T @ velocities[row])
    for body, frame in zip(structure.bodies, structure.frames, strict=True):
        if not body.held:
            (r, rotation), (r_rate, spin) = frame.placed(nodes), frame.moving(nodes, velocities)
            places += [r, quaternion(rotation)]
            rates += [r_rate, rotation.T @ spin]
    none = [np.zeros(0)]
    return np.concatenate(places or none), np.concatenate(rates or none)


def _frames(scene: Scene, nodes: Array) -> Array:
    """Frames (R, 3, 3) of the rods between nodes (N, 3), z along the rod, without a turn about it."""
    pairs = scene.structure.rod_nodes
    along = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
    return rotations_to(along / np.linalg.norm(along, axis=1)[:, None])


def distinct(names: Iterable[str], taken: set[str]) -> list[str]:
    """The names, those that are taken already with the first free number behind."""
    taken, result = set(taken), []
    for name in names:
        candidate, number = name, 2
        while candidate in taken:
            candidate, number = f"{name} ({number})", number + 1
        taken.add(candidate)
        result.append(candidate)
    return result


def place(data: mujoco.MjData, scene: Scene, nodes: Array, velocities: Array, tree: BodyTree | None = None) -> None:
    """Set joint coordinates and velocities from node positions and velocities; no rod spins about its axis.

    `scene` is the one that the model was made from; `tree` is its `body_tree`, where that is known.
    """
    tree = body_tree(scene) if tree is None else tree
    data.qpos[:], data.qvel[:] = joint_coordinates(scene, tree, nodes, velocities)


class Names:
    """Names of bodies, joints and sites, unique among their kind: lists of rods, point masses, moved nodes, bodies."""

    def __init__(self, scene: Scene, tree: BodyTree) -> None:
        structure = scene.structure
        rods, points = structure.rods, structure.lone_masses
        moved = [structure.node_names[row] for row, _ in tree.moved_nodes]
        members = [rod.name for rod in rods] + [point.node for point in points] + moved
        own = [body.name for body in structure.bodies]
        bodies = distinct([*members, *own], taken={"world"})
        # The second body of an elastic rod.
        self.bars = distinct([f"{rod.name} end" for rod in rods], taken={"world", *bodies})
        cuts = (len(rods), len(rods) + len(points))
        self.rods, self.points, self.moved = _cut(bodies[: len(members)], cuts)
        self.bodies = bodies[len(members) :]
        # A rod's own name goes to the joint that turns it, not to a slide of another rod.
        self.turns = [rod.name for rod in rods]
        counts = [0 if j.turn is Turn.FREE else j.axes.shape[1] + j.stretches.shape[1] for j in tree.joints]
        counts += [point.translation_basis.shape[1] for point in points]
        counts += [axes.shape[1] for _, axes in tree.moved_nodes]
        wanted = [f"{name} {k + 1}" for name, count in zip(members, counts, strict=True) for k in range(count)]
        given = iter(distinct([*wanted, *own], taken=set(self.turns)))
        slides = [[next(given) for _ in range(count)] for count in counts]
        self.rod_slides, self.point_slides, self.moved_slides = _cut(slides, cuts)
        self.free_joints = list(given)  # of the bodies
        # Where a rod ends at a node whose site another rod's body carries, and no joint of bodies holds it there.
        ends = [f"{structure.node_names[node]} of {rods[other].name}" for node, _, other in tree.forest.closures]
        self.ends = distinct(ends, taken=set(structure.node_names))


def _cut(values: list[Any], cuts: tuple[int, int]) -> tuple[list[Any], list[Any], list[Any]]:
    return values[: cuts[0]], values[cuts[0] : cuts[1]], values[cuts[1] :]
