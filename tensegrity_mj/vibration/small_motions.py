"""Small motions about a state: mass, stiffness and damping of all rods, point masses and taut strings.

    ÿ + (D + D_law) ẏ + (K + K_law) y = 0

in coordinates that make the mass matrix one. A body (a rod, then a point mass) has five of them: three for its
translations z along the support's basis E (2.41), two for the ways that b can turn; what a support forbids stays zero.
With M = L Lᵀ the mass matrix of a body (m, f, J of (2.30)), (z, turns) = L⁻ᵀ y, and a node moves by X y.

    K = material + geometric
    material  = Σ k Xᵀ s sᵀ X                       of the taut strings, s the unit vector along a string
    geometric = Σ T/L Xᵀ (1 - s sᵀ) X + Σ (t_b - f r̈)·b on the turns of each rod
    D = Σ c Xᵀ s sᵀ X

X being the difference of a string's two nodes, t_b the generalized force on b (2.55): a rod's compression makes the
last term negative. It is the linear model of `linearization`, from closed forms, without what the velocities of the
state do to it (centrifugal and gyroscopic terms), and away from an equilibrium without one term, of the accelerations
of rods that are held at a point of σ ≠ 1/2 with translations left, that is not symmetric.

Where rods share nodes, `joints` takes out what the joints forbid, and the forces of the joints are part of
t_b: a hanging cable is held by the weight that its rods carry, a swinging one by more. There velocities do count: the
forces are those that turn the rods on their ways, and what is left of -J |ḃ|² on a rod's own turns is added. That is
all of the tangential stiffness of the motion but a part that is not above zero. Supports that move push with -d̈.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.model.elements.element import forces_of
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.vibration.bodies import SLOTS, Bodies, _Motion, motion_of_bodies
from tensegrity_mj.vibration.joints import Joints
from tensegrity_mj.vibration.resistance import (
    Blocks,
    bending_blocks,
    bending_pulls,
    element_blocks,
    fluid_forces,
    viscous_blocks,
)

ROUND_OFF = 1e-14  # of the forces on a rod's ends
EDGE = 1e-12  # of its length: within round-off of its rest length, a string counts as taut

DENSE = 150  # coordinates up to which matrices are dense


@dataclass(frozen=True, eq=False)
class LawDerivative:
    """What a law adds to the linear model, in the coordinates y: matrices (n, n), not symmetric."""

    stiffness: Array
    damping: Array


@dataclass(frozen=True, eq=False)
class Vibration:
    """The linear model of one state; n = 5 B coordinates. Matrices are dense up to `DENSE` coordinates, else sparse.

    Attributes:
        scene: what moves.
        nodes: (N, 3) [m] the state.
        taut: (M,) bool.
        at_edge: (M,) bool, taut without tension: half of any motion makes it slack.
        tension, length: (M,) [N], [m].
        stiffness: (M,) [N/m] of each string in this model: k, or u where force densities are held.
        damping: (M,) [N s/m].
        turned: (N, 3, 5) X of each node, in the coordinates of its body.
        material, geometric, damper: the matrices K and D above, (n, n) [1/s²], [1/s²], [1/s].
        string_damper: (n, n) [1/s] the part of D that strings have: what MuJoCo's `discrete` integrator counts with.
        body_damper: (n, n) [1/s] the blocks of that on single bodies: what the implicit ones count with. Where rods
            share nodes half of `string_damper`, as if there were no dampers: `tree` has what they know there.
        seen: (n, n) [1/s²] the material stiffness that MuJoCo's `discrete` integrator counts with: of k, always.
        acceleration: (n,) [√kg m/s²] ÿ of the state: zero at rest in an equilibrium.
        law: what a law in the loop adds, or None.
        joints: what of y they forbid, or None where no rods share a node. Dense matrices have that taken out already;
            of sparse ones, it is for `project` to do.
    """

    scene: Scene
    bodies: Bodies
    nodes: Array
    taut: NDArray[np.bool_]
    at_edge: NDArray[np.bool_]
    tension: Array
    length: Array
    direction: Array
    stiffness: Array
    damping: Array
    turned: Array
    material: Any = field(repr=False)
    geometric: Any = field(repr=False)
    damper: Any = field(repr=False)
    string_damper: Any = field(repr=False)
    body_damper: Any = field(repr=False)
    seen: Any = field(repr=False)
    acceleration: Array = field(repr=False)
    law: LawDerivative | None = None
    joints: Joints | None = None

    @property
    def size(self) -> int:
        """n."""
        return SLOTS * len(self.bodies.mass)

    @property
    def is_dense(self) -> bool:
        """Whether the matrices are arrays."""
        return self.size <= DENSE

    def project(self, y: Array) -> Array:
        """What joints allow of y (n,)."""
        return y if self.joints is None else self.joints.project(y)

    def motion(self, y: Array) -> Array:
        """(N, 3) displacements of the nodes of coordinates y (n,), of what joints allow."""
        parts = np.vstack([y.reshape(-1, SLOTS), np.zeros((1, SLOTS))])
        return np.asarray(np.einsum("nxs,ns->nx", self.turned, parts[self.bodies.body]))


def vibration(
    scene: Scene,
    nodes: Array,
    velocities: Array,
    rest_lengths: Array,
    *,
    force_densities: Array | None = None,
    law: LawDerivative | None = None,
    broken: NDArray[np.bool_] | None = None,
    time: float = 0.0,
    bodies: Bodies | None = None,
) -> Vibration:
    """The linear model about a state.

    Args:
        scene: structure, gravity and loads.
        nodes, velocities: (N, 3); velocities count in the dampers' tensions alone.
        rest_lengths: (M,) [m].
        force_densities: (M,) [N/m] that are held instead of the rest lengths: a string then has the stiffness u in
            every direction.
        law: what a law in the loop adds.
        broken: (M,) strings that carry nothing.
        time: [s] of the loads.
        bodies: of the structure, where they are known already.
    """
    structure = scene.structure
    bodies = bodies or Bodies.of(structure)
    s, length, rate = _strings_at(structure, nodes, velocities)
    k = structure.stiffness
    stretch = length - rest_lengths
    edge = EDGE * np.maximum(length, np.abs(rest_lengths))
    taut = (stretch >= -edge) & (length > 0)
    if broken is not None:
        taut &= ~broken
    elastic = k * stretch
    total = elastic + structure.damping * rate
    if structure.string_law is StringLaw.CLIPPED:
        total = np.maximum(0.0, total)
    tension = np.where(taut, total, 0.0)
    stiffness = np.where(taut, k if force_densities is None else force_densities, 0.0)
    damping = np.where(taut, structure.damping, 0.0)

    motion = motion_of_bodies(bodies, nodes)
    joints = _joints_of(bodies, motion)
    weights = s[:, :, None] * s[:, None, :]
    across = np.eye(3) - weights
    over_length = tension / np.where(length > 0, length, 1.0)
    assemble = _Assembly(structure, bodies, motion.turned, joints)
    pulls = s * tension[:, None]
    rods, acceleration = _rods_geometric(scene, bodies, nodes, velocities, pulls, time, motion, joints)
    seen = material = assemble(stiffness[:, None, None] * weights)
    if force_densities is not None:
        seen = assemble(np.where(taut, k, 0.0)[:, None, None] * weights)
    strings = damper = assemble(damping[:, None, None] * weights)
    bent, viscous = _resistance_of(scene, bodies, motion)
    if bent is not None and scene.resistance is not None and scene.resistance.bending is not None:
        material = material + assemble.sum(bent.times(scene.resistance.bending.stiffness))
        damper = damper + assemble.sum(bent.times(scene.resistance.bending.damping))
    if viscous is not None:
        damper = damper + assemble.sum(viscous)
    if scene.elements:
        stiff, lossy = element_blocks(scene, time, nodes, velocities, bodies.body, motion.turned)
        material, damper = material + assemble.sum(stiff), damper + assemble.sum(lossy)
    # In a tree of MuJoCo's bodies, which dampers an implicit integrator knows depends on the tree: `tree`.
    known = 0.5 * strings if joints is not None else assemble(damping[:, None, None] * weights, between=False)
    return Vibration(
        scene=scene,
        bodies=bodies,
        nodes=nodes,
        taut=taut,
        at_edge=taut & (np.abs(stretch) <= edge),
        tension=tension,
        length=length,
        direction=s,
        stiffness=stiffness,
        damping=damping,
        turned=motion.turned,
        material=material,
        geometric=assemble(over_length[:, None, None] * across, rods),
        damper=damper,
        string_damper=strings,
        body_damper=known,
        seen=seen,
        acceleration=acceleration,
        law=law,
        joints=joints,
    )


def stiffness_bounds(
    scene: Scene, bodies: Bodies, nodes: Array, velocities: Array, rest_lengths: Array
) -> tuple[float, float, float, float]:
    """Bounds that cost little: of the strings' material part of K and of the rest, both [1/s²], and of both parts of D.

    D [1/s] is that of the strings, and that of what else resists; at t = 0.

    (a - b)² <= 2 a² + 2 b² makes a sum over bodies of the quadratic form of a string; the largest eigenvalue of a body
    is at most the sum of those of its strings. A string that is fixed at one end has b = 0. Joints only lower them.
    """
    structure = scene.structure
    i, j = structure.string_nodes.T
    s, length, rate = _strings_at(structure, nodes, velocities)
    B = len(bodies.mass)
    ends_free = (bodies.body[i] < B).astype(float) + (bodies.body[j] < B)
    mobility = bodies.mobilities
    stretch = length - rest_lengths
    pull = np.where(stretch >= 0, np.abs(structure.stiffness * stretch + structure.damping * rate), 0.0)
    density = pull / np.where(length > 0, length, np.inf)

    def largest(weight: Array) -> float:
        each = ends_free * weight
        bodies_of = np.concatenate([bodies.body[i], bodies.body[j]])
        values = np.concatenate([each * mobility[i], each * mobility[j]])
        return float(np.bincount(bodies_of, values, minlength=B + 1)[:B].max(initial=0.0))

    # Two directions across, and each rod's own part.
    motion = motion_of_bodies(bodies, nodes)
    joints = _joints_of(bodies, motion)
    blocks, _ = _rods_geometric(scene, bodies, nodes, velocities, s * pull[:, None], 0.0, motion, joints)
    turning = np.abs(blocks).sum(axis=2).max(initial=0.0)
    rest, other = largest(2 * density) + float(turning), 0.0
    bent, viscous = _resistance_of(scene, bodies, motion)
    if bent is not None and scene.resistance is not None and scene.resistance.bending is not None:
        rest += scene.resistance.bending.stiffness * _row_sums(bent, B)
        other += scene.resistance.bending.damping * _row_sums(bent, B)
    if viscous is not None:
        other += _row_sums(viscous, B)
    if scene.elements:
        stiff, lossy = element_blocks(scene, 0.0, nodes, velocities, bodies.body, motion.turned)
        rest, other = rest + _row_sums(stiff, B), other + _row_sums(lossy, B)
    return largest(structure.stiffness), rest, largest(structure.damping), other


def _row_sums(blocks: Blocks, bodies: int) -> float:
    """The largest sum of absolute values along a row: a bound on eigenvalues."""
    sums = np.zeros((bodies + 1, SLOTS))
    np.add.at(sums, blocks.rows, np.abs(blocks.values).sum(axis=2))
    return float(sums[:bodies].max(initial=0.0))


def _resistance_of(scene: Scene, bodies: Bodies, motion: _Motion) -> tuple[Blocks | None, Blocks | None]:
    """Blocks of what resists bending, and of a viscous fluid."""
    if scene.resistance is None:
        return None, None
    R = len(bodies.length)
    turns = motion.T[:R] @ motion.inverse[:R, 3:]
    slides = bodies.E[:R] @ motion.inverse[:R, :3]
    ends = [slides + bodies.ends[:, end, None, None] * turns for end in range(2)]
    return bending_blocks(scene, turns), viscous_blocks(scene, np.array(ends))


def _strings_at(structure: Structure, nodes: Array, velocities: Array) -> tuple[Array, Array, Array]:
    """Unit vectors (M, 3), lengths and rates (M,) of the strings."""
    i, j = structure.string_nodes.T
    span = nodes[j] - nodes[i]
    length = np.sqrt(np.sum(span * span, axis=1))
    s = span / np.where(length > 0, length, 1.0)[:, None]
    return s, length, np.sum(s * (velocities[j] - velocities[i]), axis=1)


def _joints_of(bodies: Bodies, motion: _Motion) -> Joints | None:
    if not len(bodies.joints):
        return None
    pairs = bodies.joints[:, 1:]
    maps = []
    for rods in pairs.T:
        at_second = bodies.structure.rod_nodes[rods, 1] == bodies.joints[:, 0]
        lever = bodies.ends[rods, at_second.astype(int)]
        plain = np.concatenate([bodies.E[rods], lever[:, None, None] * motion.T[rods]], axis=2)
        maps.append(plain @ motion.inverse[rods])
    return Joints(pairs, np.array(maps), len(bodies.mass), SLOTS * len(bodies.mass) <= DENSE)


def _rods_geometric(
    scene: Scene,
    bodies: Bodies,
    nodes: Array,
    velocities: Array,
    pulls: Array,
    time: float,
    motion: _Motion,
    joints: Joints | None,
) -> tuple[Array, Array]:
    """(B, 5, 5): (t_b - f r̈)·b of every rod on its turns; and ÿ (n,).

    Args: of `small_motions`, pulls (M, 3) [N] of the strings on their first nodes, and what follows from the nodes.
    """
    structure = scene.structure
    i, j = structure.string_nodes.T
    R, B = len(bodies.length), len(bodies.mass)
    forces = np.array(scene.nodal_forces(time)) if scene.loads else np.zeros_like(nodes)
    forces += fluid_forces(scene, nodes, velocities)
    forces += forces_of(scene.elements, scene, time, nodes, velocities)
    np.add.at(forces, i, pulls)
    np.subtract.at(forces, j, pulls)
    first, second = structure.rod_nodes.T
    driven = _driven(scene, bodies, time)
    weight = np.array(scene.gravity) - driven  # (B, 3) felt by what moves with its support

    # Forces on the ends of each rod: those on a node go to the first body there.
    at_ends = np.zeros((R, 2, 3))
    for end, rows in enumerate((first, second)):
        own = bodies.body[rows] == np.arange(R)
        at_ends[own, end] = forces[rows[own]]
    b_rate = np.zeros((R, 3))
    if joints is not None:
        b_rate = (velocities[second] - velocities[first]) / bodies.length[:, None]
        b_rate = b_rate - motion.b * np.sum(motion.b * b_rate, axis=1)[:, None]
    turning = np.sum(b_rate * b_rate, axis=1)

    pushed = np.zeros((B + 1, SLOTS))
    np.add.at(pushed, bodies.body, np.einsum("nxs,nx->ns", motion.turned, forces))
    slides = np.einsum("bx,bxz->bz", bodies.mass[:, None] * weight, bodies.E)
    slides[:R] += (bodies.f[:R] * turning)[:, None] * np.einsum("rx,rxz->rz", motion.b, bodies.E[:R])
    turns = bodies.f[:, None] * np.einsum("bx,bxt->bt", weight, motion.T)
    bends = bending_pulls(scene, motion.b)
    turns[:R] += np.einsum("rx,rxt->rt", bends, motion.T[:R])
    acceleration = pushed[:B] + np.einsum("bij,bi->bj", motion.inverse, np.concatenate([slides, turns], axis=1))
    if joints is not None:
        carried = _carried(bodies, motion, joints, acceleration, driven, turning)
        for side, sign in ((0, 1.0), (1, -1.0)):
            rods = joints.pairs[:, side]
            end = (structure.rod_nodes[rods, 1] == bodies.joints[:, 0]).astype(int)
            np.add.at(at_ends, (rods, end), sign * carried)
            np.add.at(acceleration, rods, np.einsum("jxs,jx->js", joints.maps[side], sign * carried))
    free = np.einsum("bij,bj->bi", motion.inverse, acceleration)
    r_acceleration = np.einsum("rxi,ri->rx", bodies.E[:R], free[:R, :3])
    t_b = np.sum(bodies.ends[:, :, None] * at_ends, axis=1) + bodies.f[:R, None] * weight[:R] + bends
    along = np.sum(motion.b * (t_b - bodies.f[:R, None] * r_acceleration), axis=1)
    # Forces that cancel leave round-off, which is no stiffness.
    largest = np.sum(np.abs(bodies.ends) * np.linalg.norm(at_ends, axis=2), axis=1) + np.linalg.norm(bends, axis=1)
    along = np.where(np.abs(along) > ROUND_OFF * largest, along, 0.0)

    # A planar rod has one turn alone.
    held = np.any(motion.T[:R] != 0, axis=1) * (along + bodies.J[:R] * turning)[:, None]
    inner = held[:, :, None] * np.eye(2)
    if joints is not None:
        # What a rod alone would have of |II(δ, ḃ)|², II the second fundamental form of where it can be: of a rod that
        # turns about a pin, all in the plane of its turning.
        pull = np.einsum("rx,rxz->rz", motion.b, bodies.E[:R]) * bodies.f[:R, None]
        bent = bodies.J[:R] - np.sum(np.einsum("rij,ri->rj", motion.inverse[:R, :3], pull) ** 2, axis=1)
        way = np.einsum("rx,rxt->rt", b_rate, motion.T[:R])
        inner = inner - bent[:, None, None] * way[:, :, None] * way[:, None, :]
    blocks = np.zeros((B, SLOTS, SLOTS))
    levers = motion.inverse[:R, 3:, :]
    blocks[:R] = np.swapaxes(levers, 1, 2) @ inner @ levers
    return blocks, acceleration.ravel()


def _driven(scene: Scene, bodies: Bodies, time: float) -> Array:
    """(B, 3) [m/s²]: d̈ of the support of each body."""
    driven = np.zeros((len(bodies.mass), 3))
    rows = {rod.name: number for number, rod in enumerate(scene.structure.rods)}
    for motion in scene.motions:
        if motion.support in rows:
            driven[rows[motion.support]] = motion.at(time)[2]
    return driven


def _carried(bodies: Bodies, motion: _Motion, joints: Joints, pushes: Array, driven: Array, turning: Array) -> Array:
    """(J, 3) [N] that joints exert on the first of their two rods, which the other one gives back."""
    bias = np.zeros((len(joints.pairs), 3))
    for side, sign in ((0, 1.0), (1, -1.0)):
        rods = joints.pairs[:, side]
        end = (bodies.structure.rod_nodes[rods, 1] == bodies.joints[:, 0]).astype(int)
        bias += sign * (driven[rods] - (bodies.ends[rods, end] * turning[rods])[:, None] * motion.b[rods])
    return joints.forces(pushes.ravel(), bias)


class _Assembly:
    """Matrices (n, n) of sums over strings of Xᵀ W X, with W (M, 3, 3)."""

    def __init__(self, structure: Structure, bodies: Bodies, turned: Array, joints: Joints | None) -> None:
        self.i, self.j = structure.string_nodes.T
        self.body, self.turned, self.B, self.joints = bodies.body, turned, len(bodies.mass), joints

    def sum(self, blocks: Blocks) -> Any:
        """The matrix of blocks of bodies."""
        return self._matrix(blocks.values, blocks.rows, blocks.columns)

    def __call__(self, weights: Array, blocks: Array | None = None, between: bool = True) -> Any:
        """The matrix, with blocks (B, 5, 5) of the bodies added; `between` bodies there is nothing without that."""
        parts, rows, columns = [], [], []
        for p, a in ((1.0, self.i), (-1.0, self.j)):
            for q, b in ((1.0, self.i), (-1.0, self.j)):
                if a is not b and not between:
                    continue
                parts.append(p * q * np.swapaxes(self.turned[a], 1, 2) @ weights @ self.turned[b])
                rows.append(self.body[a])
                columns.append(self.body[b])
        if blocks is not None:
            parts.append(blocks)
            rows.append(np.arange(self.B))
            columns.append(np.arange(self.B))
        return self._matrix(np.concatenate(parts), np.concatenate(rows), np.concatenate(columns))

    def _matrix(self, values: Array, row: IntArray, column: IntArray) -> Any:
        if SLOTS * self.B <= DENSE:
            matrix = np.zeros((self.B + 1, self.B + 1, SLOTS, SLOTS))
            np.add.at(matrix, (row, column), values)
            kept = matrix[: self.B, : self.B]
            full = np.ascontiguousarray(kept.transpose(0, 2, 1, 3)).reshape(SLOTS * self.B, SLOTS * self.B)
            return full if self.joints is None else self.joints.projection @ full @ self.joints.projection
        from scipy.sparse import coo_array

        inside = (row < self.B) & (column < self.B)
        values, row, column = values[inside], row[inside], column[inside]
        slot = np.arange(SLOTS)
        at = (
            SLOTS * row[:, None, None] + slot[:, None] + 0 * slot,
            SLOTS * column[:, None, None] + 0 * slot[:, None] + slot,
        )
        shape = (SLOTS * self.B, SLOTS * self.B)
        return coo_array((values.ravel(), (at[0].ravel(), at[1].ravel())), shape=shape).tocsr()
