"""Jacobians of members and supports at given nodes, equilibrium matrices of these, and the forces that solve them.

Lengths change with the nodes by the unit vectors of members (`members_at`), and forces along members act on the nodes
by the transpose (`nodal_forces`). Supports leave the free coordinates of `free_motions`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array, IntArray, cross, norm
from tensegrity_mj.basics.checks import real_array
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.members import null_space_bases
from tensegrity_mj.model.rods import lumped_masses
from tensegrity_mj.model.structure import Structure

# Singular values of A below this part of the largest count as zero: far above the round-off of 17 digits, far
# below the 1e-4 of coordinates printed with four digits (which are in no exact equilibrium).
RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class StaticForces:
    """Forces that rods and supports carry under given string force densities and loads.

    Attributes:
        rod_force_densities: (R,) [N/m], negative in compression; J λ / ℓ² of the thesis at rest.
        support_forces: (R, 3) [N] on each rod at its point σ.
        support_moments: (R, 3) [N m] on each planar rod, keeping it in its plane.
        anchor_forces: (N, 3) [N] on fixed nodes and on planar point masses; zero on other nodes.
        constraint_forces: (C,) [N] along each constraint's direction, times a node's weight on that node.
    """

    rod_force_densities: Array
    support_forces: Array
    support_moments: Array
    anchor_forces: Array
    constraint_forces: Array


class Members(NamedTuple):
    """Lengths (m,) [m] of members and their unit vectors (m, 3), from the first node to the second."""

    lengths: Array
    directions: Array


def members_at(pairs: IntArray, nodes: Array) -> Members:
    """Members between pairs (m, 2) of nodes (N, 3); where two nodes coincide the direction is zero."""
    spans = spans_at(pairs, nodes)
    lengths = np.sqrt(np.einsum("mi,mi->m", spans, spans))
    return Members(lengths, spans / np.where(lengths > 0, lengths, 1.0)[:, None])


def spans_at(pairs: IntArray, nodes: Array) -> Array:
    """(m, 3) [m] from the first to the second node of each pair (m, 2)."""
    return np.asarray(nodes[pairs[:, 1]] - nodes[pairs[:, 0]])


def nodal_forces(pairs: IntArray, vectors: Array, count: int) -> Array:
    """Forces on `count` nodes (3N, m) by members that pull: vectors (m, 3) at the first node, minus these at the last.

    Unit vectors give those of forces of 1 N, spans those of force densities of 1 N/m. For unit vectors the negative
    transpose is the Jacobian of the lengths.
    """
    forces = np.zeros((count, 3, len(pairs)))
    columns = np.arange(len(pairs))
    forces[pairs[:, 0], :, columns] = vectors
    forces[pairs[:, 1], :, columns] = -vectors
    return forces.reshape(3 * count, len(pairs))


def body_motions(nodes: Array) -> Array:
    """(3N, 6) three shifts, and three turns about the nodes' mean whose largest move is about that of a shift."""
    offsets = nodes - nodes.mean(axis=0)
    size = float(np.abs(offsets).max()) or 1.0
    return np.hstack([np.tile(np.eye(3), (len(nodes), 1)), turned(offsets / size)])


def turned(vectors: Array) -> Array:
    """(3N, 3): e_k × v for the three axes k of the world and vectors (N, 3)."""
    return cross(np.eye(3), vectors[:, None]).swapaxes(1, 2).reshape(-1, 3)


class Equilibrium(NamedTuple):
    """Result of holding a configuration with strings that only pull."""

    force_densities: Array  # (M,) [N/m], >= 0
    residual: float  # [N], norm over the free coordinates
    self_stress_modes: int


def free_motions(structure: Structure, nodes: ArrayLike | None = None) -> Array:
    """Node displacements (3N, q) of a unit of each free coordinate; nodes (N, 3) [m], the reference by default."""
    positions = nodes_of(structure, nodes)
    motions, apart = _motions_of_ends(structure, positions)  # and what rows of these are not to move
    if not len(apart):
        return motions
    _, singular, right = np.linalg.svd(apart @ motions)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
    return np.asarray(motions[: 3 * len(positions)] @ right[rank:].T)


def _ends(structure: Structure) -> tuple[NDArray[np.int64], list[int]]:
    """Return the rows of each rod's ends (R, 2), and the nodes of which the rows beyond the N nodes are copies.

    The first rod of a joint has the joint's node, every other one a copy.
    """
    ends = np.array(structure.rod_nodes)
    taken: set[int] = set()
    copied: list[int] = []
    for row in range(len(ends)):
        for end in (0, 1):
            node = int(ends[row, end])
            if node in taken:
                ends[row, end] = len(structure.nodes) + len(copied)
                copied.append(node)
            taken.add(node)
    return ends, copied


