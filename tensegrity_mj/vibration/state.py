"""A state as small motions see it: its strings, how its bodies move, the joints, and what else resists there."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.rigidity import Members, members_at
from tensegrity_mj.model.rods import Bars
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.vibration.blocks import Assembly, Blocks, is_dense
from tensegrity_mj.vibration.bodies import Bodies, Motion, motion_of_bodies
from tensegrity_mj.vibration.joints import Joints
from tensegrity_mj.vibration.resistance import bending_blocks, element_blocks, nodal_blocks, viscous_blocks


class State:
    """What the matrices of a state and their bounds have in common.

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
        """How nodes move with the coordinates."""
        return motion_of_bodies(self.bodies, self.nodes)

    @cached_property
    def joints(self) -> Joints | None:
        """What they and linear constraints forbid; None where there are none."""
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
        """What makes matrices of sums over segments and bodies."""
        return Assembly(self.scene.structure, self.bodies, self.motion.turned, self.joints)

    def bars(self) -> tuple[Blocks, Blocks]:
        """Stiffness and dampers of elastic rods along themselves."""
        bars = Bars.of(self.scene.structure)
        along = bars.lengths[:, None] * self.motion.inverse[bars.rows, -1]
        values = along[:, :, None] * along[:, None, :]
        weights = (bars.stiffness, bars.damping)
        first, second = (Blocks(weight[:, None, None] * values, bars.rows, bars.rows) for weight in weights)
        return first, second

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
