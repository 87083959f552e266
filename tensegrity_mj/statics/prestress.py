"""Prestress of a structure at given nodes: states of self-stress, their signs, mechanisms, and which of them it holds.

B (M + R, q) says how the lengths of strings and rods change with the free coordinates of `Boundary`, all rods
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

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import checks, jsontext, texts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.listing import counted
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.statics.state import StaticState
from tensegrity_mj.statics.stiffening import Assembly, Verdict, judged, member_paths, rank_of, stiffest, super_stable
from tensegrity_mj.statics.stress_signs import Flags, can_pull, can_push, listed, obstacle

CLEAR = 1e4  # between the smallest singular value that counts and the largest that does not


@dataclass(frozen=True, eq=False)
class Prestressability:
    """Self-stress and mechanisms; N nodes, M strings, R rods, q free coordinates, S states, m mechanisms.

    Attributes:
        structure, nodes: what was analysed; (N, 3) [m].
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
            strings leave; strings at the edge of slackness are taken for slack.
        prestress_stiffness: (k,) [N/m] eigenvalues of the prestress' form on `taut_mechanisms`, ascending.
        stiffness_bound: [N/m] no prestress of a largest string tension of 1 N or less makes the lowest of these larger;
            NaN where that was not sought.
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

    def __repr__(self) -> str:
        rows = [
            ("what", f"{self.structure.name} can carry by itself"),
            ("counts", self.describe()[0]),
            ("rank", f"{self.rank}, {'clear' if self.rank_is_clear else 'in doubt'}"),
            ("verdict", f"prestress stable: {self.prestress_stable.value}; super stable: {self.super_stable.value}"),
        ]
        return texts.at_a_glance(rows)

    @property
    def rank(self) -> int:
        """Rank of B."""
        return rank_of(self.singular_values)

    @property
    def gap(self) -> tuple[float, float]:
        """The smallest singular value that counts and the largest that does not, over the largest; 0 for none."""
        values = self.singular_values
        top = float(values.max(initial=0.0)) or 1.0
        counted, rest = values[: self.rank], values[self.rank :]
        return (float(counted[-1]) / top if len(counted) else 0.0, float(rest[0]) / top if len(rest) else 0.0)

    @property
    def rank_is_clear(self) -> bool:
        """True where the two are far apart, so that the numbers of states and mechanisms are beyond doubt."""
        least, most = self.gap
        return least == 0.0 or least > CLEAR * max(most, float(np.finfo(float).eps))

    @property
    def all_can_pull(self) -> bool:
        """True where one state has every string in tension."""
        return bool(np.all(self.can_pull)) and len(self.can_pull) > 0

    @property
    def is_rigid_to_first_order(self) -> bool:
        """True where every motion but those of the whole lengthens a string or changes a rod, to first order.

        That is: no mechanism, and a state with every string in tension (Roth and Whiteley 1981).
        """
        return self.mechanisms.shape[1] == 0 and (self.all_can_pull or not len(self.can_pull))

    @property
    def force_densities(self) -> Array:
        """(S, M + R) [N/m] of the states of self-stress."""
        return np.asarray(self.self_stress / member_paths(self.structure).lengths(self.nodes))

    def describe(self) -> list[str]:
        """Return a description of self-stress and mechanisms, a sentence a line."""
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
                f"{listed(strings, ~self.can_pull, 'string')} cannot pull while no string pushes: a motion keeps the "
                "rods' lengths, shortens no string and lengthens these"
            )
        if rods and self.can_pull.any():
            pushed = listed(rods, self.can_push, "rod") or "no rod"
            together = "every rod can be in compression at once meanwhile"
            lines.append(together if self.all_can_push else f"{pushed} can be in compression meanwhile")
        if len(self.prestress_stiffness) and self.prestress is not None:
            least_stiffness = float(self.prestress_stiffness[0])
            if self.own:
                what = f"stiffen mechanisms by {least_stiffness:.6g} N/m at least"
                driven = f"destabilise a mechanism: its stiffness is {least_stiffness:.6g} N/m"
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
        """Return plain values, for JSON."""
        return {
            "structure": self.structure.name,
            "strings": [string.name for string in self.structure.strings],
            "rods": [rod.name for rod in self.structure.rods],
            **jsontext.plain_values(
                self, "nodes", "free_coordinates", "rank", "rank_is_clear", "singular_values", "self_stress"
            ),
            "rigid_motions": self.rigid_motions.T.tolist(),
            "mechanisms": self.mechanisms.T.tolist(),
            **jsontext.plain_values(self, "can_pull", "can_push", "all_can_push", "obstacle"),
            "rigid_to_first_order": self.is_rigid_to_first_order,
            "prestress": jsontext.plain(self.prestress),
            "own_prestress": self.own,
            **jsontext.plain_values(self, "prestress_stiffness", "stiffness_bound", "prestress_stable", "super_stable"),
            "described": self.describe(),
        }


