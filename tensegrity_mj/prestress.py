"""Statics of a structure at given nodes: self-stress, prestress, and how far from equilibrium it is.

Rods are rigid and strings pull with force densities u [N/m], so that equilibrium is linear in u: A u + f = 0.
Its rows are the free coordinates of every kind of support (2.41): for a rod the translation E of its point at
σ, and the two ways b can turn (one if planar); for a point mass its free directions. What supports and rigid
rods carry drops out, and follows from u (`static_forces`). All rows are forces [N]:

    Eᵀ (F_i + F_j)        and        Tᵀ ((1 - σ) F_j - σ F_i),        T spans the free directions of δb,

with F the forces on a rod's two nodes; the second is the moment about the support point over ℓ. Where rods share nodes,
the free coordinates are combinations of these: an orthonormal basis of those that keep the joints together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.rods import lumped_masses
from tensegrity_mj.structure import Structure, null_space_basis
from tensegrity_mj.validation import array_of_shape

Array = NDArray[np.float64]

# Singular values of A below this part of the largest count as zero: far above the round-off of 17 digits, far
# below the 1e-4 of coordinates printed with four digits (which are in no exact equilibrium).
RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class StaticForces:
    """What rods and supports carry under given string force densities and loads.

    Attributes:
        rod_force_densities: (R,) [N/m], negative in compression; J λ / ℓ² of the thesis at rest.
        support_forces: (R, 3) [N] on each rod at its point σ.
        support_moments: (R, 3) [N m] on each planar rod, keeping it in its plane.
        anchor_forces: (N, 3) [N] on fixed nodes and on planar point masses; zero on other nodes.
    """

    rod_force_densities: Array
    support_forces: Array
    support_moments: Array
    anchor_forces: Array


@dataclass(frozen=True, eq=False)
class SelfStress:
    """Self-stress of a structure at given nodes: S independent states.

    Attributes:
        modes: (S, M) [N/m] orthonormal force densities of the strings; any combination is in equilibrium.
        forces: what rods and supports carry in each mode.
        particular: (M,) [N/m] smallest force densities that balance gravity and loads as well as any can.
        residual: (q,) [N] what `particular` leaves unbalanced, on the q free coordinates.
        free_coordinates: q.
        rigid_motions: motions of the whole as one body that the supports leave.
        mechanisms: further independent motions that change no string's length, to first order.
        singular_values: of A, decreasing; they tell how clear the rank is.
    """

    modes: Array
    forces: tuple[StaticForces, ...]
    particular: Array
    residual: Array
    free_coordinates: int
    rigid_motions: int
    mechanisms: int
    singular_values: Array


class Equilibrium(NamedTuple):
    """How well strings that only pull can hold a configuration."""

    force_densities: Array  # (M,) [N/m], >= 0
    residual: float  # [N], norm over the free coordinates
    self_stress_modes: int


def free_motions(structure: Structure, nodes: ArrayLike | None = None) -> Array:
    """Node displacements (3N, q) of a unit of each free coordinate; nodes (N, 3) [m], the reference by default."""
    positions = _nodes(structure, nodes)
    motions, apart = _motions_of_ends(structure, positions)
    if not len(apart):
        return motions
    _, singular, right = np.linalg.svd(apart @ motions)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
    return np.asarray(motions[: 3 * len(positions)] @ right[rank:].T)


def _ends(structure: Structure) -> tuple[NDArray[np.int64], list[int]]:
    """Where the ends of each rod are (R, 2), and what nodes the ones beyond the N nodes are copies of.

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
    """How N nodes and C copies move (3N + 3C, p) as if rods were apart, and how far copies are off (3C, 3N + 3C)."""
    ends, copied = _ends(structure)
    count = len(positions) + len(copied)
    columns: list[Array] = []

    def add(weights: dict[int, float], directions: Array) -> None:
        for direction in directions.T:
            motion = np.zeros((count, 3))
            for row, weight in weights.items():
                motion[row] = weight * direction
            columns.append(motion.ravel())

    spans = positions[structure.rod_nodes[:, 1]] - positions[structure.rod_nodes[:, 0]]
    for rod, (i, j), span in zip(structure.rods, ends.tolist(), spans, strict=True):
        sigma = rod.support.sigma
        add({i: 1.0, j: 1.0}, rod.support.translation_basis)
        add({i: -sigma, j: 1.0 - sigma}, _turning_basis(span, rod.support.plane))
    for point in structure.point_masses:
        add({structure.node_index[point.node]: 1.0}, point.translation_basis)
    apart = np.zeros((len(copied), count))
    apart[np.arange(len(copied)), len(positions) + np.arange(len(copied))] = 1.0
    apart[np.arange(len(copied)), copied] -= 1.0
    apart = np.asarray(np.kron(apart, np.eye(3)), float)
    return np.array(columns).T, apart


