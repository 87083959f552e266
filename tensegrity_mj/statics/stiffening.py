"""Prestress that stiffens mechanisms most, and whether it makes a structure prestress stable or super stable.

The lowest eigenvalue of a form that is linear in the state of self-stress is concave over the states: cutting planes
bound it from above, each state found from below.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.rigidity import Members, members_at, nodal_forces
from tensegrity_mj.model.strings import Paths
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Boundary, lasting_motions
from tensegrity_mj.statics.stress_signs import FAR, Flags, solved_program

RANK = 1e-9  # of the largest singular value, as in `self_stress`


@dataclass(frozen=True, eq=False)
class Assembly:
    """B at some nodes, its null spaces, and the forms of prestress; M strings come first, R rods after them.

    Attributes:
        nodes: (N, 3) [m].
        whole: (M,) strings that are not broken.
        members: lengths and directions of the strings' segments, and of the rods behind them (S + R).
        B: (M + R, q) how lengths change with the free coordinates of the boundary.
    """

    structure: Structure
    boundary: Boundary
    nodes: Array
    whole: Flags
    members: Members
    B: Array

    @classmethod
    def of(cls, structure: Structure, boundary: Boundary, nodes: Array, whole: Flags) -> Assembly:
        """Assemble at nodes (N, 3); raise OptionError for a member without length."""
        paths = member_paths(structure)
        members = members_at(paths.nodes, nodes)
        if len(paths.nodes) and members.lengths.min() == 0:
            names = [one.name for one in structure.strings] + [one.name for one in structure.rods]
            name = names[int(paths.strings[members.lengths.argmin()])]
            raise OptionError(f"'{name}' has no length at these nodes, and so no direction: look at other nodes")
        slopes = -paths.total(nodal_forces(paths.nodes, members.directions, len(nodes))).T
        slopes[: len(whole)][~whole] = 0.0
        B = np.asarray((boundary.Z.T @ slopes.T).T)
        return cls(structure, boundary, nodes, whole, members, B)

    @cached_property
    def bodies(self) -> Array:
        """Orthonormal motions (3N, p) of the whole as one body that go on, as far as supports and holds leave them."""
        return lasting_motions(self.boundary, self.nodes)

    def without_bodies(self, motions: Array) -> Array:
        """An orthonormal basis (3N, m) of motions of orthonormal free coordinates (q, a), those of the whole apart."""
        Z = self.boundary.Z
        others = Z.T @ self.bodies
        if others.shape[1]:
            left, values, _ = np.linalg.svd(motions - others @ (others.T @ motions), full_matrices=False)
            motions = left[:, values > 0.5]
        return np.asarray(Z @ motions)

    def loose(self, taut: Flags) -> Array:
        """(3N, k) what neither rods nor taut strings resist, to first order, motions of the whole apart."""
        M = len(taut)
        rows = np.concatenate([self.B[:M][taut], self.B[M:]])
        _, values, right = np.linalg.svd(rows) if len(rows) else (None, np.zeros(0), np.eye(self.B.shape[1]))
        return self.without_bodies(right[rank_of(values) :].T)

    def form(self, forces: Array, motions: Array) -> Array:
        """(k, k) [N/m]: Σ t/L (v·v - (v·s)²) of the members' relative motions v, for motions (3N, k)."""
        return np.asarray(np.einsum("t,tmn->mn", forces, self.forms(motions)))

    def forms(self, motions: Array) -> Array:
        """(M + R, k, k) [1/m] the same for 1 N in each member."""
        paths, (lengths, directions) = member_paths(self.structure), self.members
        moved = motions.reshape(len(self.nodes), 3, -1)
        apart = moved[paths.nodes[:, 1]] - moved[paths.nodes[:, 0]]
        along = np.einsum("tx,txm->tm", directions, apart)
        square = np.einsum("txm,txn->tmn", apart, apart) - along[:, :, None] * along[:, None, :]
        return np.asarray(paths.total(square / lengths[:, None, None], axis=0))

    def stress_matrix(self, forces: Array) -> Array:
        """(N, N) [N/m] of forces (M + R,) [N] of the members."""
        paths = member_paths(self.structure)
        density = forces[paths.strings] / self.members.lengths
        C = np.zeros((len(paths.nodes), len(self.nodes)))
        rows = np.arange(len(paths.nodes))
        C[rows, paths.nodes[:, 0]], C[rows, paths.nodes[:, 1]] = -1.0, 1.0
        return np.asarray(C.T @ (density[:, None] * C))


