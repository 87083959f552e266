"""Strength of members: rods that yield or buckle, strings that break or hang slack.

    rod:     |N| ≤ σ_y A                   it yields beyond, in tension and in compression
             -N ≤ π² E I / ℓ²              it buckles beyond, as a straight bar between two ball joints (Euler)
    string:  T ≤ strength                  it breaks beyond;  T = 0: it is slack

Utilisation is the left side over the right one: at 1 a member is at its limit. A rod in tension has none by buckling,
whatever its force: it does not buckle. The two limits of a rod are looked at
one by one; a bar that is not straight, or loaded between its ends, fails before either. A rod's weight and inertia make
its axial force vary along it: N is the mean over its length, in statics and in what engines record.

A rod without section or yield stress, and a string without strength, has no limit to compare with. It is reported as
unchecked, and nothing that holds such a member is ever called ok.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array, norm
from tensegrity_mj.basics.checks import finite, instance, real_array
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.rods import ends
from tensegrity_mj.model.section import hardly_possible
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures.findings import Mark
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.statics.listing import by_member, listed

if TYPE_CHECKING:
    from tensegrity_mj.statics.state import StaticState


class Criterion(enum.Enum):
    """Ways in which a member fails."""

    YIELD = "yield"
    BUCKLING = "buckling"
    STRENGTH = "strength"


@dataclass(frozen=True)
class Use:
    """Utilisation of one member: its force as a fraction of the force that it bears.

    Attributes:
        member: name of the rod or string.
        criterion: what it is compared with.
        force: N of the rod or T of the string [N].
        limit: the force that it bears [N].
        utilisation: 1 at the limit.
        time: [s] of a run; None in statics.
        chosen: whether the force is a choice, of a redundant rigid rod.
    """

    member: str
    criterion: Criterion
    force: float
    limit: float
    utilisation: float
    time: float | None = None
    chosen: bool = False

    def describe(self) -> str:
        """Return a description, as text."""
        kind = "string" if self.criterion is Criterion.STRENGTH else "rod"
        chosen = ", but its force is a choice" if self.chosen else ""
        when = "" if self.time is None else f" at t = {self.time:.6g} s"
        return (
            f"{kind} '{self.member}' is at {100 * self.utilisation:.4g} % of its {self.criterion.value} limit{when}: "
            f"{quantity(self.force, 'N', 5)} of {quantity(self.limit, 'N', 5)}{chosen}"
        )


@dataclass(frozen=True)
class SlackInterval:
    """First and last recorded time [s] of a run between which a string was slack, both included."""

    string: str
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class MemberLoads:
    """Forces of a structure's members and what they bear; arrays have one row a time, (T, R) or (T, M).

    Attributes:
        structure: whose members.
        rod_forces: N (T, R) [N], negative in compression.
        rod_lengths: ℓ (T, R) [m].
        tensions: T (T, M) [N].
        times: (T,) [s], or None where there is only one row and no time.
        chosen: names of the rods whose forces are a choice, see `statics.determinacy`.
    """

    structure: Structure
    rod_forces: Array
    rod_lengths: Array
    tensions: Array
    times: Array | None = None
    chosen: tuple[str, ...] = ()

    @cached_property
    def stresses(self) -> Array:
        """N / A (T, R) [Pa]; NaN for rods without section."""
        return self.rod_forces / _numbers(None if r.section is None else r.section.area for r in self.structure.rods)

    @cached_property
    def yield_loads(self) -> Array:
        """σ_y A (R,) [N]; NaN where unknown."""
        return _numbers(None if r.section is None else r.section.yield_load for r in self.structure.rods)

    @cached_property
    def euler_loads(self) -> Array:
        """π² E I / ℓ² (T, R) [N]; NaN where unknown."""
        per_square = _numbers(None if r.section is None else r.section.euler_load(1.0) for r in self.structure.rods)
        return per_square / self.rod_lengths**2

    @cached_property
    def strengths(self) -> Array:
        """(M,) [N]; NaN where unknown."""
        return _numbers(string.strength for string in self.structure.strings)

    @cached_property
    def yielding(self) -> Array:
        """Utilisation (T, R) of the rods by yield; NaN where unknown."""
        return np.asarray(np.abs(self.rod_forces) / self.yield_loads)

    @cached_property
    def buckling(self) -> Array:
        """Utilisation (T, R) of the rods by buckling; NaN where unknown, and in tension, where there is none."""
        return np.asarray(np.where(self.rod_forces > 0, np.nan, np.abs(self.rod_forces) / self.euler_loads))

    @cached_property
    def breaking(self) -> Array:
        """Utilisation (T, M) of the strings; NaN where unknown."""
        return np.asarray(self.tensions / self.strengths)

    @cached_property
    def unchecked(self) -> tuple[str, ...]:
        """Members without a limit: "rod 'r1' (yield)", "string 's1' (strength)", "rod 'r2' (its force is a choice)"."""
        found = [f"rod '{name}' (its force is a choice)" for name in self.chosen]
        for column, rods in hardly_possible(self.structure).items():
            found += [f"rod '{rod.name}' (its {column} is hardly possible)" for rod, _ in rods]
        for rod in self.structure.rods:
            if rod.section is None:
                found.append(f"rod '{rod.name}' (yield, buckling)")
            elif rod.section.yield_stress is None:
                found.append(f"rod '{rod.name}' (yield)")
        found += [f"string '{s.name}' (strength)" for s in self.structure.strings if s.strength is None]
        return tuple(found)

    def largest(self, start: int = 0, end: int | None = None) -> list[Use]:
        """The largest use of every member by every criterion that it has, over those rows; the largest first.

        A rod that is in tension throughout has none by buckling.
        """
        rods, strings = ([member.name for member in kind] for kind in (self.structure.rods, self.structure.strings))
        yields = np.broadcast_to(self.yield_loads, self.rod_forces.shape)
        breaks = np.broadcast_to(self.strengths, self.tensions.shape)
        found = []
        for names, criterion, use, force, limit in (
            (rods, Criterion.YIELD, self.yielding, self.rod_forces, yields),
            (rods, Criterion.BUCKLING, self.buckling, self.rod_forces, self.euler_loads),
            (strings, Criterion.STRENGTH, self.breaking, self.tensions, breaks),
        ):
            rows = start + np.argmax(np.where(np.isnan(use), -np.inf, use)[start:end], axis=0)
            for column, (name, row) in enumerate(zip(names, rows.tolist(), strict=True)):
                at = (row, column)
                if np.isfinite(use[at]):
                    time = None if self.times is None else float(self.times[row])
                    found.append(
                        Use(
                            name,
                            criterion,
                            float(force[at]),
                            float(limit[at]),
                            float(use[at]),
                            time,
                            name in self.chosen,
                        )
                    )
        return sorted(found, key=lambda one: -one.utilisation)

    @cached_property
    def exceeded(self) -> NDArray[np.bool_]:
        """(T,): whether some member is beyond its limit."""
        parts = [np.any(use > 1.0, axis=1) for use in (self.yielding, self.buckling, self.breaking)]
        return np.asarray(np.logical_or.reduce(parts))

    @property
    def first_exceeded(self) -> Use | None:
        """The largest use in the first row in which a member is beyond its limit, or None."""
        row = int(np.argmax(self.exceeded))
        return self.largest(row, row + 1)[0] if self.exceeded.any() else None


def _numbers(values: Iterable[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values], float)


SHOWN = 12  # names that a line of text lists


@dataclass(frozen=True, eq=False)
class Check:
    """Forces, limits and utilisations of a structure's members.

    Attributes:
        loads: forces, limits and utilisations of all members, a row a time.
        uses: the largest of every member by every criterion that it has, the largest utilisation first; buckling of
            rods in compression alone.
    """

    loads: MemberLoads
    uses: tuple[Use, ...]

    @cached_property
    def violations(self) -> tuple[Use, ...]:
        """Uses beyond their limits: those of `uses` with a utilisation above 1."""
        return tuple(use for use in self.uses if use.utilisation > 1)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """Members without a limit, and the criterion that lacks it."""
        return self.loads.unchecked

    @property
    def worst(self) -> Use | None:
        """The largest use; None where there is nothing to compare, as for rods in tension."""
        return self.uses[0] if self.uses else None

    @property
    def ok(self) -> bool:
        """True where every member was checked, and none is beyond its limit. Slack strings are no violation."""
        return not self.violations and not self.unchecked

    @property
    def mark(self) -> Mark:
        """Bad beyond a limit, good where every member was checked."""
        return Mark.BAD if self.violations else Mark.GOOD if self.ok else Mark.LIMITED

    def _verdict(self) -> list[str]:
        """The verdict, the worst member, and what could not be checked."""
        worst, unchecked = self.worst, self.unchecked
        if self.violations:
            count = len({(use.member, use.criterion is Criterion.STRENGTH) for use in self.violations})
            head = f"not ok: {count} member{'s are' if count > 1 else ' is'} beyond a limit"
        elif worst is None and unchecked:
            head = "nothing can be checked: no rod has a section, and no string a strength"
            if np.any(np.isfinite(self.loads.euler_loads)):
                head = "no rod with a section is in compression, so that none buckles; no other limit is known"
        elif unchecked:
            head = "no limit is exceeded, as far as limits are known"
        else:
            head = "ok: every member was checked, and none is beyond a limit"
        lines = [head] if worst is None else [head, f"the worst: {worst.describe()}"]
        return [*lines, f"{len(unchecked)} unchecked: {listed(unchecked, SHOWN)}"] if unchecked else lines

    def _summary(self) -> dict[str, Any]:
        return plain_values(self, "ok", "worst", "violations")


@dataclass(frozen=True, eq=False)
class MemberCheck(Check):
    """Check of the members of a structure in one state; arrays of `loads` have one row.

    Attributes:
        ...: those of `Check`.
        slack: names of the strings without tension.
    """

    slack: tuple[str, ...]

    def describe(self) -> tuple[str, ...]:
        """Return a description, as lines of text."""
        return (
            *self._verdict(),
            *(one.describe() for one in self.violations[1:SHOWN]),
            *([f"{len(self.slack)} slack: {listed(map(repr, self.slack), SHOWN)}"] if self.slack else []),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON; numbers that are not known are None."""
        loads = self.loads
        rods = {
            "force": loads.rod_forces[0],
            "determined": [rod.name not in loads.chosen for rod in loads.structure.rods],
            "stress": loads.stresses[0],
            "yield_load": loads.yield_loads,
            "euler_load": loads.euler_loads[0],
            "yielding": loads.yielding[0],
            "buckling": loads.buckling[0],
        }
        strings = {"tension": loads.tensions[0], "strength": loads.strengths, "breaking": loads.breaking[0]}
        return {
            **self._summary(),
            "slack": list(self.slack),
            "unchecked": list(self.unchecked),
            "rods": by_member(loads.structure.rods, rods),
            "strings": by_member(loads.structure.strings, strings),
        }