def equilibrium_matrix(structure: Structure, nodes: ArrayLike | None = None) -> Array:
    """A (q, M) [m]: forces [N] on the free coordinates of unit force densities [N/m] of the strings."""
    positions = _nodes(structure, nodes)
    return free_motions(structure, positions).T @ _string_forces(structure, positions)


def equilibrium_residual(
    structure: Structure,
    nodes: ArrayLike | None,
    force_densities: ArrayLike,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
) -> Array:
    """(q,) [N]: the forces that are left on the free coordinates; zero in equilibrium.

    Args:
        nodes: (N, 3) [m]; None for the reference.
        force_densities: u (M,) [N/m].
        gravity: (3,) [m/s²]; a rod's weight acts half at each of its nodes.
        loads: (N, 3) [N].
    """
    positions = _nodes(structure, nodes)
    u = _per_string(structure, force_densities)
    forces = _string_forces(structure, positions) @ u + _loads(structure, gravity, loads).ravel()
    residual: Array = free_motions(structure, positions).T @ forces
    return residual


def static_forces(
    structure: Structure,
    force_densities: ArrayLike,
    nodes: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
) -> StaticForces:
    """Rod forces and support reactions in an equilibrium; arguments as `equilibrium_residual`."""
    positions = _nodes(structure, nodes)
    u = _per_string(structure, force_densities)
    forces = (_string_forces(structure, positions) @ u).reshape(-1, 3) + _loads(structure, gravity, loads)
    count = len(structure.rods)
    densities, supports, moments = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3))
    anchors = np.zeros_like(forces)
    ends, copied = _ends(structure)
    spans = positions[structure.rod_nodes[:, 1]] - positions[structure.rod_nodes[:, 0]]
    if len(copied):
        # What a joint's rods pass on to each other is what leaves each of them in balance.
        motions, apart = _motions_of_ends(structure, positions)
        forces = np.concatenate([forces, np.zeros((len(copied), 3))])
        passed = np.linalg.lstsq((apart @ motions).T, -motions.T @ forces.ravel(), rcond=RANK_TOLERANCE)[0]
        forces = forces + (apart.T @ passed).reshape(-1, 3)
    for number, (rod, (i, j), span) in enumerate(zip(structure.rods, ends.tolist(), spans, strict=True)):
        support = rod.support
        turning = (1.0 - support.sigma) * forces[j] - support.sigma * forces[i]
        densities[number] = span @ turning / (span @ span)
        supports[number] = -_held(support.translation_basis, forces[i] + forces[j])
        if support.plane is not None:
            moments[number] = -np.cross(span, _held(support.rotation_basis, turning))
    for name in structure.fixed_nodes:
        anchors[structure.node_index[name]] = -forces[structure.node_index[name]]
    for point in structure.point_masses:
        row = structure.node_index[point.node]
        anchors[row] = -_held(point.translation_basis, forces[row])
    return StaticForces(densities, supports, moments, anchors)


def self_stress(
    structure: Structure,
    nodes: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
) -> SelfStress:
    """Self-stress modes and mechanisms, by the singular values of A; arguments as `equilibrium_residual`."""
    positions = _nodes(structure, nodes)
    motions = free_motions(structure, positions)
    matrix, external = _equations(structure, positions, motions, gravity, loads)
    states = _solve(matrix, external)
    rigid = _rigid_motions(positions, motions)
    return SelfStress(
        modes=states.modes,
        forces=tuple(static_forces(structure, mode, positions) for mode in states.modes),
        particular=states.particular,
        residual=states.residual,
        free_coordinates=len(matrix),
        rigid_motions=rigid,
        mechanisms=len(matrix) - (matrix.shape[1] - len(states.modes)) - rigid,
        singular_values=states.singular_values,
    )


