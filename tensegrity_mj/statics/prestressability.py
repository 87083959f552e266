"""What a structure at given nodes can carry by itself: self-stress, its signs, mechanisms, and what prestress holds.

B (M + R, q) tells how the lengths of strings and rods change with the free coordinates of `Boundary`, all rods
counted as members. Its singular values divide

    states of self-stress   Bᵀ t = 0      member forces t [N] that are in balance without loads,
    mechanisms              B v = 0       motions that change no length, to first order (those of the whole apart).

Strings only pull. By Tucker's form of Farkas' lemma every string either pulls in some state in which none pushes, or
there is a motion that keeps the rods' lengths, shortens no string and lengthens each of those that cannot pull: the
certificate. Two linear programs find both.

A prestress t stiffens a mechanism v by the sum over members of t/L times the squared motion of one end against the
other across the member. A structure is prestress stable where a state of self-stress of strings that pull makes this
positive on all mechanisms (Connelly and Whiteley 1996). Over such states the smallest eigenvalue is concave: cutting
planes bound it from above, each state found from below, so that a positive one is proven by itself, and its absence by
the bound. A free structure is super stable where its stress matrix is positive semidefinite of rank N - d - 1 and the
directions of its members lie on no conic at infinity (Connelly 1982).
Bent joints' stiffness and loads have no part in any of it.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.checks import real_array
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.scene import Scene
from tensegrity_mj.statics.boundary import Boundary, Hold
from tensegrity_mj.statics.model import Members, StaticModel
from tensegrity_mj.statics.state import StaticState
from tensegrity_mj.statics.words import counted
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

RANK = 1e-9  # of the largest singular value, as in `prestress`
CLEAR = 1e4  # between the smallest singular value that counts and the largest that does not
POSITIVE = 1e-8  # of the largest eigenvalue of the form in any unit state: below it, a stiffness is none
CUTS = 300
FAR = 1e6  # [N] weights of states: those of rods alone have no limit from strings
GAP = 1e-3  # of the bound, where the search for the stiffest prestress may stop


class Verdict(enum.Enum):
    """An answer that may be left open."""

    YES = "yes"
    NO = "no"
    UNDECIDED = "undecided"  # numbers too close to call, or more cutting planes needed than allowed
    NOT_APPLICABLE = "not applicable"  # the question does not fit; `reasons` says why


@dataclass(frozen=True, eq=False)
class Prestressability:
    """What a structure can carry by itself; N nodes, M strings, R rods, q free coordinates, S states, m mechanisms.

    Attributes:
        structure, nodes: what was asked about; (N, 3) [m].
        free_coordinates: q.
        singular_values: of B, descending, dimensionless.
        self_stress: (S, M + R) [N] orthonormal member forces in balance, strings first; tension is positive.
        rigid_motions: (3N, p) orthonormal motions of the whole as one body that supports and holds leave.
        mechanisms: (3N, m) orthonormal further motions that change no member's length, to first order.
        can_pull: (M,) strings that are in tension in some state in which no string pushes.
        can_push: (R,) rods that are in compression in some state in which every string of `can_pull` pulls.
        all_can_push: whether one such state has every rod in compression.
        obstacle: (3N,) a motion that keeps rods' lengths, shortens no string and lengthens those that cannot pull, the
            farthest moved node by 1 m; None where all can.
        prestress: (M + R,) [N] the chosen member forces: the state's own, or the stiffest prestress that was found, its
            largest string tension 1 N; None where no string can pull.
        own: whether the prestress is that of a state that was given.
        taut_mechanisms: (3N, k) the motions that no taut string and no rod resists: `mechanisms`, and what slack
            strings leave.
        prestress_stiffness: (k,) [N/m] eigenvalues of the prestress' form on `taut_mechanisms`, ascending.
        stiffness_bound: [N/m] no prestress of a largest string tension of 1 N or less makes the lowest of these larger;
            NaN where that was not asked.
        stress_matrix: (N, N) [N/m] of the prestress.
        prestress_stable, super_stable: verdicts.
        reasons: (2,) sentences for the two verdicts.
    """

    structure: Structure
    nodes: Array
    free_coordinates: int
    singular_values: Array
    self_stress: Array
    rigid_motions: Array
    mechanisms: Array
    can_pull: Flags
    can_push: Flags
    all_can_push: bool
    obstacle: Array | None
    prestress: Array | None
    own: bool
    taut_mechanisms: Array
    prestress_stiffness: Array
    stiffness_bound: float
    stress_matrix: Array
    prestress_stable: Verdict
    super_stable: Verdict
    reasons: tuple[str, str]

    @property
    def rank(self) -> int:
        """Of B."""
        return _rank(self.singular_values)

    @property
    def gap(self) -> tuple[float, float]:
        """The smallest singular value that counts and the largest that does not, over the largest; 0 for none."""
        values = self.singular_values
        top = float(values.max(initial=0.0)) or 1.0
        counted, rest = values[: self.rank], values[self.rank :]
        return (float(counted[-1]) / top if len(counted) else 0.0, float(rest[0]) / top if len(rest) else 0.0)

    @property
    def rank_is_clear(self) -> bool:
        """Whether the two are far apart, so that the numbers of states and mechanisms are beyond doubt."""
        least, most = self.gap
        return least == 0.0 or least > CLEAR * max(most, float(np.finfo(float).eps))

    @property
    def all_can_pull(self) -> bool:
        """Whether one state has every string in tension."""
        return bool(np.all(self.can_pull)) and len(self.can_pull) > 0

    @property
    def is_rigid_to_first_order(self) -> bool:
        """Whether every motion but those of the whole lengthens a string or changes a rod, to first order.

        That is: no mechanism, and a state with every string in tension (Roth and Whiteley 1981).
        """
        return self.mechanisms.shape[1] == 0 and (self.all_can_pull or not len(self.can_pull))

    @property
    def force_densities(self) -> Array:
        """(S, M + R) [N/m] of the states of self-stress."""
        return np.asarray(self.self_stress / self._lengths)

    @property
    def _lengths(self) -> Array:
        strings, rods = _members(self.structure, self.nodes)
        return np.concatenate([strings.lengths, rods.lengths])

    def describe(self) -> list[str]:
        """What there is to say, a sentence a line."""
        strings = [string.name for string in self.structure.strings]
        rods = [rod.name for rod in self.structure.rods]
        least, most = self.gap
        lines = [
            f"{counted(len(strings), 'string')} and {counted(len(rods), 'rod')} on "
            f"{counted(self.free_coordinates, 'free coordinate')}: "
            f"{counted(len(self.self_stress), 'state')} of self-stress, "
            f"{counted(self.mechanisms.shape[1], 'mechanism')}, "
            f"{counted(self.rigid_motions.shape[1], 'motion')} of the whole"
        ]
        clear = "clear" if self.rank_is_clear else "in doubt: give the nodes all their digits"
        lines.append(
            f"rank {self.rank}, {clear}: of the largest singular value, the least that counts is {least:.1e}, and the "
            f"largest that does not {most:.1e}"
        )
        if not len(self.self_stress):
            lines.append("nothing can be prestressed: forces of members are in balance only where all are zero")
        elif self.all_can_pull:
            lines.append("every string can pull at once")
        elif strings:
            lines.append(
                f"{_listed(strings, ~self.can_pull, 'string')} cannot pull while no string pushes: a motion keeps the "
                "rods' lengths, shortens no string and lengthens these"
            )
        if rods and self.can_pull.any():
            pushed = _listed(rods, self.can_push, "rod") or "no rod"
            together = "every rod can be in compression at once meanwhile"
            lines.append(together if self.all_can_push else f"{pushed} can be in compression meanwhile")
        if len(self.prestress_stiffness) and self.prestress is not None:
            least_stiffness = float(self.prestress_stiffness[0])
            if self.own:
                what = f"stiffen mechanisms by {least_stiffness:.6g} N/m at least"
                driven = f"drive a mechanism on with {-least_stiffness:.6g} N/m"
                lines.append(f"the state's own forces, of loads too, {driven if least_stiffness < 0 else what}")
            else:
                lines.append(
                    "the stiffest prestress found, with 1 N in the tightest string, stiffens mechanisms by "
                    f"{least_stiffness:.6g} N/m at least"
                )
        lines.append(f"prestress stable: {self.prestress_stable.value}; {self.reasons[0]}")
        lines.append(f"super stable: {self.super_stable.value}; {self.reasons[1]}")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values, for JSON."""
        return {
            "structure": self.structure.name,
            "strings": [string.name for string in self.structure.strings],
            "rods": [rod.name for rod in self.structure.rods],
            "nodes": self.nodes.tolist(),
            "free_coordinates": self.free_coordinates,
            "rank": self.rank,
            "rank_is_clear": self.rank_is_clear,
            "singular_values": self.singular_values.tolist(),
            "self_stress": self.self_stress.tolist(),
            "rigid_motions": self.rigid_motions.T.tolist(),
            "mechanisms": self.mechanisms.T.tolist(),
            "can_pull": self.can_pull.tolist(),
            "can_push": self.can_push.tolist(),
            "all_can_push": self.all_can_push,
            "obstacle": None if self.obstacle is None else self.obstacle.tolist(),
            "rigid_to_first_order": self.is_rigid_to_first_order,
            "prestress": None if self.prestress is None else self.prestress.tolist(),
            "own_prestress": self.own,
            "prestress_stiffness": self.prestress_stiffness.tolist(),
            "stiffness_bound": self.stiffness_bound,
            "prestress_stable": self.prestress_stable.value,
            "super_stable": self.super_stable.value,
            "described": self.describe(),
        }


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


def _members(structure: Structure, nodes: Array) -> tuple[Members, Members]:
    """Strings and rods at nodes (N, 3)."""

    def along(pairs: NDArray[np.int64]) -> Members:
        span = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
        lengths = np.linalg.norm(span, axis=1)
        return Members(lengths, span / np.where(lengths > 0, lengths, 1.0)[:, None])

    return along(structure.string_nodes), along(structure.rod_nodes)


def _rank(values: Array) -> int:
    return int(np.sum(values > RANK * values.max(initial=0.0))) if values.size else 0


def _across(span: Array, others: Array) -> Array:
    """An orthonormal basis of what an orthonormal span (q, a) has across orthonormal columns (q, b) that lie in it."""
    if not others.shape[1]:
        return span
    left, values, _ = np.linalg.svd(span - others @ (others.T @ span), full_matrices=False)
    return np.asarray(left[:, values > 0.5])


def _listed(names: list[str], chosen: Flags, what: str) -> str:
    found = [f"'{name}'" for name, one in zip(names, chosen, strict=True) if one]
    more = "" if len(found) <= 12 else f", ... ({len(found)} in all)"
    return f"{what}{'s' if len(found) > 1 else ''} {', '.join(found[:12])}{more}" if found else ""