def member_paths(structure: Structure) -> Paths:
    """The segments of M strings, and behind them R rods as strings of one segment each."""
    return structure.paths.followed_by(structure.rod_nodes)


def rank_of(values: Array) -> int:
    """Return the number of singular values that count."""
    return int(np.sum(values > RANK * values.max(initial=0.0))) if values.size else 0


POSITIVE = 1e-8  # of the largest eigenvalue of the form in any unit state: below it, a stiffness is none
CUTS = 300
GAP = 1e-3  # of the bound, where the search for the stiffest prestress may stop


class Verdict(enum.Enum):
    """An answer that may be left open."""

    YES = "yes"
    NO = "no"
    UNDECIDED = "undecided"  # numbers too close to decide, or more cutting planes needed than allowed
    NOT_APPLICABLE = "not applicable"  # the question does not fit; `reasons` says why


class Best(NamedTuple):
    """The stiffest state that was found: its weights (S,), what it is worth, and what none is worth more than."""

    weights: Array | None
    value: float
    bound: float


def stiffest(
    at: Assembly, states: Array, pulling: Flags, loose: Array
) -> tuple[Array | None, float, tuple[Verdict, str]]:
    """The prestress (M + R,), the bound of all, and the verdict."""
    M, k = len(pulling), loose.shape[1]
    if not pulling.any():
        if k == 0:
            return None, float("nan"), (Verdict.YES, "rods and supports alone leave no mechanism")
        return None, float("nan"), (Verdict.NO, "no string can pull, and rods and supports alone leave motions")
    middle = _middle(states, pulling)
    if k == 0:
        why = "no mechanism is left, and every string of it pulls"
        why = why if pulling.all() else "those strings that can pull leave no mechanism by themselves"
        return middle, float("nan"), (Verdict.YES, why)
    forms = np.einsum("st,tmn->smn", states, at.forms(loose))
    scale = float(np.abs(forms).max(initial=0.0))
    best = maximized(forms, states[:, :M].T, scale)
    least = POSITIVE * scale
    if best.weights is None or best.bound <= least:
        why = f"no prestress of 1 N at most stiffens some motion by more than {max(best.bound, 0.0):.2g} N/m"
        return middle, best.bound, (Verdict.NO, why + " (a bound over all of them)")
    chosen = _blended(at, states.T @ best.weights, middle, loose, best.value)
    if best.value > least:
        slack = "" if pulling.all() else ", with the strings that cannot pull left slack"
        return chosen, best.bound, (Verdict.YES, f"the prestress found stiffens every mechanism{slack}")
    return (
        chosen,
        best.bound,
        (Verdict.UNDECIDED, f"the best found is {best.value:.2g} N/m, none above {best.bound:.2g}"),
    )


def _middle(states: Array, pulling: Flags) -> Array:
    """A state (M + R,) [N] with all strings that can pull as far from slack as they can be, the largest 1 N."""
    M, size = len(pulling), len(states)
    pulls = states[:, :M].T
    above = np.append(-pulls, pulling[:, None].astype(float), axis=1)
    below = np.append(pulls, np.zeros((M, 1)), axis=1)
    limits = np.concatenate([np.zeros(M), np.ones(M)])
    result = solved_program(np.append(np.zeros(size), -1.0), np.vstack([above, below]), limits)
    return np.asarray(states.T @ result.x[:size])


def _blended(at: Assembly, best: Array, middle: Array, loose: Array, value: float) -> Array:
    """Add as much of the middle as leaves half of the stiffness, so that no string is slack that need not be."""
    if value <= 0:
        return best
    part = 1.0
    for _ in range(20):
        mixed = (1 - part) * best + part * middle
        if np.linalg.eigvalsh(at.form(mixed, loose))[0] >= 0.5 * value:
            break
        part /= 2
    return np.asarray(mixed / mixed[: len(at.whole)].max())