def _motions_of_ends(structure: Structure, positions: Array) -> tuple[Array, Array]:
    """Motions (3N + 3C, p) of N nodes and C copies as if rods were apart, and rows (3C + L, 3N + 3C) that join them.

    The rows are the gaps between nodes and copies, and the L linear constraints.
    """
    ends, copied = _ends(structure)
    count = len(positions) + len(copied)
    columns: list[Array] = []

    def add(weights: dict[int, float], directions: Array) -> None:
        motions = np.zeros((directions.shape[1], count, 3))
        for row, weight in weights.items():
            motions[:, row] = weight * directions.T
        columns.append(motions.reshape(-1, 3 * count))

    spans = spans_at(structure.rod_nodes, positions)
    planes = [rod.support.plane for rod in structure.rods]
    across = [[span] if plane is None else [span, plane] for span, plane in zip(spans, planes, strict=True)]
    turns: dict[int, Array] = {}  # b turns across these
    for rows in ([row for row, one in enumerate(across) if len(one) == many] for many in (1, 2)):
        if rows:
            turns |= zip(rows, null_space_bases(np.array([across[row] for row in rows], float)), strict=True)
    for row, (rod, (i, j)) in enumerate(zip(structure.rods, ends.tolist(), strict=True)):
        sigma = rod.support.sigma
        add({i: 1.0, j: 1.0}, rod.support.translation_basis)
        add({i: -sigma, j: 1.0 - sigma}, turns[row])
    for point in structure.lone_masses:
        add({structure.node_index[point.node]: 1.0}, point.translation_basis)
    for frame in structure.moving_frames:
        moved = frame.motions(positions).reshape(3 * len(positions), 6)
        columns.append(np.pad(moved, ((0, 3 * len(copied)), (0, 0))).T)
    held, gaps = structure.constraint_rows, 3 * len(copied)
    apart = np.zeros((gaps + len(held), 3 * count))
    gap = np.arange(gaps)
    apart[gap, 3 * len(positions) + gap] = 1.0
    apart[gap, (3 * np.array(copied, int)[:, None] + np.arange(3)).ravel()] -= 1.0
    apart[gaps:, : 3 * len(positions)] = held
    return np.concatenate(columns).T, apart


def equilibrium_matrix(structure: Structure, nodes: ArrayLike | None = None) -> Array:
    """A (q, M) [m]: forces [N] on the free coordinates of unit force densities [N/m] of the strings."""
    positions = nodes_of(structure, nodes)
    return free_motions(structure, positions).T @ _string_forces(structure, positions)


def static_forces(
    structure: Structure,
    force_densities: ArrayLike,
    nodes: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
) -> StaticForces:
    """Rod forces and support reactions in an equilibrium.

    Args:
        force_densities: u (M,) [N/m].
        nodes: (N, 3) [m]; None for the reference.
        gravity: (3,) [m/s²]; a rod's weight acts half at each of its nodes.
        loads: (N, 3) [N].
    """
    positions = nodes_of(structure, nodes)
    u = real_array("force_densities", force_densities, (len(structure.strings),), "N/m", error=StructureError)
    forces = (_string_forces(structure, positions) @ u).reshape(-1, 3) + loads_on(structure, gravity, loads)
    count = len(structure.rods)
    densities, supports, moments = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3))
    anchors = np.zeros_like(forces)
    ends, copied = _ends(structure)
    spans = spans_at(structure.rod_nodes, positions)
    constraint_forces: Array = np.zeros(len(structure.constraints))
    if len(copied) or structure.constraints:
        # Forces between a joint's rods, and of constraints on nodes, are those that leave each of them in balance.
        motions, apart = _motions_of_ends(structure, positions)
        forces = np.concatenate([forces, np.zeros((len(copied), 3))])
        passed = np.linalg.lstsq((apart @ motions).T, -motions.T @ forces.ravel(), rcond=RANK_TOLERANCE)[0]
        forces = np.asarray(forces + (apart.T @ passed).reshape(-1, 3))
        constraint_forces = np.asarray(passed[3 * len(copied) :])
    for number, (rod, (i, j), span) in enumerate(zip(structure.rods, ends.tolist(), spans, strict=True)):
        support = rod.support
        turning = (1.0 - support.sigma) * forces[j] - support.sigma * forces[i]
        densities[number] = span @ turning / (span @ span)
        supports[number] = -_held(support.translation_basis, forces[i] + forces[j])
        if support.plane is not None:
            moments[number] = -np.cross(span, _held(support.rotation_basis, turning))
    for name in structure.fixed_nodes:
        anchors[structure.node_index[name]] = -forces[structure.node_index[name]]
    for point in structure.lone_masses:
        row = structure.node_index[point.node]
        anchors[row] = -_held(point.translation_basis, forces[row])
    return StaticForces(densities, supports, moments, anchors, constraint_forces)


