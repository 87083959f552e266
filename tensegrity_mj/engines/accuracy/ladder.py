"""One way to compute a run (an integrator or a method), climbed from coarse to fine: what its runs say, and what next.

A rung is a run with one setting: a step [s] or a tolerance. Where a ladder goes next depends on its runs alone, and
never on the accuracy that is wanted, which only says where the climb ends. Nothing here knows an engine, so that the
climb can be tested on sequences whose errors are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tensegrity_mj.errors import ControllerError, DivergenceError, TensegrityError
from tensegrity_mj.runs import convergence
from tensegrity_mj.runs.trajectory import Status, Trajectory

HALF = 2.0  # of steps, from rung to rung
TOLERANCES = 30.0  # the same of tolerances
STRIKES = 5  # differences in a row that do not settle, until a ladder is given up
FAILURES = 10  # runs in a row that diverge
LEAST_TOLERANCE = 3e-14
ATOL_OF_RTOL = 1e-2  # of rtol
AS_ONE = 1e-9  # relative, of steps
# Cost of an evaluation by a method in those that a search counts: Radau's are called from Python, 30 to 60 µs each
# where compiled ones of DAE and ODE take 0.6 to 1.5; those of the DAE beside MuJoCo's take 0.3 µs for 3.
CERTIFIER = "dae rk4"
WEIGHTS = {"radau": 30.0, CERTIFIER: 0.1}
FIRST_STEP = "first_step_error"  # in a run's reports [m]: what its first step is wrong by, where differences hide it


@dataclass(frozen=True)
class Rung:
    """One run.

    Attributes:
        setting: the step [s] or the relative tolerance.
        run: None where it failed.
        evaluations: what it cost, in evaluations weighed by `WEIGHTS`.
        failure: why it failed.
    """

    setting: float
    run: Trajectory | None
    evaluations: float
    failure: TensegrityError | None = None

    @property
    def cost(self) -> dict[str, float]:
        """Cost of the run, or of the part of it before it failed."""
        run = self.run if self.run is not None else getattr(self.failure, "trajectory", None)
        return {} if run is None else dict(run.cost)


@dataclass
class Ladder:
    """The runs of one method so far, and how the next is made.

    Attributes:
        name: of the method.
        run: from a setting to a run.
        order: on smooth motion; 0 for a method that controls its error by a tolerance.
        first: the coarsest setting.
        growth: its cost grows as setting^-growth.
        first_cost: what a run with `first` may cost, until one has been made [evaluations].
        fit: the nearest setting that can be run, not coarser than a given one.
        floor: [m], below which differences are round-off.
        least: the finest setting that can be run.
        resolving: the longest step [s] that resolves a run's motion; runs of longer ones are no evidence. Any, where a
            method controls its error itself.
        located: whether its steps end where strings go slack or taut, so that these do not lower its order.
        aligned: whether they end at the kinks of data.
        dead: why it is given up, or "".
    """

    name: str
    run: Callable[[float], Trajectory]
    order: int
    first: float
    growth: float
    first_cost: float
    fit: Callable[[float], float]
    floor: float
    least: float
    resolving: Callable[[Trajectory], float] = lambda run: math.inf
    located: bool = False
    aligned: bool = True
    rungs: list[Rung] = field(default_factory=list)
    differences: list[float] = field(default_factory=list)
    dead: str = ""
    strikes: int = 0
    highest: int = 0  # order that the motion of the last run allows
    unread: list[Trajectory] = field(default_factory=list)  # runs whose rates have not been needed
    known: float = math.inf  # [s] step that resolves the motion of the others

    @property
    def rank(self) -> float:
        """Rank of the method, by how fast its errors fall with cost."""
        return float(self.order) if self.order else 1 / self.growth

    @property
    def weight(self) -> float:
        """Cost of one of its evaluations, in those that a search counts."""
        return WEIGHTS.get(self.name, 1.0)

    @property
    def spent(self) -> float:
        """Evaluations by all its runs."""
        return math.fsum(rung.evaluations for rung in self.rungs)

    @property
    def good(self) -> list[Rung]:
        """The runs since the last that failed."""
        failed = [number for number, rung in enumerate(self.rungs) if rung.run is None]
        return self.rungs[failed[-1] + 1 :] if failed else self.rungs

    def words(self, setting: float) -> dict[str, Any]:
        """An engine's options that a setting stands for, for reports."""
        if not self.order:
            return {"rtol": setting, "atol": ATOL_OF_RTOL * setting}
        return {"timestep": setting, **({"locate_slack": True} if self.located else {})}

    def climb(self, setting: float) -> Rung:
        """A new run; what stops it is kept too."""
        try:
            run = self.run(setting)
        except TensegrityError as error:
            # A law that fails may do so because the step was too coarse; what is refused is refused at any step.
            if not isinstance(error, (DivergenceError, ControllerError)):
                self.dead = str(error)
            partial = getattr(error, "trajectory", None)
            spent = partial.cost["evaluations"] if partial is not None else 0.0
            rung = Rung(setting, None, self.weight * spent, error)
        else:
            rung = Rung(setting, run, self.weight * run.cost["evaluations"])
        self.add(rung)
        return rung

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
        self.highest = self.order if self.located else convergence.highest_order(rung.run, self.order)
        self.highest = self.highest if self.aligned else min(self.highest, 2)
        self.unread.append(rung.run)
        if last is not None:
            self.differences.append(difference(last, rung.run))
            if self.resolved:
                # That runs stop early says nothing against their differences: finer ones may go further.
                judged = self._judged()
                self.strikes = 0 if judged.settled else self.strikes + 1
                if self.strikes >= STRIKES:
                    self.dead = judged.reason
        if rung.setting <= self.least * (1 + 1e-12):
            self.dead = self.dead or f"{self.name} can go no finer"

    @property
    def longest(self) -> float:
        """The longest step [s] that resolves the motion of the runs so far."""
        while self.unread:
            self.known = min(self.known, self.resolving(self.unread.pop()))
        return self.known

    @property
    def resolved(self) -> bool:
        """True where the step of the last run is short against the fastest motion."""
        return not self.order or self.good[-1].setting <= self.longest * (1 + AS_ONE)

    @property
    def estimate(self) -> convergence.Estimate | None:
        """Estimate of the last run's error from all runs; None before there are two."""
        if not self.differences:
            return None
        found, last = self._judged(), self.good[-1].run
        assert last is not None
        first = self._first_step_error
        if first > found.value:
            found = convergence.Estimate(
                first, found.settled, f"the first step alone is wrong by {first:.2g} m; {found.reason}"
            )
        if not self.resolved:
            reason = (
                f"the step of {self.good[-1].setting:.3g} s is too long for the fastest motion that is possible, which "
                f"takes one of {self.longest:.3g} s"
            )
            return convergence.Estimate(found.value, False, f"{reason}; {found.reason}")
        if last.status is not Status.COMPLETED:
            reason = f"the run stops at t = {last.time[-1]:.6g} s ({last.message})"
            return convergence.Estimate(found.value, False, f"{reason}; before, {found.reason}")
        return found

    @property
    def exhausted(self) -> bool:
        """True where the last run's error is round-off alone, so that finer runs are no better."""
        return bool(self.differences) and max(self.differences[-1], self._first_step_error) <= self.floor

    @property
    def _first_step_error(self) -> float:
        last = self.good[-1].run
        assert last is not None
        return convergence.SAFETY * float(last.reports.get(FIRST_STEP, 0.0))

    def _judged(self) -> convergence.Estimate:
        """Estimate of the last run's error from the differences, until it stopped."""
        last, good = self.good[-1].run, self.good[-3:]
        assert last is not None
        if not self.order:
            tolerance = good[-1].setting * float(np.max(np.abs(last.nodes), initial=0.0))
            return convergence.judge_tolerances(self.differences[-2:], self.floor, tolerance)
        # An order is that of runs which all have one.
        if len(good) > 2 and good[0].setting > HALF * self.longest * (1 + AS_ONE):
            good = good[1:]
        steps, kinks = [rung.setting for rung in good], convergence.has_kinks(last) or not self.aligned
        return convergence.judge(self.differences[1 - len(good) :], steps, self.order, self.floor, self.highest, kinks)

    def next(self) -> tuple[float, float]:
        """The next setting, and what its run may cost [evaluations]."""
        if not self.rungs:
            return self.fit(max(self.first, self.least)), self.weight * self.first_cost
        last = self.rungs[-1]
        finer = last.setting / (HALF if self.order else TOLERANCES)
        # The coarser of two runs that are evidence may be twice as coarse as the finer.
        setting = self.fit(max(min(finer, HALF * self.longest), self.least))
        known = last if last.run is not None else next((one for one in reversed(self.rungs) if one.run), None)
        if known is None:
            return setting, self.weight * self.first_cost * (self.first / setting) ** self.growth
        return setting, known.evaluations * (known.setting / setting) ** self.growth


def difference(a: Trajectory, b: Trajectory) -> float:
    """Largest node distance [m]; of two runs that both stopped for the same reason, until the first of them stopped."""
    if a.status is b.status and a.status is not Status.COMPLETED and len(a.time) > 1 and len(b.time) > 1:
        first, second = convergence.common_times(a.time[:-1], b.time[:-1])  # the last sample is where each stopped
        largest = float(np.max(np.linalg.norm(a.nodes[first] - b.nodes[second], axis=-1), initial=0.0))
        return largest if math.isfinite(largest) else math.inf
    return convergence.node_difference(a, b)