def judged(at: Assembly, own: Array, stiffness: Array) -> tuple[Verdict, str]:
    """Judge whether a state's own forces hold its mechanisms."""
    if not len(stiffness):
        return Verdict.YES, "taut strings and rods leave no mechanism"
    scale = float(np.abs(own).max(initial=0.0)) / float(at.members.lengths.mean())
    if stiffness[0] > POSITIVE * scale:
        return Verdict.YES, "the state's own forces stiffen every mechanism"
    if stiffness[0] < -POSITIVE * scale:
        return Verdict.NO, "the state's own forces destabilise a mechanism"
    return Verdict.UNDECIDED, "the state's own forces neither stiffen nor destabilise a mechanism, within round-off"


def super_stable(at: Assembly, states: Array, pulling: Flags, own: Array | None) -> tuple[Verdict, str]:
    if at.boundary.rows.shape[0]:
        return Verdict.NOT_APPLICABLE, "it is defined for structures without supports"
    if not pulling.any():
        return Verdict.NO, "no string can pull"
    if len(at.structure.paths.nodes) > len(at.structure.strings):
        return Verdict.NOT_APPLICABLE, "it is defined for strings of two nodes; one through more may change its shape"
    centered = at.nodes - at.nodes.mean(axis=0)
    _, spread, axes = np.linalg.svd(centered)
    d = int(np.sum(spread > RANK * spread[0]))
    affine = np.column_stack([np.ones(len(centered)), centered @ axes[:d].T])
    across = np.linalg.svd(affine)[0][:, d + 1 :]  # (N, N - d - 1)
    directions = at.members.directions @ axes[:d].T
    i, j = np.triu_indices(d)
    used = np.concatenate([pulling, np.ones(len(at.structure.rods), bool)])
    conic = np.linalg.svd((directions[:, i] * directions[:, j])[used], compute_uv=False)
    if int(np.sum(conic > RANK * conic[0])) < len(i):
        return Verdict.NO, "the directions of its members lie on a conic at infinity"
    if not across.shape[1]:
        return Verdict.YES, "its nodes are those of a simplex"
    if own is not None:
        form = np.linalg.eigvalsh(across.T @ at.stress_matrix(own) @ across)
        scale = float(np.abs(form).max())
        if form[0] > POSITIVE * scale:
            return Verdict.YES, "its stress matrix is positive semidefinite of the largest rank"
        verdict = Verdict.NO if form[0] < -POSITIVE * scale else Verdict.UNDECIDED
        return (
            verdict,
            f"the lowest eigenvalue of its own stress matrix, affine motions apart, is {form[0]:.2g} N/m",
        )
    forms = np.array([across.T @ at.stress_matrix(state) @ across for state in states])
    scale = float(np.abs(forms).max(initial=0.0))
    best = maximized(forms, states[:, : len(pulling)].T, scale)
    if best.value > POSITIVE * scale:
        return Verdict.YES, "a prestress has a stress matrix that is positive semidefinite of the largest rank"
    if best.bound <= POSITIVE * scale:
        return Verdict.NO, "no prestress has such a stress matrix (a bound over all of them)"
    return Verdict.UNDECIDED, f"the best stress matrix found has {best.value:.2g} N/m, none above {best.bound:.2g}"


def maximized(forms: Array, pulls: Array, scale: float) -> Best:
    """The weights a (S,) with the largest lowest eigenvalue of Σ a forms (S, k, k), for 0 <= pulls @ a (M,) <= 1.

    Cutting planes: wᵀ (Σ a forms) w is above the lowest eigenvalue for every unit w. Each round's linear program bounds
    all states by the planes of the eigenvectors so far, and its solution is a state.
    """
    size, k = forms.shape[:2]
    if not size or not k or scale == 0:
        return Best(None, 0.0, 0.0)
    rows = np.einsum("smm->ms", forms)  # the first planes: the coordinates
    best, value, bound = None, -np.inf, np.inf
    sides = np.vstack([-pulls, pulls])
    limits = np.concatenate([np.zeros(len(pulls)), np.ones(len(pulls))])
    for _ in range(CUTS):
        planes = np.append(-rows / scale, np.ones((len(rows), 1)), axis=1)
        result = solved_program(
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
    return Best(best, value, bound)