def prestressability(
    source: Structure | Scene | StaticModel | StaticState,
    *,
    nodes: ArrayLike | None = None,
    holds: Sequence[Hold] = (),
) -> Prestressability:
    """Analyse the self-stress and the mechanisms of a structure at given nodes, with any supports and joints.

    Args:
        source: a structure at its reference nodes; a scene at its start; a model at its start, with its holds and
            without its broken strings; or a state, whose own forces are then the prestress that is judged. (Under loads
            these are no state of self-stress; what they do to mechanisms is the same sum.)
        nodes: (N, 3) [m] instead of these; not with a state.
        holds: further nodes that are held; not with a model or a state, which have their own.

    Raises:
        OptionError: for arguments that do not fit, members without length, and structures with bodies.
    """
    tensions = forces = None
    if isinstance(source, StaticState):
        if nodes is not None:
            raise OptionError("prestressability: nodes: a state has its own; leave them out, or give its model")
        model, places = source.model, source.nodes
        # Neither round-off nor a string as long as its rest length holds anything: the sign of such a force is chance.
        tensions = source.settled(np.where(source.at_edge, 0.0, source.tensions))
        forces = source.settled(source.rod_forces)
    else:
        if not isinstance(source, (Structure, Scene, StaticModel)):
            raise OptionError(
                f"prestressability of {source!r}: use a Structure, a Scene, a StaticModel or a StaticState"
            )
        model = source if isinstance(source, StaticModel) else StaticModel.of(source, holds=holds)
        shape = (len(model.structure.nodes), 3)
        places = model.start if nodes is None else checks.real_array("nodes", nodes, shape, "m", scalar=False)
    if holds and isinstance(source, (StaticModel, StaticState)):
        raise OptionError("prestressability: holds: a model has its own; leave them out, or give its scene")
    for body in model.structure.bodies:
        raise OptionError(
            f"prestressability: '{body.name}' is a body; what prestress does to motions is found for rods and strings "
            "alone: self_stress counts its states, and find_equilibrium(...).lowest_stiffness says whether it stands"
        )
    at = Assembly.of(model.structure, model.boundary, np.array(places, float), model.whole)
    return _analysed(at, None if tensions is None or forces is None else np.concatenate([tensions, forces]))


def _analysed(at: Assembly, own: Array | None) -> Prestressability:
    """Analyse for the forces (M + R,) of a state, or for the stiffest prestress."""
    M, Z = len(at.whole), at.boundary.Z
    there = np.append(at.whole, np.ones(len(at.B) - M, bool))
    left, values, right = (np.asarray(part, float) for part in np.linalg.svd(at.B[there]))
    rank = rank_of(values)
    states = np.zeros((len(left) - rank, len(at.B)))
    states[:, there] = left[:, rank:].T
    states *= np.where(states[:, :M].sum(axis=1) < 0, -1.0, 1.0)[:, None]
    mechanisms = at.without_bodies(right[rank:].T)
    pulling = can_pull(states, M)
    pushing, all_push = can_push(states, pulling)
    barrier = None
    if not pulling[at.whole].all():
        motion = np.asarray(Z @ obstacle(at.B[:M][at.whole], at.B[M:], ~pulling[at.whole]))
        barrier = motion / (float(np.linalg.norm(motion.reshape(-1, 3), axis=1).max()) or 1.0)
    taut = pulling if own is None else (own[:M] > 0) & at.whole
    loose = at.loose(taut)
    prestress, bound, stability = own, float("nan"), (Verdict.NOT_APPLICABLE, "")
    if own is None:
        prestress, bound, stability = stiffest(at, states, pulling, loose)
    stiffness: Array = np.zeros(0)
    if prestress is not None and loose.shape[1]:
        stiffness = np.asarray(np.linalg.eigvalsh(at.form(prestress, loose)), float)
    if own is not None:
        stability = judged(at, own, stiffness)
    superb = super_stable(at, states, pulling, own)
    return Prestressability(
        structure=at.structure,
        nodes=at.nodes,
        free_coordinates=Z.shape[1],
        singular_values=values,
        self_stress=states,
        rigid_motions=at.bodies,
        mechanisms=mechanisms,
        can_pull=pulling,
        can_push=pushing,
        all_can_push=all_push,
        obstacle=barrier,
        prestress=prestress,
        own=own is not None,
        taut_mechanisms=loose,
        prestress_stiffness=stiffness,
        stiffness_bound=bound,
        stress_matrix=at.stress_matrix(np.zeros(len(at.B)) if prestress is None else prestress),
        prestress_stable=stability[0],
        super_stable=superb[0],
        reasons=(stability[1], superb[1]),
    )
