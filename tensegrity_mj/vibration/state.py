"""State of a scene for its small motions: strings, motions of bodies, joints, other resistance, and forces on rods.

Joints in bending have stiffness and dampers, and fluids are viscous. With δe = G y the change of e = d_a - d_b of a
joint, bending adds κ Gᵀ G to K and γ Gᵀ G to D, and pulls on b of its rods, whose turns these pulls stiffen or soften
as any other. A viscous fluid adds c ∫ Xᵀ X ds along each rod to D. The derivative of drag is left out: it grows with
the speed of the fluid past a rod, and is zero at rest.

The forces of the state are stiffness, too: Σ (t_b - f r̈)·b on the turns of each rod, with t_b the generalized force on
b (2.55), which a rod's compression makes negative. Where rods share nodes the forces of the joints are part of t_b, and
velocities count: see `small_motions`.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray, dot, norm
from tensegrity_mj.model.constraints import constraint_values
from tensegrity_mj.model.elements.element import forces_of, slopes_of
from tensegrity_mj.model.elements.resistance import BendingDamping, BendingStiffness, bending_joints, nodal_damping
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.rigidity import Members, members_at
from tensegrity_mj.model.rods import Bars, directions
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.vibration.blocks import Assembly, Blocks, Joints, is_dense
from tensegrity_mj.vibration.bodies import Bodies, Motion, motion_of_bodies

EPS = float(np.finfo(float).eps)
ROUND_OFF = 64 * EPS  # of magnitudes that are added: each passes through some dozens of operations


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
    values = np.concatenate([np.swapaxes(one, 1, 2) @ other for one in parts for other in parts])
    bent = Blocks(values, rods[:, [0, 0, 1, 1]].T.ravel(), rods[:, [0, 1, 0, 1]].T.ravel())
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


def geometric_of_rods(state: State, pulls: Array) -> tuple[Array, Array]:
    """(B, slots, slots) [1/s²] of every body, and ÿ (n,) [√kg m/s²]; pulls (S, 3) [N] of segments on their first nodes.

    Each rod's (t_b - f r̈)·b on its turns, and Σ (F·ξ) 1 - (F ξᵀ + ξ Fᵀ)/2 on those of every other body, of forces F on
    its nodes at ξ from its centre of mass.
    """
    bodies, motion, joints, structure = state.bodies, state.motion, state.joints, state.scene.structure
    R, B = len(bodies.length), len(bodies.mass)
    forces, sizes = forces_on_nodes(state, pulls)
    driven = _driven(state)
    weight = np.array(state.scene.gravity) - driven  # (B, 3) felt by what moves with its support

    # Forces on the ends of each rod: those on a node go to the first body there.
    pairs = structure.rod_nodes
    own = (bodies.body[pairs] == np.arange(R)[:, None])[:, :, None]
    at_ends = np.where(own, forces[pairs], 0.0)
    b_rate = _turning_rates(state)
    turning = dot(b_rate, b_rate)

    pushed = np.zeros((B + 1, bodies.slots))
    np.add.at(pushed, bodies.body, np.einsum("nxs,nx->ns", motion.turned, forces))
    slides = np.einsum("bx,bxz->bz", bodies.mass[:, None] * weight, bodies.E)
    slides[:R] += (bodies.f[:R] * turning)[:, None] * np.einsum("rx,rxz->rz", motion.b, bodies.E[:R])
    turns = bodies.f[:, None] * np.einsum("bx,bxt->bt", weight, motion.T)
    bends = bending_pulls(state.scene, motion.b)
    turns[:R] += np.einsum("rx,rxt->rt", bends, motion.T[:R])
    acceleration = pushed[:B] + np.einsum("bij,bi->bj", motion.inverse, np.concatenate([slides, turns], axis=1))
    if joints is not None:
        carried, row_forces = joints.forces(acceleration.ravel(), _joint_bias(state, driven, turning))
        held = (row_forces @ structure.constraint_rows).reshape(-1, 3)
        at_ends += np.where(own, held[pairs], 0.0)
        acceleration += (row_forces @ joints.linear).reshape(B, -1)
        for side, sign in ((0, 1.0), (1, -1.0)):
            rods, ends = joints.pairs[:, side], bodies.joint_ends[:, side]
            np.add.at(at_ends, (rods, ends), sign * carried)
            np.add.at(acceleration, rods, np.einsum("jxs,jx->js", joints.maps[side], sign * carried))
    free = np.einsum("bij,bj->bi", motion.inverse, acceleration)
    r_acceleration = np.einsum("rxi,ri->rx", bodies.E[:R], free[:R, :3])
    t_b = np.sum(bodies.ends[:, :, None] * at_ends, axis=1) + bodies.f[:R, None] * weight[:R] + bends
    along = dot(motion.b, t_b - bodies.f[:R, None] * r_acceleration)
    # Forces that cancel leave round-off, which is no stiffness.
    noise = bodies.length * forces_round_off(state, sizes)[:R] + ROUND_OFF * norm(bends)
    along = np.where(np.abs(along) > noise, along, 0.0)
    if structure.elastic.any():
        bars = Bars.of(structure)
        _, lengths, pulled = bars.stretched(state.nodes, state.velocities)
        along[bars.rows] = pulled / lengths * bars.lengths**2  # what holds an elastic rod's length is its own force
    blocks = _on_turns(state, along + bodies.J[:R] * turning, b_rate)
    for number, frame in bodies.frames:
        away = state.nodes[frame.rows] - frame.placed(state.nodes)[0]
        moment = away.T @ forces[frame.rows]
        levers = motion.inverse[number, 3:]
        blocks[number] = levers.T @ (np.trace(moment) * np.eye(3) - 0.5 * (moment + moment.T)) @ levers
    return blocks, acceleration.ravel()


def forces_on_nodes(state: State, pulls: Array) -> tuple[Array, Array]:
    """(N, 3) [N] of loads, fluids, elements and strings, and the sums (N,) [N] of their magnitudes.

    Of bent joints and of water there is more than forces.
    """
    scene = state.scene
    acting = [one for one in scene.effects if not isinstance(one, (BendingStiffness, BendingDamping, Water))]
    each = [forces_of([one], scene, state.time, state.nodes, state.velocities) for one in acting]
    forces = sum(each, np.zeros_like(state.nodes))
    sizes = sum((norm(one) for one in each), np.zeros(len(state.nodes)))
    i, j = scene.structure.paths.nodes.T
    np.add.at(forces, i, pulls)
    np.subtract.at(forces, j, pulls)
    np.add.at(sizes, np.concatenate([i, j]), np.tile(norm(pulls), 2))
    return forces, sizes


def forces_round_off(state: State, sizes: Array) -> Array:
    """(B,) [N] what round-off leaves of forces on each body that cancel, of `sizes` by `forces_on_nodes`.

    A joint's force is a sum of what acts on all bodies, three components each.
    """
    bodies = state.bodies
    B = len(bodies.mass)
    own = np.bincount(bodies.body, sizes, minlength=B + 1)[:B] + bodies.mass * norm(
        np.array(state.scene.gravity) - _driven(state)
    )
    return np.asarray(ROUND_OFF * own + (0.0 if state.joints is None else 3 * B * EPS * own.sum()))


def _turning_rates(state: State) -> Array:
    """(R, 3) [1/s] ḃ where rods share nodes; without joints velocities are left out."""
    if state.joints is None:
        return np.zeros((len(state.bodies.length), 3))
    rate = directions(state.scene.structure, state.velocities)
    rate = np.where(state.scene.structure.elastic[:, None], 0.0, rate)  # nothing keeps their lengths as they turn
    return np.asarray(rate - state.motion.b * np.sum(state.motion.b * rate, axis=1)[:, None])


def _on_turns(state: State, along: Array, b_rate: Array) -> Array:
    """(B, slots, slots): a stiffness (R,) of each rod's turns, less what the turning of jointed rods takes from it."""
    bodies, motion = state.bodies, state.motion
    R, B = len(bodies.length), len(bodies.mass)
    # A planar rod has one turn alone.
    held = np.any(motion.T[:R] != 0, axis=1) * along[:, None]
    held[:, 2:] = 0.0
    inner = held[:, :, None] * np.eye(bodies.slots - 3)
    if state.joints is not None:
        # The part of |II(δ, ḃ)|² that a rod alone has, II the second fundamental form of its configurations: of a rod
        # that turns about a pin, all in the plane of its turning.
        pull = np.einsum("rx,rxz->rz", motion.b, bodies.E[:R]) * bodies.f[:R, None]
        bent = bodies.J[:R] - np.sum(np.einsum("rij,ri->rj", motion.inverse[:R, :3], pull) ** 2, axis=1)
        way = np.einsum("rx,rxt->rt", b_rate, motion.T[:R])
        inner = inner - bent[:, None, None] * way[:, :, None] * way[:, None, :]
    blocks = np.zeros((B, bodies.slots, bodies.slots))
    levers = motion.inverse[:R, 3:, :]
    blocks[:R] = np.swapaxes(levers, 1, 2) @ inner @ levers
    return blocks


