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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import real_array
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.rigidity import (
    RANK_TOLERANCE,
    StaticForces,
    _equations,
    _loads,
    _nodes,
    _rigid_motions,
    _solve,
    _States,
    free_motions,
    static_forces,
)
from tensegrity_mj.model.rods import lumped_masses
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Boundary, Hold
from tensegrity_mj.statics.model import Members, StaticModel
from tensegrity_mj.statics.prestressability import RANK, Flags, Prestressability, Verdict, _members, _rank
from tensegrity_mj.statics.state import StaticState


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


def _driven(motions: Array, forces: Array) -> Array:
    """(3,) [N]: forces (N, 3) along the straight lines on which motions (3N, q) let the whole go; zero for none."""
    shifts = np.tile(np.eye(3), (len(forces), 1)) / np.sqrt(len(forces))
    span, _ = np.linalg.qr(motions)
    _, outside, right = np.linalg.svd(shifts - span @ (span.T @ shifts))
    free = right[outside < 1e-7]
    push = free.T @ (free @ forces.sum(axis=0))
    return np.where(np.abs(push) > RANK_TOLERANCE * np.linalg.norm(forces), push, 0.0)


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


POSITIVE = 1e-8  # of the largest eigenvalue of the form in any unit state: below it, a stiffness is none


CUTS = 300


FAR = 1e6  # [N] weights of states: those of rods alone have no limit from strings


GAP = 1e-3  # of the bound, where the search for the stiffest prestress may stop


def prestressability(
    source: Structure | Scene | StaticModel | StaticState,
    *,
    nodes: ArrayLike | None = None,
    holds: Sequence[Hold] = (),
) -> Prestressability:
    """What a structure at given nodes can carry by itself, whatever its supports and joints.

    Args:
        source: a structure at its reference nodes; a scene at its start; a model at its start, with its holds and
            without its broken strings; or a state, whose own forces are then the prestress that is judged. (Under loads
            these are no state of self-stress; what they do to mechanisms is the same sum.)
        nodes: (N, 3) [m] instead of these; not with a state.
        holds: further nodes that are held; not with a model or a state, which have their own.

    Raises:
        OptionError: for arguments that do not fit, and members without length.
    """
    tensions = forces = None
    if isinstance(source, StaticState):
        if nodes is not None:
            raise OptionError("prestressability: nodes: a state has its own; leave them out, or give its model")
        model, places = source.model, source.nodes
        tensions, forces = source.tensions, source.rod_forces
    else:
        if not isinstance(source, (Structure, Scene, StaticModel)):
            raise OptionError(
                f"prestressability of {source!r}: use a Structure, a Scene, a StaticModel or a StaticState"
            )
        model = source if isinstance(source, StaticModel) else StaticModel.of(source, holds=holds)
        shape = (len(model.structure.nodes), 3)
        places = model.start if nodes is None else real_array("nodes", nodes, shape, "m", scalar=False)
    if holds and isinstance(source, (StaticModel, StaticState)):
        raise OptionError("prestressability: holds: a model has its own; leave them out, or give its scene")
    problem = _Problem.of(model.structure, model.boundary, np.array(places, float), model.stiffness > 0)
    own = None if tensions is None or forces is None else np.concatenate([tensions, forces])
    return problem.solved(own)


class _Best(NamedTuple):
    """The stiffest state that was found: its weights (S,), what it is worth, and what none is worth more than."""

    weights: Array | None
    value: float
    bound: float


