"""Effect of a state's forces on small motions of rods: their part of the geometric stiffness, and accelerations.

    Σ (t_b - f r̈)·b on the turns of each rod

t_b being the generalized force on b (2.55): a rod's compression makes it negative. Where rods share nodes the forces of
the joints are part of t_b, and velocities count: see `small_motions`.
"""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array, dot, norm
from tensegrity_mj.model.constraints import constraint_values
from tensegrity_mj.model.elements.element import forces_of
from tensegrity_mj.model.elements.resistance import BendingDamping, BendingStiffness
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.rods import Bars
from tensegrity_mj.vibration.state import State, bending_pulls

EPS = float(np.finfo(float).eps)
ROUND_OFF = 64 * EPS  # of magnitudes that are added: each passes through some dozens of operations


def geometric_of_rods(state: State, pulls: Array) -> tuple[Array, Array]:
    """(B, slots, slots) [1/s²] of every body, and ÿ (n,) [√kg m/s²]; pulls (S, 3) [N] of segments on their first nodes.

    Each rod's (t_b - f r̈)·b on its turns, and Σ (F·ξ) 1 - (F ξᵀ + ξ Fᵀ)/2 on those of every other body, of forces F on
    its nodes at ξ from its centre of mass.
    """
    bodies, motion, joints, structure = state.bodies, state.motion, state.joints, state.scene.structure
    R, B = len(bodies.length), len(bodies.mass)
    forces, sizes = forces_on_nodes(state, pulls)
    first, second = structure.rod_nodes.T
    driven = _driven(state)
    weight = np.array(state.scene.gravity) - driven  # (B, 3) felt by what moves with its support

    # Forces on the ends of each rod: those on a node go to the first body there.
    at_ends = np.zeros((R, 2, 3))
    for end, rows in enumerate((first, second)):
        own = bodies.body[rows] == np.arange(R)
        at_ends[own, end] = forces[rows[own]]
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
        for end, rows in enumerate((first, second)):
            own = bodies.body[rows] == np.arange(R)
            at_ends[own, end] += held[rows[own]]
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
    first, second = state.scene.structure.rod_nodes.T
    rate = (state.velocities[second] - state.velocities[first]) / state.bodies.length[:, None]
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
