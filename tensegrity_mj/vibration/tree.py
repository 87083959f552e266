"""How MuJoCo's implicit integrators treat dampers in a tree of rods: the linear model in the tree's own coordinates.

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

from tensegrity_mj.basics.arrays import Array
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
    """Whether the model is one of trees of rods, and small enough: no loops, no supports that are driven, no bodies."""
    if model.joints is None or not model.is_dense or model.scene.motions or model.scene.contact is not None:
        return False
    structure = model.scene.structure
    return not (structure.elastic.any() or structure.bodies or spanning_forest(structure).closures)


def tree_model(model: Vibration) -> TreeModel:
    """The matrices in the rates of the tree; see `has_tree_model`."""
    structure, bodies = model.scene.structure, model.bodies
    forest = spanning_forest(structure)
    R, B = len(structure.rods), len(bodies.mass)
    nodes = model.nodes
    # Rates in sequence: (body, its translation, and its axis and the point that it turns about).
    owner: list[int] = []
    slides: list[Array] = []
    turns: list[Array] = []
    for rod in range(R):
        support = structure.rods[rod].support
        if forest.parent[rod] < 0:
            for axis in support.translation_basis.T:
                owner.append(rod)
                slides.append(axis)
                turns.append(np.zeros(3))
        axes = np.eye(3) if support.plane is None else bodies.planes[rod : rod + 1]
        for axis in axes:
            owner.append(rod)
            slides.append(np.zeros(3))
            turns.append(axis)
    for point in range(R, B):
        for axis in structure.lone_masses[point - R].translation_basis.T:
            owner.append(point)
            slides.append(axis)
            turns.append(np.zeros(3))
    count = len(owner)
    above = np.zeros((B, B), bool)  # whether the second is the first, or hangs on it
    for rod in forest.order:
        above[:, rod] = above[:, forest.parent[rod]] if forest.parent[rod] >= 0 else False
        above[rod, rod] = True
    above[range(R, B), range(R, B)] = True

    pivot = np.zeros((B, 3))
    for rod, (i, j) in enumerate(structure.rod_nodes):
        sigma = bodies.sigma[rod]
        held = (1 - sigma) * nodes[i] + sigma * nodes[j]
        pivot[rod] = held if forest.parent[rod] < 0 else nodes[forest.hinge[rod]]
    motion = motion_of_bodies(bodies, nodes)
    Y = np.zeros((B, SLOTS, count))
    spin = np.zeros((R, count))
    for k in range(count):
        moved = above[owner[k]]
        for body in np.flatnonzero(moved).tolist():
            if body >= R:
                plain = np.concatenate([bodies.E[body].T @ slides[k], np.zeros(2)])
            else:
                i, j = structure.rod_nodes[body]
                ends = [slides[k] + np.cross(turns[k], nodes[row] - pivot[owner[k]]) for row in (i, j)]
                sigma = bodies.sigma[body]
                middle = (1 - sigma) * ends[0] + sigma * ends[1]
                plain = np.concatenate(
                    [bodies.E[body].T @ middle, motion.T[body].T @ (ends[1] - ends[0]) / bodies.length[body]]
                )
                if structure.rods[body].support.plane is None:
                    spin[body, k] = turns[k] @ motion.b[body]
            Y[body, :, k] = np.linalg.solve(motion.inverse[body], plain)
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
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if least(middle)[0] > 0 else (low, middle)
    y = tree.coordinates @ np.linalg.solve(root.T, least(high)[1])
    size = float(np.linalg.norm(y))
    return low, np.asarray(y / size) if size > 0 else y