def _driven(state: State) -> Array:
    """(B, 3) [m/s²]: d̈ of the support of each body."""
    driven = np.zeros((len(state.bodies.mass), 3))
    rows = {rod.name: number for number, rod in enumerate(state.scene.structure.rods)}
    for motion in state.scene.motions:
        if motion.support in rows:
            driven[rows[motion.support]] = motion.at(state.time)[2]
    return driven


def _joint_bias(state: State, driven: Array, turning: Array) -> Array:
    """(3 J + L,) [m/s²] how much faster the end of the first rod of each joint accelerates than the second's at ÿ = 0.

    And how much faster a linear constraint's sum does than its value.
    """
    bodies = state.bodies
    bias = np.zeros((len(bodies.joints), 3))
    for side, sign in ((0, 1.0), (1, -1.0)):
        rods, end = bodies.joints[:, 1 + side], bodies.joint_ends[:, side]
        bias += sign * (driven[rods] - (bodies.ends[rods, end] * turning[rods])[:, None] * state.motion.b[rods])
    R, structure = len(turning), state.scene.structure
    nodes, on_rods = np.append(driven, np.zeros((1, 3)), axis=0)[bodies.body], bodies.body < R
    rods = bodies.body[on_rods]
    nodes[on_rods] -= (bodies.lever[on_rods] * turning[rods])[:, None] * state.motion.b[rods]
    ahead = structure.constraint_rows @ nodes.ravel() - constraint_values(state.scene, state.time)[2]
    return np.append(bias, ahead)