def prestress(
    structure: Structure,
    level: float = 1.0,
    nodes: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
    slack: Sequence[str] = (),
) -> Array:
    """Force densities u (M,) [N/m] in equilibrium, none below `level` [N/m] but those of the `slack` strings, 0.

    Of all such states it is the one of the smallest sum of u². That one is unique: a symmetric structure gets a
    symmetric prestress, and moving the whole changes nothing. All of it holds to round-off. `slack` names strings;
    the other arguments are as in `equilibrium_residual`.

    Raises:
        InfeasibleError: if there is none; it says which strings cannot be in tension, and why.
        OptionError: if the level is not positive, or a name in `slack` unknown.
    """
    if not isinstance(level, (int, float, np.integer, np.floating)) or not 0.0 < level < np.inf:
        raise OptionError(f"level = {level!r}; it must be a number > 0 N/m")
    tight = ~_chosen(structure, slack)
    positions = _nodes(structure, nodes)
    motions, forces = free_motions(structure, positions), _loads(structure, gravity, loads)
    matrix, external = _equations(structure, positions, motions, gravity, loads)
    states = _solve(matrix[:, tight], external)
    # Not the norm of `external`: supports may take all of the weight, and leave its round-off.
    weight = float(np.linalg.norm(forces))
    unbalanced = float(np.linalg.norm(states.residual))
    if unbalanced > RANK_TOLERANCE * weight:
        push, masses = _driven(motions, forces), lumped_masses(structure)
        falling = forces - masses[:, None] * push / masses.sum()
        if np.any(push) and np.linalg.norm(_solve(matrix[:, tight], motions.T @ falling.ravel()).residual) < (
            RANK_TOLERANCE * weight
        ):
            sizes = ", ".join(f"{size:.6g}" for size in push)
            raise InfeasibleError(
                f"structure '{structure.name}': gravity and loads push the whole with ({sizes}) N, and nothing holds "
                "it; leave gravity out (gravity=None) where it falls freely, or give it supports where it stands"
            )
        raise InfeasibleError(
            f"structure '{structure.name}': {unbalanced:.3g} N of gravity and loads push along motions that no string "
            "resists; add strings or supports against them"
        )
    shift = _least_distance(states.modes.T, (level - states.particular) / level)
    if shift is None:
        names = [string.name for string, is_tight in zip(structure.strings, tight, strict=True) if is_tight]
        raise InfeasibleError(_why_infeasible(structure.name, names, states, level, loaded=weight > 0))
    u = np.zeros(len(tight))
    u[tight] = states.particular + level * (states.modes.T @ shift)
    return u


def with_prestress(
    structure: Structure,
    level: float = 1.0,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
    slack: Sequence[str] = (),
) -> Structure:
    """A copy whose strings' force densities hold its reference nodes in equilibrium, see `prestress`.

    The `slack` strings become just taut, without tension.

    Raises:
        InfeasibleError: if there is no such state.
        OptionError: as `prestress`, or if the level needs a string to start from no rest length (u >= k).
    """
    u = prestress(structure, level, gravity=gravity, loads=loads, slack=slack)
    use = u / structure.stiffness
    if np.any(use >= 1.0):
        worst = int(np.argmax(use))
        raise OptionError(
            f"level = {level} N/m gives string '{structure.strings[worst].name}' a force density of "
            f"{u[worst]:.6g} N/m, but its stiffness is {structure.stiffness[worst]:.6g} N/m: its rest length would "
            "not be positive; choose a lower level or stiffer strings"
        )
    return structure.with_strings(force_density=u)


def equilibrium_force_densities(
    structure: Structure,
    nodes: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    loads: ArrayLike | None = None,
) -> Equilibrium:
    """Force densities u >= 0 that come closest to equilibrium (non-negative least squares).

    Without gravity and loads that is u = 0: every configuration is an equilibrium of slack strings, and only
    the number of self-stress modes tells more. Arguments as `equilibrium_residual`.
    """
    from scipy.optimize import nnls

    positions = _nodes(structure, nodes)
    matrix, external = _equations(structure, positions, free_motions(structure, positions), gravity, loads)
    modes = len(_solve(matrix, external).modes)
    if not structure.strings:
        return Equilibrium(np.zeros(0), float(np.linalg.norm(external)), modes)
    u, residual = nnls(matrix, -external)
    return Equilibrium(u, float(residual), modes)


class _States(NamedTuple):
    """All u with A u + f = 0: particular + any combination of modes (S, M); what no u balances is the residual."""

    modes: Array
    particular: Array
    residual: Array
    singular_values: Array


