"""Forces, limits and utilisations of a structure's members, row by row; `strength` has the formulas."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.model.plausibility import hardly_possible
from tensegrity_mj.model.structure import Structure


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
