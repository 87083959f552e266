"""One way to compute a run (an integrator or a method), climbed from coarse to fine: what its runs say, and what next.

A rung is a run with one setting: a step [s] or a tolerance. Nothing here knows an engine, so that the search can be
tested on sequences whose errors are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tensegrity_mj.convergence import (
    LEAST_ORDER,
    SAFETY,
    Estimate,
    common_times,
    highest_order,
    judge,
    judge_tolerances,
    node_difference,
    observed_order,
)
from tensegrity_mj.errors import TensegrityError
from tensegrity_mj.trajectory import Status, Trajectory

AIM = 0.9  # of the accuracy asked for: what the search aims at, lest it misses narrowly
# Times finer than the last run, at most, in one go, by the order that was seen: a low one is that of runs that are too
# coarse to show any, or of kinks, and says little of finer ones.
FURTHEST = ((2.5, 8.0), (1.5, 4.0), (0.0, 2.0))
LAST = 2.4  # times finer than the last run: the finest run is verified by one that is no coarser than this
LEAST_REFINEMENT = 1.4  # runs whose steps are nearer say nothing of an order
PAIR = 2.0  # the refinement of two runs that are to be compared
STRIKES = 5  # differences in a row that do not settle, until a ladder is given up
FAILURES = 10  # runs in a row that diverge
TOLERANCES = 30.0  # between a run and the one that verifies it
LEAST_TOLERANCE = 3e-14


@dataclass(frozen=True)
class Rung:
    """One run.

    Attributes:
        setting: the step [s] or the relative tolerance.
        run: None where it failed.
        work: what it cost, in units of the cost model.
        failure: why it failed.
    """

    setting: float
    run: Trajectory | None
    work: float
    failure: TensegrityError | None = None


@dataclass
class Ladder:
    """The runs of one method so far.

    Attributes:
        name: of the method.
        order: on smooth motion; 0 for a method that controls its error by a tolerance.
        first: the coarsest setting.
        growth: its work grows as setting^-growth.
        first_work: what a run with `first` may cost, until one has been made.
        fit: the nearest setting that can be run, not coarser than a given one.
        floor: [m], below which differences are round-off.
        least: the finest setting that can be run.
        located: whether its steps end where strings go slack or taut, so that these do not lower its order.
        dead: why it is given up, or "".
    """

    name: str
    order: int
    first: float
    growth: float
    first_work: Callable[[], float]
    fit: Callable[[float], float]
    floor: float
    least: float
    located: bool = False
    rungs: list[Rung] = field(default_factory=list)
    differences: list[float] = field(default_factory=list)
    dead: str = ""
    strikes: int = 0
    highest: int = 0  # order that the motion of the last run allows

    @property
    def rank(self) -> float:
        """Of methods, by how fast their errors fall with work."""
        return float(self.order) if self.order else 1 / self.growth

    @property
    def good(self) -> list[Rung]:
        """The runs since the last that failed."""
        failed = [number for number, rung in enumerate(self.rungs) if rung.run is None]
        return self.rungs[failed[-1] + 1 :] if failed else self.rungs

    def add(self, rung: Rung) -> None:
        """A new run, finer than all before."""
        before = self.good
        last = before[-1].run if before else None
        self.rungs.append(rung)
        if rung.run is None:
            self.differences = []
            if len(self.rungs) >= FAILURES and not any(one.run for one in self.rungs[-FAILURES:]):
                self.dead = f"{FAILURES} runs in a row failed, the last: {rung.failure}"
            return
        self.highest = self.order if self.located else highest_order(rung.run, self.order)
        if last is not None:
            self.differences.append(difference(last, rung.run))
            # That runs stop early says nothing against their differences: finer ones may go further.
            judged = self._judged()
            self.strikes = 0 if judged.settled else self.strikes + 1
            if self.strikes >= STRIKES:
                self.dead = judged.reason
        if rung.setting <= self.least * (1 + 1e-12):
            self.dead = self.dead or f"{self.name} can go no finer"

    @property
    def estimate(self) -> Estimate | None:
        """What the runs say of the last of them; None before there are two."""
        if not self.differences:
            return None
        found, last = self._judged(), self.good[-1].run
        assert last is not None
        if last.status is not Status.COMPLETED:
            reason = f"the run stops at t = {last.time[-1]:.6g} s ({last.message})"
            return Estimate(found.value, False, f"{reason}; before, {found.reason}")
        return found

    def _judged(self) -> Estimate:
        """What the differences say of the last run, until it stopped."""
        recent = self.differences[-2:]
        if not self.order:
            return judge_tolerances(recent, self.floor)
        steps = [rung.setting for rung in self.good][-1 - len(recent) :]
        return judge(recent, steps, self.order, self.floor, self.highest)

    def work(self, setting: float) -> float:
        """What a run with this setting may cost."""
        if not self.rungs:
            return self._plain_work(setting)
        done = [rung for rung in self.rungs if rung.run is not None] or self.rungs
        last = done[-1]
        known = last.work if last.run is not None else self._plain_work(last.setting)
        if self.located:
            # What it takes to find where strings go slack is much the same for any step.
            return self._plain_work(setting) + max(0.0, known - self._plain_work(last.setting))
        return known * float((last.setting / setting) ** self.growth)

    def _plain_work(self, setting: float) -> float:
        return self.first_work() * (self.first / setting) ** self.growth

    def next(self, accuracy: float) -> tuple[float, float]:
        """The next setting, and the work from here to a verified result as far as can be seen."""
        pair = PAIR if self.order else TOLERANCES
        good = self.good
        if not self.rungs:
            return self._two(self.first, pair)
        last = self.rungs[-1].setting
        if not good:
            return self._two(last / pair, pair)
        if not self.differences:
            finer = self._fit(last / pair)
            return finer, self.work(finer)
        needed = self._refinement(accuracy)
        if not self.order:
            coarse = self._fit(last / needed)
            if needed <= 1.0:
                finer = self._fit(last / pair)
                return finer, self.work(finer)
            return self._two(coarse, pair)
        if needed <= LAST:
            finer = self._fit(last / max(needed, PAIR if self.highest < self.order else LEAST_REFINEMENT))
            return finer, self.work(finer)
        final = last / needed
        furthest = next(most for order, most in FURTHEST if self.observed_order >= min(order, self.order))
        coarse = self._fit(max(final * PAIR, last / furthest))
        return coarse, self.work(coarse) + self.work(final)

    def _refinement(self, accuracy: float) -> float:
        """How many times finer than the last run the final one must be; of a tolerance, the final but one."""
        estimate = self.estimate
        assert estimate is not None
        if not math.isfinite(estimate.value):
            return PAIR
        if not self.order:
            # The last run's own error is TOLERANCES times less than the difference, if it follows the tolerance.
            return min(1e3, self.differences[-1] / TOLERANCES / (AIM * accuracy))
        if not estimate.settled:
            return 1.0 if estimate.value <= accuracy else PAIR * LAST
        good = self.good
        if len(self.differences) == 1:
            # The full order is hoped for; what comes will show it.
            ratio = good[-2].setting / good[-1].setting
            error = SAFETY * self.differences[-1] / (ratio**self.order - 1)
            return float(max(error / (AIM * accuracy), 1e-30) ** (1 / self.order))
        # An order below 2 of a method of a higher one is that of runs too coarse: finer ones will show a better one.
        order = max(self.observed_order, min(2.0, self.order))
        return float((estimate.value / (AIM * accuracy)) ** (1 / order))

    @property
    def observed_order(self) -> float:
        """What the last three runs show, between 1/2 and the method's."""
        if len(self.differences) < 2 or not self.differences[-1] > 0 or not math.isfinite(self.differences[-2]):
            return float(self.order)
        a, b, c = (rung.setting for rung in self.good[-3:])
        seen = observed_order(self.differences[-2] / self.differences[-1], a / b, b / c, self.order)
        return min(max(seen, LEAST_ORDER), float(self.highest))

    def steps_for(self, error: float, duration: float) -> float:
        """How many steps it took to come within an error [m] of a coarser run; those of the finest, if none has."""
        good = self.good
        close = [two for two, found in zip(good[1:], self.differences, strict=True) if found <= error]
        finest = good[-1] if good else self.rungs[-1] if self.rungs else None
        chosen = close[0] if close else finest
        return duration / (self.first if chosen is None else chosen.setting)

    def _two(self, coarse: float, pair: float) -> tuple[float, float]:
        coarse = self._fit(coarse)
        return coarse, self.work(coarse) + self.work(max(coarse / pair, self.least))

    def _fit(self, setting: float) -> float:
        return self.fit(max(setting, self.least))


def difference(a: Trajectory, b: Trajectory) -> float:
    """Largest node distance [m]; of two runs that both stopped for the same reason, until the first of them stopped."""
    if a.status is b.status and a.status is not Status.COMPLETED and len(a.time) > 1 and len(b.time) > 1:
        first, second = common_times(a.time[:-1], b.time[:-1])  # the last sample is where each stopped
        largest = float(np.max(np.linalg.norm(a.nodes[first] - b.nodes[second], axis=-1), initial=0.0))
        return largest if math.isfinite(largest) else math.inf
    return node_difference(a, b)