def _equations(
    structure: Structure, positions: Array, motions: Array, gravity: ArrayLike | None, loads: ArrayLike | None
) -> tuple[Array, Array]:
    """A (q, M) and f (q,) of A u + f = 0."""
    return motions.T @ _string_forces(structure, positions), motions.T @ _loads(structure, gravity, loads).ravel()


def _solve(matrix: Array, external: Array) -> _States:
    left, singular, right = np.linalg.svd(matrix)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0])) if singular.size and singular[0] > 0 else 0
    modes = right[rank:]
    modes = modes * np.where(modes.sum(axis=1) < 0, -1.0, 1.0)[:, None]
    particular = -right[:rank].T @ (left[:, :rank].T @ external / singular[:rank])
    return _States(modes, particular, matrix @ particular + external, singular)


def _least_distance(matrix: Array, lower: Array) -> Array | None:
    """The shortest x with matrix @ x >= lower, or None if there is none.

    It is the dual of a non-negative least squares problem (Lawson and Hanson, Solving Least Squares Problems,
    chapter 23), which an active set method solves to round-off in finitely many steps.
    """
    from scipy.optimize import nnls

    if not _is_feasible(matrix, lower):
        return None
    size = matrix.shape[1]
    if len(lower) == 0 or np.all(lower <= 0.0):
        return np.zeros(size)
    goal = np.zeros(size + 1)
    goal[-1] = 1.0
    dual, _ = nnls(np.vstack([matrix.T, lower]), goal)
    rest = np.append(matrix.T @ dual, lower @ dual - 1.0)
    return -rest[:-1] / rest[-1]


def _is_feasible(matrix: Array, lower: Array) -> bool:
    from scipy.optimize import linprog

    if matrix.shape[1] == 0:
        return bool(np.all(lower <= RANK_TOLERANCE))
    result = linprog(np.zeros(matrix.shape[1]), A_ub=-matrix, b_ub=-lower, bounds=(None, None), method="highs")
    return result.status == 0


def _why_infeasible(name: str, strings: list[str], states: _States, level: float, loaded: bool) -> str:
    if loaded:
        best, deciding = _largest_minimum(states)
        remedy = "choose a lower level" if best > 0 else "add strings, or move nodes"
        return (
            f"structure '{name}': under gravity and loads the smallest force density is at most {best:.6g} N/m (in "
            f"{_listed(strings, deciding)}), below the level {level:.6g} N/m; {remedy}"
        )
    if len(states.modes) == 0:
        message = (
            f"structure '{name}' has no self-stress: its {len(strings)} strings resist independent motions of its "
            f"{len(states.residual)} free coordinates, so that none can be tightened against the others; "
            "add strings or change the nodes"
        )
        values = states.singular_values
        if values.size and values[-1] < 1e-2 * values[0]:
            message += (
                f". It is close to having one (smallest singular value {values[-1] / values[0]:.1e} of the largest): "
                "if these nodes are meant to be in equilibrium, give them all 17 digits"
            )
        return message
    return (
        f"structure '{name}' has no prestress with every string in tension: {_listed(strings, ~_can_be_tight(states))} "
        "can carry none while no string pushes, since a motion of the nodes lengthens each of them and shortens no "
        "string (or the reverse); leave them slack (slack=[...]), move the nodes, or add strings against that motion"
    )


def _can_be_tight(states: _States) -> NDArray[np.bool_]:
    """(M,): whether a string can be in tension in a self-stress without any string pushing.

    Such states form a cone, so that the state with the most strings above 1 has them all: a linear program.
    """
    from scipy.optimize import linprog

    modes = states.modes
    size, count = modes.shape
    result = linprog(
        np.concatenate([np.zeros(size), -np.ones(count)]),
        A_ub=np.hstack([-modes.T, np.eye(count)]),
        b_ub=np.zeros(count),
        bounds=[(None, None)] * size + [(0.0, 1.0)] * count,
        method="highs",
    )
    return np.asarray(result.x[size:] > 0.5)


def _largest_minimum(states: _States) -> tuple[float, NDArray[np.bool_]]:
    """The largest possible smallest force density [N/m] under the loads, and which strings decide it."""
    from scipy.optimize import linprog

    size, count = states.modes.shape
    result = linprog(
        np.append(np.zeros(size), -1.0),
        A_ub=np.hstack([-states.modes.T, np.ones((count, 1))]),
        b_ub=states.particular,
        bounds=(None, None),
        method="highs",
    )
    return float(-result.fun), np.abs(result.ineqlin.marginals) > 1e-9


