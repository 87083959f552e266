"""Stability of MuJoCo's implicit integrators with dampers in a tree of rods, in the tree's own coordinates.

MuJoCo moves rods that share nodes as bodies that hang on each other. Its derivative of the forces by the velocities
has an entry for two bodies only where one hangs on the other, however far down: what a damper does between two branches
is left out. With w the rates of the tree (of each body its translations, and its rotation relative to the body that it
hangs on), M, K, D the matrices of mass, stiffness and damping in these, and B the entries of the strings' part of D
that are known,

    (M + h B)(w' - w) = -h (K θ + D w),      θ' = θ + h w'

An eigenvalue z of this step leaves the unit circle through -1, where

    G(h) = M + h (B - D/2) - h² K / 4

is singular. While G is positive definite, so is M + h B (K and D are not negative), and for every eigenvector
|z|² = 1 - h x*Dx / x*(M + h B)x <= 1. G's least eigenvalue is concave in h and above zero at h = 0: it has one root,
which is the limit. B - D/2 is not definite: a damper between two branches may *lower* the limit.

The spin of a thin rod about its own axis, which no node of its own has, carries what hangs on it. It counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from tensegrity_mj.basics.arrays import Array, bisect
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.rods import centers_and_moments, own_masses
from tensegrity_mj.vibration.bodies import SLOTS, motion_of_bodies
from tensegrity_mj.vibration.small_motions import Vibration

AXIAL_INERTIA = 1e-2  # of a rod in a tree, as a part of the transverse one: that of the MJCF (tested to agree)
HALVINGS = 60


@dataclass(frozen=True, eq=False)
class TreeModel:
    """The matrices of a state in the rates w of the tree (nv,).

    Attributes:
        mass, stiffness, damper, known: (nv, nv) M, K, D and B above.
        coordinates: (n, nv) from w to the coordinates y of `small_motions`.
    """

    mass: Array = field(repr=False)
    stiffness: Array = field(repr=False)
    damper: Array = field(repr=False)
    known: Array = field(repr=False)
    coordinates: Array = field(repr=False)


def has_tree_model(model: Vibration) -> bool:
    """Return whether a model consists of trees of rods, and is small: no loops, no driven supports, no bodies."""
    if model.state.joints is None or not model.is_dense or model.scene.motions or model.scene.contact is not None:
        return False
    structure = model.scene.structure
    return not (structure.elastic.any() or structure.bodies or spanning_forest(structure).closures)


def tree_model(model: Vibration) -> TreeModel:
    """The matrices in the rates of the tree; see `has_tree_model`."""
    structure, bodies = model.scene.structure, model.state.bodies
    forest = spanning_forest(structure)
    R, B = len(structure.rods), len(bodies.mass)
    nodes = model.state.nodes
    # Rates in sequence: a body, its translation, and its axis of rotation.
    rates: list[tuple[int, Array, Array]] = []
    none = np.zeros(3)
    for number, rod in enumerate(structure.rods):
        if forest.parent[number] < 0:
            rates += [(number, axis, none) for axis in rod.support.translation_basis.T]
        axes = np.eye(3) if rod.support.plane is None else bodies.planes[number : number + 1]
        rates += [(number, none, axis) for axis in axes]
    for number, point in enumerate(structure.lone_masses, R):
        rates += [(number, axis, none) for axis in point.translation_basis.T]
    owner, count = [body for body, _, _ in rates], len(rates)
    above = np.eye(B, dtype=bool)  # whether the second is the first, or hangs on it
    for child in forest.order:
        if forest.parent[child] >= 0:
            above[:, child] |= above[:, forest.parent[child]]

    first, second = (nodes[rows] for rows in structure.rod_nodes.T)
    sigma, pivot = bodies.sigma[:, None], np.zeros((B, 3))
    hinges = nodes[np.maximum(forest.hinge, 0)]
    pivot[:R] = np.where(np.array(forest.parent)[:, None] < 0, (1 - sigma) * first + sigma * second, hinges)
    motion = motion_of_bodies(bodies, nodes)
    spatial = ~np.any(bodies.planes != 0, axis=1)
    Y = np.zeros((B, SLOTS, count))
    spin = np.zeros((R, count))
    for k, (body, slide, turn) in enumerate(rates):
        tail, head = (slide + np.cross(turn, end - pivot[body]) for end in (first, second))
        moved = np.tile(slide, (B, 1))
        moved[:R] = (1 - sigma) * tail + sigma * head
        plain = np.zeros((B, SLOTS))
        plain[:, :3] = np.einsum("bxz,bx->bz", bodies.E, moved)
        plain[:R, 3:] = np.einsum("rxt,rx->rt", motion.T[:R], head - tail) / bodies.length[:, None]
        found = np.linalg.solve(motion.inverse, plain[:, :, None])[:, :, 0]
        Y[:, :, k] = np.where(above[body][:, None], found, 0.0)
        spin[:, k] = np.where(above[body, :R] & spatial, motion.b @ turn, 0.0)
    flat = Y.reshape(B * SLOTS, count)
    own, lumps = AXIAL_INERTIA * own_masses(structure), AXIAL_INERTIA * structure.rod_lumps
    _, axial = centers_and_moments(own, structure.rod_lengths, lumps)
    strings = flat.T @ model.string_damper @ flat
    together = above[np.ix_(owner, owner)] | above[np.ix_(owner, owner)].T
    return TreeModel(
        mass=flat.T @ flat + spin.T @ (axial[:, None] * spin),
        stiffness=flat.T @ (model.material + model.geometric) @ flat,
        damper=flat.T @ model.damper @ flat,
        known=np.where(together, strings, 0.0),
        coordinates=flat,
    )


def tree_limit(tree: TreeModel) -> tuple[float, Array]:
    """The largest stable step [s], ∞ for none, and the coordinates y (n,) of the motion that grows beyond it."""
    if not len(tree.mass):
        return math.inf, np.zeros(len(tree.coordinates))
    root = np.linalg.cholesky(tree.mass)

    def scaled(matrix: Array) -> Array:
        half = np.linalg.solve(root, matrix)
        both = np.linalg.solve(root, half.T)
        return np.asarray(0.5 * (both + both.T))

    K, E = scaled(tree.stiffness), scaled(tree.known - 0.5 * tree.damper)
    one = np.eye(len(K))

    def least(h: float) -> tuple[float, Array]:
        values, vectors = np.linalg.eigh(one + h * E - 0.25 * h * h * K)
        return float(values[0]), vectors[:, 0]

    stiffest = float(np.linalg.eigvalsh(K)[-1])
    slowest = float(np.linalg.eigvalsh(E)[0])
    rate = math.sqrt(max(stiffest, 0.0)) + max(0.0, -slowest)
    if not rate > 0:
        return math.inf, np.zeros(len(tree.coordinates))
    # Below, G is definite for sure; a step beyond which it is none is found by doubling.
    low, high = 0.0, 1 / rate
    for _ in range(HALVINGS):
        if least(high)[0] <= 0:
            break
        low, high = high, 2 * high
    else:
        return math.inf, np.zeros(len(tree.coordinates))
    low, high = bisect(lambda step: least(step)[0] > 0, low, high)
    y = tree.coordinates @ np.linalg.solve(root.T, least(high)[1])
    size = float(np.linalg.norm(y))
    return low, np.asarray(y / size) if size > 0 else y
