"""The least mass of members that yield or buckle, to global optimality, on plain arrays.

    minimise    Σ m_s + Σ m_b
    subject to  A_s T + A_b N + W m_b + f = 0      in every load case: what free coordinates must balance
                T ≥ T_least,   m_s ≥ a_s T,   m_b ≥ a_b |N|,   m_b ≥ c √(-N) where N < 0,   m ≥ m_least

A solid round bar of length ℓ under compression P needs c √P with c = 2 ρ ℓ² / √(π E) against buckling, and a P with
a = ρ ℓ / σ_y against yield. Buckling decides up to P* = (c/a)². So its mass is concave below P*, linear above, and the
problem has local minima. It is solved by branch and bound: between bounds on every N the convex envelope of the mass,
which is a maximum of straight lines, makes a linear program, whose optimum is a lower bound. Where the envelope is
below the mass there, bounds are split. The first program, without bounds, is that of yield alone. Upper bounds come
from linear programs as well: with a tangent of the root in its place, masses are at least as large as they must be.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.statics.stress_signs import linear_program

NO_FORCE = 1e-9  # of the largest force: below it a compression is the round-off of a linear program
ROUNDS = 4  # of tightening bounds on N before they are split, and of moving tangents


@dataclass(frozen=True, eq=False)
class Problem:
    """Numbers of the order of one: forces in units of the largest load, masses in units of a heavy member's.

    Attributes:
        strings, bars: A_s (q, M), A_b (q, R), the forces on the free coordinates of unit tensions and forces.
        weights: W (q, R) of unit bar masses.
        forces: f (K, q) of K load cases.
        string_yield, bar_yield: a_s (M,), a_b (R,).
        bar_buckling: c (R,).
        least_tension: (M,).
        least_string, least_bar: (M,), (R,) least masses.
    """

    strings: Array
    bars: Array
    weights: Array
    forces: Array
    string_yield: Array
    bar_yield: Array
    bar_buckling: Array
    least_tension: Array
    least_string: Array
    least_bar: Array

    def bar_mass(self, forces: Array) -> Array:
        """Return the masses that bars need under forces (..., R)."""
        root = self.bar_buckling * np.sqrt(np.maximum(0.0, -forces))
        return np.maximum(self.bar_yield * np.abs(forces), root)

    @property
    def switch(self) -> Array:
        """P* (R,): the compression above which yield decides."""
        return (self.bar_buckling / self.bar_yield) ** 2

    @cached_property
    def balance(self) -> sparse.csr_array:
        """The left side of the equations in (T_1, N_1, T_2, N_2, ..., m_s, m_b), a block of rows a case."""
        case = np.hstack([self.strings, self.bars])
        cases = sparse.kron(sparse.eye_array(len(self.forces)), sparse.csr_array(case))
        mass = np.hstack([np.zeros_like(self.strings), self.weights])
        return sparse.csr_array(sparse.hstack([cases, sparse.csr_array(np.tile(mass, (len(self.forces), 1)))]))


class Point(NamedTuple):
    """Tensions (K, M), bar forces (K, R), masses (M,) and (R,), and the sum of the masses."""

    tensions: Array
    forces: Array
    string_masses: Array
    bar_masses: Array
    mass: float


class Lines(NamedTuple):
    """Lines m ≥ slope · (-N) + offset, of case and bar."""

    case: NDArray[np.int64]
    bar: NDArray[np.int64]
    slope: Array
    offset: Array


@dataclass(frozen=True, eq=False)
class Optimum:
    """The best point that was found, the lower bound, and how many linear programs it took."""

    point: Point
    lower: float
    programs: int


@dataclass(eq=False)
class Search:
    """Branch and bound; the compression P = -N of every case and bar lies within bounds (K, R)."""

    problem: Problem
    tolerance: float
    most_programs: int
    programs: int = 0
    best: Point | None = None
    closed_at: float = np.inf  # the least bound of what needs no more search
    tie: Iterator[int] = field(default_factory=count)

    def run(self) -> Optimum | None:
        """Search for the optimum; None where no forces are in balance."""
        shape = (len(self.problem.forces), self.problem.bars.shape[1])
        low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
        root = self.solve(low, high)
        if root is None:
            return None
        self.improve(root)
        if not self.is_closed(root.mass):
            lows, highs = self.tightened(low, high)
            again = self.solve(lows, highs)
            if again is not None:
                low, high, root = lows, highs, again
                self.improve(root)
        todo = [(root.mass, next(self.tie), low, high, root)]
        while todo and not self.is_closed(todo[0][0]) and self.programs < self.most_programs:
            _, _, low, high, point = heapq.heappop(todo)
            gap = self.problem.bar_mass(_sound(point.forces)) - point.bar_masses
            where = np.unravel_index(int(np.argmax(gap)), gap.shape)
            if not gap[where] > 0.0:
                self.closed_at = min(self.closed_at, point.mass)  # the program's optimum is the problem's
                continue
            for bounds, other in ((high, low), (low, high)):
                side = bounds.copy()
                side[where] = -point.forces[where]
                lows, highs = (other, side) if bounds is high else (side, other)
                child = self.solve(lows, highs)
                if child is None:
                    continue
                self.improve(child)
                if self.is_closed(child.mass):
                    self.closed_at = min(self.closed_at, child.mass)
                else:
                    heapq.heappush(todo, (child.mass, next(self.tie), lows, highs, child))
        assert self.best is not None
        return Optimum(self.best, min([self.best.mass, self.closed_at, *(one[0] for one in todo[:1])]), self.programs)

    def is_closed(self, bound: float) -> bool:
        """Return whether no mass above this bound is better than the best by more than the tolerance."""
        return self.best is not None and bound >= self.best.mass * (1.0 - self.tolerance)

    def improve(self, point: Point) -> None:
        """Look for a better point from there: its bars as heavy as they must be, then along tangents."""
        if not self.problem.weights.any():
            masses = np.maximum(self.problem.least_bar, self.problem.bar_mass(_sound(point.forces)).max(axis=0))
            self.keep(point._replace(bar_masses=masses, mass=float(point.string_masses.sum() + masses.sum())))
        for _ in range(ROUNDS):
            found = self.along_tangents(point, 0.0) or self.along_tangents(point, NO_FORCE)
            if found is None and self.best is None:
                # Steep tangents make rods so heavy that they cannot bear themselves: try flatter ones.
                tried = (self.along_tangents(point, 10.0**power) for power in range(-6, 7))
                found = next((one for one in tried if one is not None), None)
            if found is None or not self.keep(found):
                return
            point = found

    def keep(self, point: Point) -> bool:
        """Make the point the best if it is lighter; return whether it is."""
        better = self.best is None or point.mass < self.best.mass * (1.0 - 1e-12)
        if better:
            self.best = point
        return better

    def along_tangents(self, near: Point, least: float) -> Point | None:
        """The best point where tangents at a point stand for the roots, or None if there is none.

        Tangents at no compression stand upright: bars with less than `NO_FORCE` get none, or tangents at `least`.
        """
        compression = np.maximum(-near.forces, least)
        pushed = compression >= NO_FORCE
        case, bar = np.nonzero(pushed)
        root = np.sqrt(compression[case, bar])
        half = 0.5 * self.problem.bar_buckling[bar]
        low = np.full(pushed.shape, -np.inf)
        return self.program(low, np.where(pushed, np.inf, 0.0), Lines(case, bar, half / root, half * root))

    def solve(self, low: Array, high: Array) -> Point | None:
        """The linear program of the envelopes, or None if it has no point."""
        return self.program(low, high, self.lines(low, high))

    def lines(self, low: Array, high: Array) -> Lines:
        """Lines of the envelopes, without those of yield, which always hold."""
        problem = self.problem
        start, end = np.maximum(low, 0.0), np.minimum(high, problem.switch)
        # A chord of the root, from `start` to where buckling stops to decide; that from 0 to P* is the line of yield.
        case, bar = np.nonzero((end > start) & ((start > 0.0) | (end < problem.switch)))
        first, last = np.sqrt(start[case, bar]), np.sqrt(end[case, bar])
        slope = problem.bar_buckling[bar] / (first + last)
        return Lines(case, bar, slope, slope * first * last)

    def tightened(self, low: Array, high: Array) -> tuple[Array, Array]:
        """The bounds that every point better than the best keeps, by linear programs a bar; none for many of them."""
        assert self.best is not None
        if 2 * low.size > self.most_programs // 4:
            return low, high
        low, high = low.copy(), high.copy()
        for _ in range(ROUNDS):
            before = self.concave(low, high)
            for where in np.ndindex(low.shape):
                if not self.concave(low, high)[where] > 0.0:
                    continue
                for sign, bounds in ((1.0, low), (-1.0, high)):
                    aim = np.zeros(low.shape)
                    aim[where] = sign
                    point = self.program(low, high, self.lines(low, high), aim)
                    if point is not None:
                        reach = float(-point.forces[where])
                        # Not quite as far as that, for the tolerance of linear programs.
                        bounds[where] = sign * max(sign * float(bounds[where]), sign * reach - 1e-9)
            if self.programs >= self.most_programs // 2 or self.concave(low, high).sum() > 0.8 * before.sum():
                break
        return low, high

    def concave(self, low: Array, high: Array) -> Array:
        """Return how much of the bounds lies where masses are concave, between 0 and P* (K, R)."""
        return np.asarray(np.maximum(0.0, np.minimum(high, self.problem.switch) - np.maximum(low, 0.0)))

    def program(self, low: Array, high: Array, lines: Lines, aim: Array | None = None) -> Point | None:
        """The least mass under those bounds and lines, or None if nothing obeys them.

        With `aim` (K, R): the least aim · P of all that is no heavier than the best.

        Raises:
            InfeasibleError: if the solver of linear programs fails.
        """
        problem = self.problem
        if np.any(low > high):
            return None
        self.programs += 1
        cases, (M, R) = len(problem.forces), (problem.strings.shape[1], problem.bars.shape[1])
        each, masses = M + R, cases * (M + R)
        case, string = (index.ravel() for index in np.indices((cases, M)))
        slopes = [problem.string_yield[string]]
        rows = [(each * case + string, masses + string)]
        case, bar = (index.ravel() for index in np.indices((cases, R)))
        for sign in (1.0, -1.0):
            slopes.append(sign * problem.bar_yield[bar])
            rows.append((each * case + M + bar, masses + M + bar))
        slopes.append(-lines.slope)
        rows.append((each * lines.case + M + lines.bar, masses + M + lines.bar))
        slope = np.concatenate(slopes)
        force, mass = (np.concatenate(column) for column in zip(*rows, strict=True))
        size = len(slope)
        places = np.arange(size)
        upper = sparse.csr_array(
            (
                np.concatenate([slope, np.full(size, -1.0)]),
                (np.concatenate([places, places]), np.concatenate([force, mass])),
            ),
            shape=(size, masses + M + R),
        )
        right = np.concatenate([np.zeros(size - len(lines.offset)), -lines.offset])
        cost = np.concatenate([np.zeros(masses), np.ones(M + R)])
        if aim is not None:
            assert self.best is not None
            upper = sparse.csr_array(sparse.vstack([upper, sparse.csr_array(cost[None])]))
            right = np.append(right, self.best.mass)
            cost = np.concatenate([np.hstack([np.zeros((cases, M)), -aim]).ravel(), np.zeros(M + R)])
        least = np.concatenate([np.broadcast_to(problem.least_tension, (cases, M)), -high], axis=1).ravel()
        most = np.concatenate([np.full((cases, M), np.inf), -low], axis=1).ravel()
        bounds = np.stack(
            [
                np.concatenate([least, problem.least_string, problem.least_bar]),
                np.concatenate([most, np.full(M + R, np.inf)]),
            ],
            axis=1,
        )
        for presolve in (True, False):  # which at times does not recognize the kind of failure
            balance = (problem.balance, -problem.forces.ravel())
            result = linear_program(cost, upper, right, kept=balance, bounds=bounds, presolve=presolve)
            if result.status in (0, 2):
                break
        if result.status == 2:
            return None
        if result.status != 0:
            raise InfeasibleError(f"sizing: the solver of linear programs failed ({result.message})")
        table = result.x[:masses].reshape(cases, each)
        string_masses, bar_masses = result.x[masses : masses + M], result.x[masses + M :]
        return Point(
            table[:, :M], table[:, M:], string_masses, bar_masses, float(string_masses.sum() + bar_masses.sum())
        )


def _sound(forces: Array) -> Array:
    """Forces without the round-off of a linear program, of which the root would make something."""
    return np.where(np.abs(forces) < NO_FORCE, 0.0, forces)
