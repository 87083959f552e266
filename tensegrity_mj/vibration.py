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
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.rods import inertia_terms
from tensegrity_mj.scene import Scene
from tensegrity_mj.strings import StringLaw
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

SLOTS = 5  # coordinates a body
DENSE = 150  # coordinates up to which matrices are dense
EDGE = 1e-12  # of its length: within round-off of its rest length, a string counts as taut


@dataclass(frozen=True, eq=False)
class Bodies:
    """What of a structure does not depend on its state; B bodies, N nodes.

    Attributes:
        body: (N,) of each node; B for a fixed one.
        lever: (N,) [m] from the point at σ to the node, along b.
        mass, f, J: (B,) of (2.30); f = 0 and J = 1 for a point mass.
        length, sigma: (R,) of the rods.
        E: (B, 3, 3) translations, padded with zero columns.
        planes: (R, 3) unit normals of planar rods, zero for others.
    """

    structure: Structure
    body: IntArray
    lever: Array
    mass: Array
    f: Array
    J: Array
    length: Array
    sigma: Array
    E: Array
    planes: Array

    @classmethod
    def of(cls, structure: Structure) -> Bodies:
        """The bodies of a structure."""
        R, P = len(structure.rods), len(structure.point_masses)
        body = np.full(len(structure.nodes), R + P)
        lever = np.zeros(len(structure.nodes))
        E, planes = np.zeros((R + P, 3, 3)), np.zeros((R, 3))
        sigma = np.array([rod.support.sigma for rod in structure.rods], float)
        length = structure.rod_lengths
        f, J = np.zeros(R + P), np.ones(R + P)
        f[:R], J[:R] = inertia_terms(structure.rod_masses, length, sigma)
        mass = np.concatenate([structure.rod_masses, [point.mass for point in structure.point_masses]])
        first, second = structure.rod_nodes.T
        body[first], body[second] = np.arange(R), np.arange(R)
        lever[first], lever[second] = -sigma * length, (1 - sigma) * length
        for number, rod in enumerate(structure.rods):
            basis = rod.support.translation_basis
            E[number, :, : basis.shape[1]] = basis
            if rod.support.plane is not None:
                planes[number] = np.array(rod.support.plane) / np.linalg.norm(rod.support.plane)
        for number, point in enumerate(structure.point_masses):
            body[structure.node_index[point.node]] = R + number
            basis = point.translation_basis
            E[R + number, :, : basis.shape[1]] = basis
        return cls(structure, body, lever, mass, f, J, length, sigma, E, planes)

    @property
    def mobilities(self) -> Array:
        """(N,) [1/kg] bound on what a force at a node accelerates it by: that of a free rod, 0 for a fixed node."""
        moment = self.J - self.f**2 / self.mass  # about the center of mass
        per_body_mass, per_body_moment = np.append(1 / self.mass, 0.0), np.append(1 / moment, 0.0)
        # From the center of mass, r + (f/m) b.
        arm = self.lever - np.append(self.f / self.mass, 0.0)[self.body]
        return np.asarray(per_body_mass[self.body] + arm**2 * per_body_moment[self.body])


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
        body_damper: (n, n) [1/s] the blocks of D on single bodies.
        seen: (n, n) [1/s²] the material stiffness that MuJoCo's `discrete` integrator reckons with: of k, always.
        law: what a law in the loop adds, or None.
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
    body_damper: Any = field(repr=False)
    seen: Any = field(repr=False)
    law: LawDerivative | None = None

    @property
    def size(self) -> int:
        """n."""
        return SLOTS * len(self.bodies.mass)

    @property
    def is_dense(self) -> bool:
        """Whether the matrices are arrays."""
        return self.size <= DENSE

    def motion(self, y: Array) -> Array:
        """(N, 3) displacements of the nodes of coordinates y (n,)."""
        parts = np.vstack([y.reshape(-1, SLOTS), np.zeros((1, SLOTS))])
        return np.asarray(np.einsum("nxs,ns->nx", self.turned, parts[self.bodies.body]))

    def elongations(self, y: Array) -> Array:
        """(M,) changes of the strings' lengths of coordinates y (n,)."""
        moved = self.motion(y)
        i, j = self.scene.structure.string_nodes.T
        return np.asarray(np.sum(self.direction * (moved[j] - moved[i]), axis=1))


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

    motion = _motion(bodies, nodes)
    weights = s[:, :, None] * s[:, None, :]
    across = np.eye(3) - weights
    over_length = tension / np.where(length > 0, length, 1.0)
    assemble = _Assembly(structure, bodies, motion.turned)
    rods = _rods_geometric(scene, bodies, nodes, s * tension[:, None], time, motion)
    material = assemble(stiffness[:, None, None] * weights)
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
        damper=assemble(damping[:, None, None] * weights),
        body_damper=assemble(damping[:, None, None] * weights, between=False),
        seen=material if force_densities is None else assemble(np.where(taut, k, 0.0)[:, None, None] * weights),
        law=law,
    )