@dataclass(frozen=True, eq=False)
class TrajectoryCheck(Check):
    """Check of the members of a structure over a run, at its recorded times.

    Attributes:
        ...: those of `Check`.
        first_violation: the largest use at the first time at which a member is beyond its limit, or None.
        slack: when which strings were slack, in the order of the strings; what is broken is not slack.
    """

    first_violation: Use | None
    slack: tuple[SlackInterval, ...]

    def describe(self) -> tuple[str, ...]:
        """Return a description, as lines of text."""
        lines = self._verdict()
        if self.first_violation is not None:
            lines.append(f"the first beyond its limit: {self.first_violation.describe()}")
        lines += [one.describe() for one in self.violations[1:SHOWN]]
        if self.slack:
            names = dict.fromkeys(repr(one.string) for one in self.slack)
            first = min(self.slack, key=lambda one: one.start)
            lines.append(
                f"{len(names)} slack at some time: {listed(names, SHOWN)}; "
                f"first '{first.string}' from {first.start:.6g} s to {first.end:.6g} s"
            )
        return tuple(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {**self._summary(), **plain_values(self, "first_violation", "slack", "unchecked", "uses")}


def check_members(
    structure: Structure,
    nodes: ArrayLike,
    rod_forces: ArrayLike,
    tensions: ArrayLike,
    *,
    slack_below: float = 0.0,
    chosen: tuple[str, ...] = (),
) -> MemberCheck:
    """Check the members against their limits: yield and buckling of rods, strength of strings.

    Args:
        structure: with the `section`s of its rods and the `strength`s of its strings, as far as they are known.
        nodes: (N, 3) [m]; rods are as long as they are there.
        rod_forces: N (R,) [N], positive in tension.
        tensions: T (M,) [N].
        slack_below: [N]: a string is slack where its tension is at most this.
        chosen: names of the rods whose forces are a choice, see `StaticState.determinacy`; they are not ok.

    Raises:
        OptionError: for arrays of another shape, numbers that are not finite, or a rod whose ends coincide.
    """
    instance("structure", structure, Structure, "it must be a Structure")
    threshold = finite("slack_below", slack_below, " [N]")
    places = real_array("nodes", nodes, (len(structure.nodes), 3), "m", scalar=False)
    lengths = norm(np.subtract(*ends(structure, places)))
    if not np.all(lengths > 0):
        name = structure.rods[int(np.argmin(lengths))].name
        raise OptionError(f"nodes: the ends of rod '{name}' coincide; a rod has a length")
    forces = real_array("rod_forces", rod_forces, (len(structure.rods),), "N", scalar=False)
    pulls = real_array("tensions", tensions, (len(structure.strings),), "N", scalar=False)
    loads = MemberLoads(structure, forces[None], lengths[None], pulls[None], chosen=chosen)
    slack = tuple(string.name for string, pull in zip(structure.strings, pulls, strict=True) if pull <= threshold)
    return MemberCheck(loads, tuple(loads.largest()), slack)


def check_state(state: StaticState, *, slack_below: float = 0.0) -> MemberCheck:
    """Check the members in a state of equilibrium; see `check_members`."""
    where = (state.model.structure, state.nodes, state.rod_forces, state.tensions)
    return check_members(*where, slack_below=slack_below, chosen=state.determinacy.chosen)


def check_trajectory(run: Trajectory, *, slack_below: float = 0.0) -> TrajectoryCheck:
    """Check the members over a run, at its recorded times; peaks between them are not seen.

    N is the recorded force density of a rod times its length, and T the recorded tension, damping included. A diverged
    run is checked up to its first sample that is not finite.

    Raises:
        OptionError: if it is no run, or one without samples.
    """
    instance("run", run, Trajectory, "it must be a Trajectory")
    threshold = finite("slack_below", slack_below, " [N]")
    sound = [np.isfinite(part).all(axis=1) for part in (run.rod_force_densities, run.tensions)]
    sound.append(np.isfinite(run.nodes).all(axis=(1, 2)))
    good = np.logical_and.reduce(sound)
    count = len(good) if good.all() else int(np.argmin(good))
    if not count:
        raise OptionError(f"the run of scene '{run.scene.name}' has no finite samples: there is nothing to check")
    structure, times = run.scene.structure, run.time[:count]
    lengths = norm(np.subtract(*ends(structure, run.nodes[:count])))
    forces = run.rod_force_densities[:count] * lengths
    chosen = tuple(rod.name for rod in structure.rods if rod.name in run.scene.redundancy.undetermined)
    loads = MemberLoads(structure, forces, lengths, run.tensions[:count], times, chosen)
    slack = _slack_intervals(run, times, loads.tensions <= threshold)
    return TrajectoryCheck(loads, tuple(loads.largest()), loads.first_exceeded, slack)


def _slack_intervals(run: Trajectory, times: Array, slack: NDArray[np.bool_]) -> tuple[SlackInterval, ...]:
    breaks = {event.string: event.time for event in run.scene.breaks}
    found = []
    for string, column in zip(run.scene.structure.strings, slack.T, strict=True):
        whole = column & (times < breaks.get(string.name, np.inf))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], whole.astype(int), [0]])))
        found += [
            SlackInterval(string.name, float(times[start]), float(times[end - 1]))
            for start, end in zip(edges[::2], edges[1::2], strict=True)
        ]
    return tuple(found)