def _rigid_motions(positions: Array, motions: Array) -> int:
    """How many independent motions of all nodes as one body lie in the span of the given ones (3N, q)."""
    offsets = positions - positions.mean(axis=0)
    scale = float(np.abs(offsets).max()) or 1.0
    turns = [np.cross(axis, offsets / scale) for axis in np.eye(3)]
    shifts = [np.broadcast_to(axis, offsets.shape) for axis in np.eye(3)]
    bodies = np.array([motion.ravel() for motion in shifts + turns]).T
    left, singular, _ = np.linalg.svd(bodies, full_matrices=False)
    bodies = left[:, singular > RANK_TOLERANCE * singular[0]]  # nodes on one line: turning about it moves none
    span, _ = np.linalg.qr(motions)
    outside = np.linalg.svd(bodies - span @ (span.T @ bodies), compute_uv=False)
    return int(np.sum(outside < 1e-7))  # an orthonormal basis: 0 inside the span, up to 1 outside


def _driven(motions: Array, forces: Array) -> Array:
    """(3,) [N]: forces (N, 3) along the straight lines on which motions (3N, q) let the whole go; zero for none."""
    shifts = np.tile(np.eye(3), (len(forces), 1)) / np.sqrt(len(forces))
    span, _ = np.linalg.qr(motions)
    _, outside, right = np.linalg.svd(shifts - span @ (span.T @ shifts))
    free = right[outside < 1e-7]
    push = free.T @ (free @ forces.sum(axis=0))
    return np.where(np.abs(push) > RANK_TOLERANCE * np.linalg.norm(forces), push, 0.0)


def _string_forces(structure: Structure, positions: Array) -> Array:
    """Forces on the nodes (3N, M) of unit force densities: each end is pulled towards the other."""
    pairs = structure.string_nodes
    spans = positions[pairs[:, 1]] - positions[pairs[:, 0]]
    forces = np.zeros((len(positions), 3, len(pairs)))
    columns = np.arange(len(pairs))
    forces[pairs[:, 0], :, columns] = spans
    forces[pairs[:, 1], :, columns] = -spans
    return forces.reshape(3 * len(positions), len(pairs))


def _loads(structure: Structure, gravity: ArrayLike | None, loads: ArrayLike | None) -> Array:
    """External forces and weights on the nodes (N, 3) [N]."""
    count = len(structure.nodes)
    forces = np.zeros((count, 3)) if loads is None else array_of_shape("loads", loads, (count, 3), broadcast=False)
    if gravity is not None:
        weights = lumped_masses(structure)[:, None] * array_of_shape("gravity", gravity, (3,), broadcast=False)
        forces = forces + weights
    return forces


def _nodes(structure: Structure, nodes: ArrayLike | None) -> Array:
    if nodes is None:
        return structure.positions
    return array_of_shape("nodes", nodes, (len(structure.nodes), 3), broadcast=False)


def _per_string(structure: Structure, force_densities: ArrayLike) -> Array:
    count = len(structure.strings)
    return np.broadcast_to(array_of_shape("force_densities", force_densities, (count,)), (count,))


def _turning_basis(span: Array, plane: Sequence[float] | None) -> Array:
    """Orthonormal basis of the directions in which b = span / ℓ can turn: (3, 2), or (3, 1) in a plane."""
    return null_space_basis(np.array([span] if plane is None else [span, plane], float))


def _held(free: Array, force: Array) -> Array:
    """The part of a force outside the span of an orthonormal basis (3, d): what the support takes."""
    return force - free @ (free.T @ force)


def _chosen(structure: Structure, names: Sequence[str]) -> NDArray[np.bool_]:
    """(M,): whether a string is among the named ones."""
    known = [string.name for string in structure.strings]
    for name in [names] if isinstance(names, str) else names:
        if name not in known:
            raise OptionError(f"slack: unknown string {name!r}; {_listed(known, np.ones(len(known), bool))} are known")
    return np.isin(known, list(names)) if names else np.zeros(len(known), bool)


def _listed(names: list[str], chosen: NDArray[np.bool_]) -> str:
    found = [f"'{name}'" for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    shown = ", ".join(found[:12]) + ("" if len(found) <= 12 else f", ... ({len(found)} in all)")
    return f"string{'s' if len(found) > 1 else ''} {shown}"