def stiffness_bounds(
    structure: Structure, bodies: Bodies, nodes: Array, rest_lengths: Array
) -> tuple[float, float, float]:
    """Bounds that cost next to nothing: of the material and geometric parts of K, both [1/s²], and of D [1/s].

    (a - b)² <= 2 a² + 2 b² makes a sum over bodies of the quadratic form of a string; the largest eigenvalue of a body
    is at most the sum of those of its strings. A string that is fixed at one end has b = 0.
    """
    i, j = structure.string_nodes.T
    length = structure.string_lengths(nodes)
    B = len(bodies.mass)
    ends_free = (bodies.body[i] < B).astype(float) + (bodies.body[j] < B)
    mobility = bodies.mobilities
    density = structure.stiffness * np.abs(length - rest_lengths) / np.where(length > 0, length, np.inf)

    def largest(weight: Array) -> float:
        each = ends_free * weight
        bodies_of = np.concatenate([bodies.body[i], bodies.body[j]])
        values = np.concatenate([each * mobility[i], each * mobility[j]])
        return float(np.bincount(bodies_of, values, minlength=B + 1)[:B].max(initial=0.0))

    # Two directions across; a rod's own part is at most Σ T |lever| / (J - f²/m).
    moment = np.append(bodies.J - bodies.f**2 / bodies.mass, np.inf)
    pull = density * length
    turning = np.bincount(
        np.concatenate([bodies.body[i], bodies.body[j]]),
        np.concatenate([pull * np.abs(bodies.lever[n]) / moment[bodies.body[n]] for n in (i, j)]),
        minlength=B + 1,
    )[:B]
    return (
        largest(structure.stiffness),
        largest(2 * density) + float(turning.max(initial=0.0)),
        largest(structure.damping),
    )


def _strings_at(structure: Structure, nodes: Array, velocities: Array) -> tuple[Array, Array, Array]:
    """Unit vectors (M, 3), lengths and rates (M,) of the strings."""
    i, j = structure.string_nodes.T
    span = nodes[j] - nodes[i]
    length = np.sqrt(np.sum(span * span, axis=1))
    s = span / np.where(length > 0, length, 1.0)[:, None]
    return s, length, np.sum(s * (velocities[j] - velocities[i]), axis=1)


class _Motion(NamedTuple):
    """How nodes move with the coordinates y."""

    b: Array  # (R, 3)
    T: Array  # (B, 3, 2) the ways that b can turn
    inverse: Array  # (B, 5, 5) L⁻ᵀ
    turned: Array  # (N, 3, 5) X