@dataclass(frozen=True, eq=False)
class _Problem:
    """B at some nodes, and its null spaces."""

    structure: Structure
    boundary: Boundary
    nodes: Array
    whole: Flags  # (M,) strings that are not broken
    strings: Members
    rods: Members
    B: Array  # (M + R, q)

    @classmethod
    def of(cls, structure: Structure, boundary: Boundary, nodes: Array, whole: Flags) -> _Problem:
        strings, rods = _members(structure, nodes)
        for members, found in ((structure.strings, strings), (structure.rods, rods)):
            if len(members) and found.lengths.min() == 0:
                name = members[int(found.lengths.argmin())].name
                raise OptionError(f"'{name}' has no length at these nodes, and so no direction: look at other nodes")
        pairs = np.concatenate([structure.string_nodes, structure.rod_nodes])
        directions = np.concatenate([strings.directions, rods.directions])
        slopes = np.zeros((len(pairs), len(nodes), 3))
        rows = np.arange(len(pairs))
        slopes[rows, pairs[:, 0]], slopes[rows, pairs[:, 1]] = -directions, directions
        slopes[: len(whole)][~whole] = 0.0
        B = np.asarray((boundary.Z.T @ slopes.reshape(len(pairs), -1).T).T)
        return cls(structure, boundary, nodes, whole, strings, rods, B)

    def solved(self, own: Array | None) -> Prestressability:
        """All of it, for the forces (M + R,) of a state, or for the stiffest prestress."""
        M, Z = len(self.whole), self.boundary.Z
        there = np.append(self.whole, np.ones(len(self.B) - M, bool))
        left, values, right = (np.asarray(part, float) for part in np.linalg.svd(self.B[there]))
        rank = _rank(values)
        states = np.zeros((len(left) - rank, len(self.B)))
        states[:, there] = left[:, rank:].T
        states *= np.where(states[:, :M].sum(axis=1) < 0, -1.0, 1.0)[:, None]
        bodies = self._bodies()
        mechanisms = Z @ _across(right[rank:].T, Z.T @ bodies)
        can_pull = self._can_pull(states)
        can_push, all_push = self._can_push(states, can_pull)
        obstacle = None if can_pull[self.whole].all() else self._obstacle(~can_pull & self.whole)
        taut = can_pull if own is None else (own[:M] > 0) & self.whole
        loose = self._loose(taut, bodies)
        prestress, bound, stability = own, float("nan"), (Verdict.NOT_APPLICABLE, "")
        if own is None:
            prestress, bound, stability = self._stiffest(states, can_pull, loose)
        stiffness: Array = np.zeros(0)
        if prestress is not None and loose.shape[1]:
            form = self._form(prestress, loose)
            stiffness = np.asarray(np.linalg.eigvalsh(form), float)
        if own is not None:
            stability = self._judged(own, stiffness)
        superb = self._super_stable(states, can_pull, own)
        return Prestressability(
            structure=self.structure,
            nodes=self.nodes,
            free_coordinates=Z.shape[1],
            singular_values=values,
            self_stress=states,
            rigid_motions=bodies,
            mechanisms=np.asarray(mechanisms),
            can_pull=can_pull,
            can_push=can_push,
            all_can_push=all_push,
            obstacle=obstacle,
            prestress=prestress,
            own=own is not None,
            taut_mechanisms=loose,
            prestress_stiffness=stiffness,
            stiffness_bound=bound,
            stress_matrix=self._stress_matrix(np.zeros(len(self.B)) if prestress is None else prestress),
            prestress_stable=stability[0],
            super_stable=superb[0],
            reasons=(stability[1], superb[1]),
        )

    # ------------------------------------------------------------------------------------------------------- motions

    def _bodies(self) -> Array:
        """Orthonormal motions (3N, p) of the whole as one body that go on, as far as supports and holds leave them.

        A turn is one of them where what holds the nodes turns into itself: where it does not, the nodes leave the
        circle, and the motion is a mechanism of the structure and its supports.
        """
        nodes, G, Z = self.nodes, self.boundary.rows, self.boundary.Z
        center = nodes.mean(axis=0)
        size = float(np.abs(nodes - center).max()) or 1.0
        shifts = [np.broadcast_to(axis, nodes.shape) for axis in np.eye(3)]
        turns = [np.cross(axis, (nodes - center) / size) for axis in np.eye(3)]
        bodies = np.array([motion.ravel() for motion in (*shifts, *turns)]).T
        rows = [np.zeros((6, 6)), np.asarray(G @ bodies)]
        if G.shape[0]:
            held = G.toarray().reshape(G.shape[0], -1, 3)
            turned = np.zeros((6, *held.shape))
            for k, axis in enumerate(np.eye(3)):
                turned[3 + k] = np.cross(axis, held)
            rows.append(
                (Z.T @ turned.reshape(6 * G.shape[0], -1).T)
                .reshape(-1, 6, G.shape[0])
                .transpose(0, 2, 1)
                .reshape(-1, 6)
            )
        _, values, right = np.linalg.svd(np.vstack(rows), full_matrices=False)
        left, size_of, _ = np.linalg.svd(bodies @ right[values < 1e-7].T, full_matrices=False)
        return np.asarray(left[:, size_of > 1e-9])

    def _loose(self, taut: Flags, bodies: Array) -> Array:
        """(3N, k) what neither rods nor taut strings resist, to first order, motions of the whole apart."""
        Z, M = self.boundary.Z, len(taut)
        rows = np.concatenate([self.B[:M][taut], self.B[M:]])
        _, values, right = np.linalg.svd(rows) if len(rows) else (None, np.zeros(0), np.eye(Z.shape[1]))
        return np.asarray(Z @ _across(right[_rank(values) :].T, Z.T @ bodies))

    # --------------------------------------------------------------------------------------------------------- signs

    def _can_pull(self, states: Array) -> Flags:
        """(M,): states in which no string pushes are a cone; the one with the most strings above 1 has them all."""
        size, M = len(states), len(self.whole)
        if not size or not M:
            return np.zeros(M, bool)
        result = _program(
            np.concatenate([np.zeros(size), -np.ones(M)]),
            np.hstack([-states[:, :M].T, np.eye(M)]),
            np.zeros(M),
            bounds=[(None, None)] * size + [(0.0, 1.0)] * M,
        )
        return np.asarray(result.x[size:] > 0.5)

    def _can_push(self, states: Array, can_pull: Flags) -> tuple[Flags, bool]:
        """(R,) each by itself, and whether all can at once, while no string pushes.

        To any such state, some of one in which every string that can pull does may be added: that one then pulls too.
        """
        size, M = len(states), len(self.whole)
        count = len(self.B) - M
        found = np.zeros(count, bool)
        if not can_pull.any() or not count:
            return found, False
        kept, wanted = -states[:, :M].T, states[:, M:].T
        together = _program(
            np.append(np.zeros(size), -1.0),
            np.vstack([np.append(kept, np.zeros((M, 1)), axis=1), np.append(wanted, np.ones((count, 1)), axis=1)]),
            np.zeros(M + count),
            bounds=[(None, None)] * size + [(None, 1.0)],
        )
        if together.x[-1] > 0.5:
            return np.ones(count, bool), True
        for row in range(count):
            limits = np.append(np.zeros(M), 1.0)
            result = _program(wanted[row], np.vstack([kept, -wanted[row]]), limits, bounds=(-FAR, FAR))
            found[row] = bool(result.fun < -0.5)
        return found, False

    def _obstacle(self, barred: Flags) -> Array:
        """The certificate of the strings that cannot pull: a motion (3N,)."""
        M, q = len(self.whole), self.B.shape[1]
        count, strings = int(barred.sum()), self.B[:M][self.whole]
        chosen = barred[self.whole]
        pick = np.zeros((len(strings), count))
        pick[np.flatnonzero(chosen), np.arange(count)] = 1.0
        result = _program(
            np.concatenate([np.zeros(q), -np.ones(count)]),
            np.hstack([-strings, pick]),
            np.zeros(len(strings)),
            kept=np.hstack([self.B[M:], np.zeros((len(self.B) - M, count))]),
            bounds=[(None, None)] * q + [(0.0, 1.0)] * count,
        )
        motion = np.asarray(self.boundary.Z @ result.x[:q])
        return motion / (float(np.linalg.norm(motion.reshape(-1, 3), axis=1).max()) or 1.0)

    # --------------------------------------------------------------------------------------------------- stiffening

    def _form(self, forces: Array, motions: Array) -> Array:
        """(k, k) [N/m]: Σ t/L (v·v - (v·s)²) of the members' relative motions v, for motions (3N, k)."""
        return np.asarray(np.einsum("t,tmn->mn", forces, self._forms(motions)))

    def _forms(self, motions: Array) -> Array:
        """(M + R, k, k) [1/m] the same for 1 N in each member."""
        pairs = np.concatenate([self.structure.string_nodes, self.structure.rod_nodes])
        lengths = np.concatenate([self.strings.lengths, self.rods.lengths])
        directions = np.concatenate([self.strings.directions, self.rods.directions])
        moved = motions.reshape(len(self.nodes), 3, -1)
        apart = moved[pairs[:, 1]] - moved[pairs[:, 0]]
        along = np.einsum("tx,txm->tm", directions, apart)
        square = np.einsum("txm,txn->tmn", apart, apart) - along[:, :, None] * along[:, None, :]
        return np.asarray(square / lengths[:, None, None])

    def _stress_matrix(self, forces: Array) -> Array:
        pairs = np.concatenate([self.structure.string_nodes, self.structure.rod_nodes])
        density = forces / np.concatenate([self.strings.lengths, self.rods.lengths])
        C = np.zeros((len(pairs), len(self.nodes)))
        rows = np.arange(len(pairs))
        C[rows, pairs[:, 0]], C[rows, pairs[:, 1]] = -1.0, 1.0
        return np.asarray(C.T @ (density[:, None] * C))

    def _stiffest(
        self, states: Array, can_pull: Flags, loose: Array
    ) -> tuple[Array | None, float, tuple[Verdict, str]]:
        """The prestress (M + R,), the bound of all, and the verdict."""
        M, k = len(can_pull), loose.shape[1]
        if not can_pull.any():
            if k == 0:
                return None, float("nan"), (Verdict.YES, "rods and supports alone leave no mechanism")
            return None, float("nan"), (Verdict.NO, "no string can pull, and rods and supports alone leave motions")
        middle = self._middle(states, can_pull)
        if k == 0:
            why = "no mechanism is left, and every string of it pulls"
            why = why if can_pull.all() else "those strings that can pull leave no mechanism by themselves"
            return middle, float("nan"), (Verdict.YES, why)
        forms = np.einsum("st,tmn->smn", states, self._forms(loose))
        scale = float(np.abs(forms).max(initial=0.0))
        best = _maximized(forms, states[:, :M].T, scale)
        least = POSITIVE * scale
        if best.weights is None or best.bound <= least:
            why = f"no prestress of 1 N at most stiffens some motion by more than {max(best.bound, 0.0):.2g} N/m"
            return middle, best.bound, (Verdict.NO, why + " (a bound over all of them)")
        chosen = self._blended(states.T @ best.weights, middle, loose, best.value)
        if best.value > least:
            slack = "" if can_pull.all() else ", with the strings that cannot pull left slack"
            return chosen, best.bound, (Verdict.YES, f"the prestress found stiffens every mechanism{slack}")
        return (
            chosen,
            best.bound,
            (Verdict.UNDECIDED, f"the best found is {best.value:.2g} N/m, none above {best.bound:.2g}"),
        )

    def _middle(self, states: Array, can_pull: Flags) -> Array:
        """A state (M + R,) [N] with all strings that can pull as far from slack as they can be, the largest 1 N."""
        M, size = len(can_pull), len(states)
        pulls = states[:, :M].T
        above = np.append(-pulls, can_pull[:, None].astype(float), axis=1)
        below = np.append(pulls, np.zeros((M, 1)), axis=1)
        limits = np.concatenate([np.zeros(M), np.ones(M)])
        result = _program(np.append(np.zeros(size), -1.0), np.vstack([above, below]), limits)
        return np.asarray(states.T @ result.x[:size])

    def _blended(self, best: Array, middle: Array, loose: Array, value: float) -> Array:
        """As much of the middle as leaves half of the stiffness, so that no string is slack that need not be."""
        if value <= 0:
            return best
        part = 1.0
        for _ in range(20):
            mixed = (1 - part) * best + part * middle
            if np.linalg.eigvalsh(self._form(mixed, loose))[0] >= 0.5 * value:
                break
            part /= 2
        return np.asarray(mixed / mixed[: len(self.whole)].max())

    def _judged(self, own: Array, stiffness: Array) -> tuple[Verdict, str]:
        """Whether a state's own forces hold its mechanisms."""
        if not len(stiffness):
            return Verdict.YES, "taut strings and rods leave no mechanism"
        scale = float(np.abs(own).max(initial=0.0)) / float(
            np.concatenate([self.strings.lengths, self.rods.lengths]).mean()
        )
        if stiffness[0] > POSITIVE * scale:
            return Verdict.YES, "the state's own forces stiffen every mechanism"
        if stiffness[0] < -POSITIVE * scale:
            return Verdict.NO, "the state's own forces drive a mechanism on"
        return Verdict.UNDECIDED, "the state's own forces leave a mechanism as it is, within round-off"

    def _super_stable(self, states: Array, can_pull: Flags, own: Array | None) -> tuple[Verdict, str]:
        if self.boundary.rows.shape[0]:
            return Verdict.NOT_APPLICABLE, "it is defined for structures without supports"
        if not can_pull.any():
            return Verdict.NO, "no string can pull"
        centered = self.nodes - self.nodes.mean(axis=0)
        _, spread, axes = np.linalg.svd(centered)
        d = int(np.sum(spread > RANK * spread[0]))
        affine = np.column_stack([np.ones(len(centered)), centered @ axes[:d].T])
        across = np.linalg.svd(affine)[0][:, d + 1 :]  # (N, N - d - 1)
        directions = np.concatenate([self.strings.directions, self.rods.directions]) @ axes[:d].T
        i, j = np.triu_indices(d)
        used = np.concatenate([can_pull, np.ones(len(self.rods.lengths), bool)])
        conic = np.linalg.svd((directions[:, i] * directions[:, j])[used], compute_uv=False)
        if int(np.sum(conic > RANK * conic[0])) < len(i):
            return Verdict.NO, "the directions of its members lie on a conic at infinity"
        if not across.shape[1]:
            return Verdict.YES, "its nodes are those of a simplex"
        if own is not None:
            form = np.linalg.eigvalsh(across.T @ self._stress_matrix(own) @ across)
            scale = float(np.abs(form).max())
            if form[0] > POSITIVE * scale:
                return Verdict.YES, "its stress matrix is positive semidefinite of the largest rank"
            verdict = Verdict.NO if form[0] < -POSITIVE * scale else Verdict.UNDECIDED
            return (
                verdict,
                f"the lowest eigenvalue of its own stress matrix, affine motions apart, is {form[0]:.2g} N/m",
            )
        forms = np.array([across.T @ self._stress_matrix(state) @ across for state in states])
        scale = float(np.abs(forms).max(initial=0.0))
        best = _maximized(forms, states[:, : len(can_pull)].T, scale)
        if best.value > POSITIVE * scale:
            return Verdict.YES, "a prestress has a stress matrix that is positive semidefinite of the largest rank"
        if best.bound <= POSITIVE * scale:
            return Verdict.NO, "no prestress has such a stress matrix (a bound over all of them)"
        return Verdict.UNDECIDED, f"the best stress matrix found has {best.value:.2g} N/m, none above {best.bound:.2g}"


