"""State of a scene for its small motions: strings, motions of bodies, joints, and other resistance.

Joints in bending have stiffness and dampers, and fluids are viscous. With δe = G y the change of e = d_a - d_b of a
joint, bending adds κ Gᵀ G to K and γ Gᵀ G to D, and pulls on b of its rods, whose turns these pulls stiffen or soften
as any other. A viscous fluid adds c ∫ Xᵀ X ds along each rod to D. The derivative of drag is left out: it grows with
the speed of the fluid past a rod, and is zero at rest.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.model.elements.element import slopes_of
from tensegrity_mj.model.elements.resistance import bending_joints, nodal_damping
from tensegrity_mj.model.rigidity import Members, members_at
from tensegrity_mj.model.rods import Bars
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.vibration.blocks import Assembly, Blocks, Joints, is_dense
from tensegrity_mj.vibration.bodies import Bodies, Motion, motion_of_bodies


def bending_pulls(scene: Scene, b: Array) -> Array:
    """(R, 3) [N m] the generalized forces of bent joints on the directions b (R, 3) of the rods."""
    pulls = np.zeros_like(b)
    if scene.resistance is None or scene.resistance.bending is None:
        return pulls
    rods, signs = _ends_of_joints(scene)
    e = signs[:, :1] * b[rods[:, 0]] - signs[:, 1:] * b[rods[:, 1]]
    pull = scene.resistance.bending.stiffness * e
    np.subtract.at(pulls, rods[:, 0], signs[:, :1] * pull)
    np.add.at(pulls, rods[:, 1], signs[:, 1:] * pull)
    return pulls


def bending_blocks(scene: Scene, turns: Array) -> list[Blocks]:
    """κ Gᵀ G and γ Gᵀ G of all joints that resist bending, for δb = `turns` (R, 3, slots) y; none where none does."""
    bending = None if scene.resistance is None else scene.resistance.bending
    if bending is None:
        return []
    rods, signs = _ends_of_joints(scene)
    if not len(rods):
        return []
    parts = (signs[:, 0, None, None] * turns[rods[:, 0]], -signs[:, 1, None, None] * turns[rods[:, 1]])
    values, rows, columns = [], [], []
    for p in range(2):
        for q in range(2):
            values.append(np.swapaxes(parts[p], 1, 2) @ parts[q])
            rows.append(rods[:, p])
            columns.append(rods[:, q])
    bent = Blocks(np.concatenate(values), np.concatenate(rows), np.concatenate(columns))
    return [bent.times(bending.stiffness), bent.times(bending.damping)]


def viscous_blocks(scene: Scene, ends: Any) -> list[Blocks]:
    """c ∫ Xᵀ X ds of all rods, for δx = `ends` (2, R, 3, slots) y of their ends; none where nothing is viscous."""
    if scene.resistance is None or not scene.resistance.viscous:
        return []
    first, second = ends
    weight = scene.resistance.viscous * scene.structure.rod_lengths[:, None, None] / 6
    back, ahead = (np.swapaxes(part, 1, 2) for part in ends)
    values = weight * (2 * back @ first + back @ second + ahead @ first + 2 * ahead @ second)
    rows = np.arange(len(values))
    return [Blocks(values, rows, rows)]


def nodal_blocks(scene: Scene, body: IntArray, turned: Array) -> list[Blocks]:
    """c Xᵀ X of the point masses with a damping, for δx = `turned` (N, 3, slots) y of nodes; none where none has it."""
    nodes, factors = nodal_damping(scene.structure)
    moved = turned[nodes]
    blocks = Blocks(factors[:, None, None] * np.swapaxes(moved, 1, 2) @ moved, body[nodes], body[nodes])
    return [blocks] if len(nodes) else []


def element_blocks(
    scene: Scene, time: float, nodes: Array, velocities: Array, body: IntArray, turned: Array
) -> tuple[Blocks, Blocks]:
    """Compute stiffness (its symmetric part) and damping of the scene's `elements`, by differences of their forces.

    Args:
        scene: which.
        time: [s].
        nodes, velocities: (N, 3) the state.
        body: (N,) the body that carries each node.
        turned: (N, 3, slots): δx of each node by its body's slots.
    """
    found = []
    for symmetric, values in zip((True, False), slopes_of(scene.elements, scene, time, nodes, velocities), strict=True):
        matrix = 0.5 * (values + values.T) if symmetric else values
        blocks = matrix.reshape(len(nodes), 3, len(nodes), 3).transpose(0, 2, 1, 3)
        rows, columns = np.nonzero(np.any(blocks != 0, axis=(2, 3)))
        each = np.swapaxes(turned[rows], 1, 2) @ blocks[rows, columns] @ turned[columns]
        found.append(Blocks(each, body[rows], body[columns]))
    return found[0], found[1]


def _ends_of_joints(scene: Scene) -> tuple[IntArray, Array]:
    """Rods (J, 2) of the joints that resist bending, and signs (J, 2): d = sign · b points into a joint, then out."""
    structure = scene.structure
    assert scene.resistance is not None
    joints = bending_joints(structure, scene.resistance.bending)
    rods = np.array([joint.rods for joint in joints], np.int64).reshape(-1, 2)
    node = np.array([joint.nodes[1] for joint in joints], np.int64)
    into = np.where(structure.rod_nodes[rods[:, 0], 1] == node, 1.0, -1.0)
    out = np.where(structure.rod_nodes[rods[:, 1], 0] == node, 1.0, -1.0)
    return rods, np.stack([into, out], axis=1)


class State:
    """State of a scene, with what both its matrices and their bounds need.

    Args:
        scene: structure, gravity and loads.
        bodies: of the structure.
        nodes, velocities: (N, 3) [m], [m/s].
        time: [s] of the loads.
    """

    def __init__(self, scene: Scene, bodies: Bodies, nodes: Array, velocities: Array, time: float) -> None:
        self.scene, self.bodies, self.time = scene, bodies, time
        self.nodes, self.velocities = nodes, velocities

    @cached_property
    def segments(self) -> Members:
        """Lengths (S,) and unit vectors (S, 3) of the strings' segments."""
        return members_at(self.scene.structure.paths.nodes, self.nodes)

    @cached_property
    def lengths(self) -> Array:
        """(M,) [m] of the strings."""
        return np.asarray(self.scene.structure.paths.total(self.segments.lengths))

    @cached_property
    def rates(self) -> Array:
        """(M,) [m/s] of the strings' lengths."""
        paths = self.scene.structure.paths
        return np.asarray(paths.total(np.sum(self.segments.directions * paths.spans(self.velocities), axis=1)))

    @cached_property
    def motion(self) -> Motion:
        """Derivatives of the node positions by the coordinates."""
        return motion_of_bodies(self.bodies, self.nodes)

    @cached_property
    def joints(self) -> Joints | None:
        """Motions that joints and linear constraints forbid; None where there are neither."""
        bodies, motion = self.bodies, self.motion
        held = self.scene.structure.constraint_rows.reshape(-1, len(bodies.body), 3)
        if not len(bodies.joints) and not len(held):
            return None
        pairs = bodies.joints[:, 1:]
        maps = []
        for side, rods in enumerate(pairs.T):
            lever = bodies.ends[rods, bodies.joint_ends[:, side]]
            plain = np.concatenate([bodies.E[rods], lever[:, None, None] * motion.T[rods]], axis=2)
            maps.append(plain @ motion.inverse[rods])
        B = len(bodies.mass)
        linear = np.zeros((len(held), B + 1, bodies.slots))
        for node, body in enumerate(bodies.body):
            linear[:, body] += held[:, node] @ motion.turned[node]
        return Joints(pairs, np.array(maps), B, is_dense(B), linear[:, :B].reshape(len(held), bodies.slots * B))

    @cached_property
    def assembly(self) -> Assembly:
        """Assembly that turns sums over segments and bodies into matrices."""
        return Assembly(self.scene.structure, self.bodies, self.motion.turned, self.joints)

    def bars(self) -> tuple[Blocks, Blocks]:
        """Stiffness and dampers of elastic rods along themselves."""
        bars = Bars.of(self.scene.structure)
        along = bars.lengths[:, None] * self.motion.inverse[bars.rows, -1]
        values = along[:, :, None] * along[:, None, :]
        weights = (bars.stiffness, bars.damping)
        first, second = (Blocks(weight[:, None, None] * values, bars.rows, bars.rows) for weight in weights)
        return first, second

    @cached_property
    def resisting(self) -> tuple[list[Blocks], list[Blocks]]:
        """Stiffness and dampers of what is no string: joints in bending, a viscous fluid, the scene's elements."""
        scene, bodies, motion = self.scene, self.bodies, self.motion
        stiff: list[Blocks] = []
        lossy: list[Blocks] = []
        if scene.resistance is not None:
            R = len(bodies.length)
            turns = motion.T[:R] @ motion.inverse[:R, 3:]
            slides = bodies.E[:R] @ motion.inverse[:R, :3]
            ends = np.array([slides + bodies.ends[:, end, None, None] * turns for end in range(2)])
            bent = bending_blocks(scene, turns)
            stiff, lossy = bent[:1], bent[1:] + viscous_blocks(scene, ends)
        lossy += nodal_blocks(scene, bodies.body, motion.turned)
        if scene.elements:
            own = element_blocks(scene, self.time, self.nodes, self.velocities, bodies.body, motion.turned)
            stiff.append(own[0])
            lossy.append(own[1])
        return stiff, lossy