def equilibrium_force_densities(
    structure: Structure,
    nodes: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
) -> Equilibrium:
    """Force densities u >= 0 that come closest to equilibrium (non-negative least squares).

    Without gravity and loads that is u = 0: every configuration is an equilibrium of slack strings, and only
    the number of self-stress modes says more. Arguments as `static_forces`.
    """
    positions = nodes_of(structure, nodes)
    matrix, external = equilibrium_equations(structure, positions, free_motions(structure, positions), gravity, loads)
    modes = len(structure.strings) - _rank(np.linalg.svd(matrix, compute_uv=False))
    if not structure.strings:
        return Equilibrium(np.zeros(0), float(np.linalg.norm(external)), modes)
    if not external.any():
        return Equilibrium(np.zeros(len(structure.strings)), 0.0, modes)
    from scipy.optimize import nnls  # takes half a second to import

    u, residual = nnls(matrix, -external)
    return Equilibrium(u, float(residual), modes)


class BalancedStates(NamedTuple):
    """Solutions u of A u + f = 0: particular + any combination of modes (S, M); what no u balances is the residual."""

    modes: Array
    particular: Array
    residual: Array
    singular_values: Array


def equilibrium_equations(
    structure: Structure, positions: Array, motions: Array, gravity: ArrayLike | None, loads: ArrayLike | None
) -> tuple[Array, Array]:
    """A (q, M) and f (q,) of A u + f = 0."""
    return motions.T @ _string_forces(structure, positions), motions.T @ loads_on(structure, gravity, loads).ravel()


def balanced_states(matrix: Array, external: Array) -> BalancedStates:
    left, singular, right = np.linalg.svd(matrix)
    rank = _rank(singular)
    modes = right[rank:]
    modes = modes * np.where(modes.sum(axis=1) < 0, -1.0, 1.0)[:, None]
    particular = -right[:rank].T @ (left[:, :rank].T @ external / singular[:rank])
    return BalancedStates(modes, particular, matrix @ particular + external, singular)


def _rank(singular: Any) -> int:
    return int(np.sum(singular > RANK_TOLERANCE * singular[0])) if singular.size and singular[0] > 0 else 0


def count_rigid_motions(positions: Array, motions: Array) -> int:
    """Count the independent motions of all nodes as one body that lie in the span of the given ones (3N, q)."""
    left, singular, _ = np.linalg.svd(body_motions(positions), full_matrices=False)
    bodies = left[:, singular > RANK_TOLERANCE * singular[0]]  # nodes on one line: turning about it moves none
    span, _ = np.linalg.qr(motions)
    outside = np.linalg.svd(bodies - span @ (span.T @ bodies), compute_uv=False)
    return int(np.sum(outside < 1e-7))  # an orthonormal basis: 0 inside the span, up to 1 outside


def _string_forces(structure: Structure, positions: Array) -> Array:
    """Forces on the nodes (3N, M) of unit force densities T/L: the nodes of each segment are pulled together with T."""
    paths = structure.paths
    spans = paths.spans(positions)
    pulls = spans * paths.shares(norm(spans))[:, None]
    return np.asarray(paths.total(nodal_forces(paths.nodes, pulls, len(positions))))


def loads_on(structure: Structure, gravity: ArrayLike | None, loads: ArrayLike | None) -> Array:
    """External forces and weights on the nodes (N, 3) [N]."""
    shape = (len(structure.nodes), 3)
    forces = np.zeros(shape) if loads is None else real_array("loads", loads, shape, "N", False, StructureError)
    if gravity is not None:
        g = real_array("gravity", gravity, (3,), "m/s²", False, StructureError)
        forces += lumped_masses(structure)[:, None] * g
    return forces


def nodes_of(structure: Structure, nodes: ArrayLike | None) -> Array:
    if nodes is None:
        return structure.positions
    return real_array("nodes", nodes, (len(structure.nodes), 3), "m", False, StructureError)


def _held(free: Array, force: Array) -> Array:
    """The part of a force outside the span of an orthonormal basis (3, d): what the support takes."""
    return force - free @ (free.T @ force)