def _maximized(forms: Array, pulls: Array, scale: float) -> _Best:
    """The weights a (S,) with the largest lowest eigenvalue of Σ a forms (S, k, k), for 0 <= pulls @ a (M,) <= 1.

    Cutting planes: wᵀ (Σ a forms) w is above the lowest eigenvalue for every unit w. Each round's linear program bounds
    all states by the planes of the eigenvectors so far, and its solution is a state.
    """
    size, k = forms.shape[:2]
    if not size or not k or scale == 0:
        return _Best(None, 0.0, 0.0)
    rows = np.einsum("smm->ms", forms)  # the first planes: the coordinates
    best, value, bound = None, -np.inf, np.inf
    sides = np.vstack([-pulls, pulls])
    limits = np.concatenate([np.zeros(len(pulls)), np.ones(len(pulls))])
    for _ in range(CUTS):
        planes = np.append(-rows / scale, np.ones((len(rows), 1)), axis=1)
        result = _program(
            np.append(np.zeros(size), -1.0),
            np.vstack([planes, np.append(sides, np.zeros((len(sides), 1)), axis=1)]),
            np.concatenate([np.zeros(len(rows)), limits]),
            bounds=[(-FAR, FAR)] * size + [(None, None)],
        )
        weights = result.x[:size]
        bound = min(bound, float(result.x[-1]) * scale)
        values, vectors = np.linalg.eigh(np.einsum("s,smn->mn", weights, forms))
        if values[0] > value:
            best, value = weights, float(values[0])
        if bound <= POSITIVE * scale or (value > 0 and bound - value <= GAP * bound) or bound - value <= 1e-12 * scale:
            break
        new = vectors[:, : min(k, 8)]
        rows = np.vstack([rows, np.einsum("mi,smn,ni->is", new, forms, new)])
    return _Best(best, value, bound)


def _program(cost: Array, rows: Array, limits: Array, *, kept: Array | None = None, bounds: Any = (None, None)) -> Any:
    """The least cost @ x for rows @ x <= limits and kept @ x = 0."""
    from scipy.optimize import linprog

    equal = None if kept is None or not len(kept) else kept
    result = linprog(
        cost,
        A_ub=rows,
        b_ub=limits,
        A_eq=equal,
        b_eq=None if equal is None else np.zeros(len(equal)),
        bounds=bounds,
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if result.status != 0:
        raise InfeasibleError(f"a linear program over states of self-stress was not solved: {result.message}")
    return result


def _across(span: Array, others: Array) -> Array:
    """An orthonormal basis of what an orthonormal span (q, a) has across orthonormal columns (q, b) that lie in it."""
    if not others.shape[1]:
        return span
    left, values, _ = np.linalg.svd(span - others @ (others.T @ span), full_matrices=False)
    return np.asarray(left[:, values > 0.5])