def _motion(bodies: Bodies, nodes: Array) -> _Motion:
    R, B = len(bodies.length), len(bodies.mass)
    first, second = bodies.structure.rod_nodes.T
    b = (nodes[second] - nodes[first]) / bodies.length[:, None]
    b = b / np.sqrt(np.sum(b * b, axis=1))[:, None]
    planar = np.any(bodies.planes != 0, axis=1)
    one = _cross(np.where(planar[:, None], bodies.planes, np.eye(3)[np.argmin(np.abs(b), axis=1)]), b)
    one = one / np.sqrt(np.sum(one * one, axis=1))[:, None]
    T = np.zeros((B, 3, 2))
    T[:R, :, 0] = one
    T[:R, :, 1] = np.where(planar[:, None], 0.0, _cross(b, one))

    M = np.zeros((B, SLOTS, SLOTS))
    M[:, :3, :3] = bodies.mass[:, None, None] * np.eye(3)
    M[:, 3:, 3:] = bodies.J[:, None, None] * np.eye(2)
    coupling = bodies.f[:, None, None] * (np.swapaxes(bodies.E, 1, 2) @ T)
    M[:, :3, 3:], M[:, 3:, :3] = coupling, np.swapaxes(coupling, 1, 2)
    inverse = np.swapaxes(np.linalg.inv(np.linalg.cholesky(M)), 1, 2)

    moved = np.zeros((B + 1, 3, SLOTS))
    moved[:B, :, :3] = bodies.E
    levered = np.zeros((B + 1, 3, SLOTS))
    levered[:B, :, 3:] = T
    padded = np.zeros((B + 1, SLOTS, SLOTS))
    padded[:B] = inverse
    turned = (moved[bodies.body] + bodies.lever[:, None, None] * levered[bodies.body]) @ padded[bodies.body]
    return _Motion(b, T, inverse, turned)


def _cross(a: Array, b: Array) -> Array:
    """Cross products of rows: numpy's own spends its time elsewhere."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def _rods_geometric(scene: Scene, bodies: Bodies, nodes: Array, pulls: Array, time: float, motion: _Motion) -> Array:
    """(B, 5, 5): (t_b - f r̈)·b of every rod on its turns, with pulls (M, 3) [N] of the strings on their first nodes."""
    structure = scene.structure
    i, j = structure.string_nodes.T
    R, B = len(bodies.length), len(bodies.mass)
    forces = np.array(scene.nodal_forces(time)) if scene.loads else np.zeros_like(nodes)
    np.add.at(forces, i, pulls)
    np.subtract.at(forces, j, pulls)
    gravity = np.array(scene.gravity)
    first, second = structure.rod_nodes.T
    t_b = bodies.lever[first][:, None] * forces[first] + bodies.lever[second][:, None] * forces[second]
    t_b = t_b + bodies.f[:R, None] * gravity

    pushed = np.zeros((B + 1, SLOTS))
    np.add.at(pushed, bodies.body, np.einsum("nxs,nx->ns", motion.turned, forces))
    weight = np.concatenate([bodies.mass[:, None] * (gravity @ bodies.E), bodies.f[:, None] * (gravity @ motion.T)], 1)
    acceleration = np.einsum("bij,bj->bi", motion.inverse, pushed[:B] + np.einsum("bij,bi->bj", motion.inverse, weight))
    r_acceleration = np.einsum("rxi,ri->rx", bodies.E[:R], acceleration[:R, :3])
    along = np.sum(motion.b * (t_b - bodies.f[:R, None] * r_acceleration), axis=1)

    blocks = np.zeros((B, SLOTS, SLOTS))
    # A planar rod has one turn alone.
    allowed = np.any(motion.T[:R] != 0, axis=1)
    turns = motion.inverse[:R, 3:, :]
    blocks[:R] = np.einsum("bti,bt,btj->bij", turns, allowed * along[:, None], turns)
    return blocks


class _Assembly:
    """Matrices (n, n) of sums over strings of Xᵀ W X, with W (M, 3, 3)."""

    def __init__(self, structure: Structure, bodies: Bodies, turned: Array) -> None:
        self.i, self.j = structure.string_nodes.T
        self.body, self.turned, self.B = bodies.body, turned, len(bodies.mass)

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
        values, row, column = np.concatenate(parts), np.concatenate(rows), np.concatenate(columns)
        if SLOTS * self.B <= DENSE:
            matrix = np.zeros((self.B + 1, self.B + 1, SLOTS, SLOTS))
            np.add.at(matrix, (row, column), values)
            kept = matrix[: self.B, : self.B]
            return np.ascontiguousarray(kept.transpose(0, 2, 1, 3)).reshape(SLOTS * self.B, SLOTS * self.B)
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
