"""Error-controlled integration by SciPy's solvers, stepped here so that control samples, breaking strings, switches of
a law that loses its solution, and outputs fall where they belong."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.integrate import DOP853, Radau

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.arrays import Array, bisect
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.dynamics.native.actuation import evaluate_law, remember, start_ledger
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED, Report
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS, REPORT_SIZE
from tensegrity_mj.dynamics.native.watch import watch_strings
from tensegrity_mj.engines import driving, recording, reports
from tensegrity_mj.engines.reference.equations import (
    SINGULAR,
    WORK,
    break_due_strings,
    guard,
    observe,
    project,
    rates,
    sample_law,
)
from tensegrity_mj.engines.reference.integration import IntegratedRun
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.reference.pulls import LOOKS, marks_of, pulls_within, turn_within
from tensegrity_mj.errors import DivergenceError, OptionError, TensegrityError
from tensegrity_mj.model import rods
from tensegrity_mj.runs.energy import check_energy
from tensegrity_mj.runs.trajectory import Status, Trajectory

# A law that loses and regains its solution more often than this slides along the boundary of the admissible set.
MAX_SWITCHES = 1000
JACOBIAN_STEP = 1.5e-8  # √eps: round-off and curvature spoil the difference alike
# At the pace of a run that needs a hundred times max_steps, it is given up long before.
CRAWL_STEPS = 5000
SWITCH_TOLERANCE = 1e-10  # s, to which the time of a switch is located
RETREAT = 0.2  # of a step, after a stage that the model's coordinates cannot hold: what SciPy takes at least, too
# Steps shrink without end where a law drives a structure on. Looked at every so many steps, such a run is given up once
# a rest length is that many sizes below zero, and the energy that square times what strings stretched by the size hold.
FAR, LOOK_AFTER = 10.0, 100
LEAST_SEARCHED = 1e-9  # of the duration: shorter steps are not searched for short pulls of strings
VANISHING_MARGIN = (
    1e-2  # of the largest margin before: below it, an integrator that gives up gave up for the law's sake
)


REMEDY = "use Method.RADAU for stiff strings, loosen the tolerances, or run a discontinuous law sampled"
BEYOND_FLOATS = (
    "accelerations or their derivatives are beyond double precision",
    "give masses, lengths, stiffnesses and forces that are nearer to 1 in SI units",
)


class _Stopped(Exception):
    """The law has no solution, and the caller wants to stop there."""


class _Singular(Exception):
    """The run has come to a state that the model's coordinates cannot hold."""


class _Outside(Exception):
    """A stage of a trial step cannot be held by the model's coordinates."""


class ErrorControlled:
    """One run with DOP853 or Radau."""

    def __init__(self, run: IntegratedRun) -> None:
        self.run, self.options, self.request = run, run.options, run.request
        self.table, self.plant = run.table, run.plant
        self.kind = DOP853 if run.options.method is Method.DOP853 else Radau
        self.t, self.y = run.request.begin, run.y
        self.mark_of_progress = -math.inf  # the first stretch has all the time it wants
        self.solver: Any = None
        self.dense: Any = None  # of the last step, once it was needed
        self.first_step: float | None = None
        self.longest_step, self.careful_until = math.inf, 0.0  # while a string is about to pull for a moment
        self.continuous = self.plant["mode"] == CONTINUOUS
        self.switches = 0
        self.times = driving.output_times(run.request)
        self.rows = recording.allocate_rows(len(self.times) + 1, run.width)  # one more, for where a run stops
        self.next = 0

    def integrate(self) -> Trajectory:
        """The whole run.

        Raises:
            DivergenceError: where the solver cannot go on, or energy comes from nowhere.
        """
        rates(self.t, self.y, np.empty(len(self.y)), self.table)  # compiles
        self.clock = driving.Stopwatch(self.request)
        # DOP853's dense output has a local error of the order of the method's global one; Radau's has not, so there
        # the solver steps onto the output times.
        marks = marks_of(self.request, self.times, with_outputs=self.kind is Radau)
        try:
            with driving.progress(self.request, f"{self.run.name} {self.options.method.name}") as show:
                self._start()
                for mark, is_jump, is_sample in marks:
                    while self.t < mark:
                        self._step(mark, keep_last=is_jump)
                        show(self.t)
                    if break_due_strings(self.t, self.y, self.table):
                        self.solver = None
                    if is_sample:
                        self._sample()
                    if is_jump:
                        self._record(self.t, self.y, while_before=math.nextafter(mark, math.inf))
        except _Stopped:
            return self._stopped(Status.INFEASIBLE)
        except (_Singular, _Outside):
            return self._stopped(Status.SINGULAR)
        self._record(self.t, self.y, while_before=math.inf)
        run = self.run.finish(
            self.times, self.rows[:-1], Status.COMPLETED, "", self.clock.seconds, switches=self.switches
        )
        check_energy(run, "tighten rtol and atol")
        return run

    def _start(self) -> None:
        if guard(self.y, self.table) == SINGULAR:
            start_ledger(self.table)
            raise _Singular
        break_due_strings(self.t, self.y, self.table)
        if self.request.sampled:
            self._sample()
        _, status = self._rhs_status(self.t, self.y)
        watch_strings(self.table, self.t, self.continuous and status == SOLVED)
        start_ledger(self.table)
        if self.continuous and status == NO_SOLUTION:
            self._suspend()
        elif self.continuous:
            remember(self.table)
        self._record(self.t, self.y, while_before=math.nextafter(self.t, math.inf))

    def _sample(self) -> None:
        status = int(sample_law(self.t, self.y, self.table))
        self.plant.raise_if_failed(status, self.t)
        watch_strings(self.table, self.t, status == SOLVED)
        if status == NO_SOLUTION and not self.plant["passive"]:
            raise _Stopped
        self.solver = None  # what is held has jumped

    def _suspend(self) -> None:
        if not self.plant["passive"]:
            raise _Stopped
        self.plant["suspended"] = 1

    def _rhs_status(self, t: float, y: Array) -> tuple[Array, int]:
        """dy/dt, and the law's status at a state; leaves everything about the state in the table."""
        out = np.empty(len(y))
        status = int(rates(t, y, out, self.table))
        self.run.evaluations += 1
        if status == SINGULAR:
            raise _Outside
        if status > NO_SOLUTION or self.plant["status"]:
            self.plant.raise_if_failed(max(status, self.plant["status"]), t)
        return out, status

    def _rhs(self, t: float, y: Array) -> Array:
        return self._rhs_status(t, y)[0]

    def _jacobian(self, t: float, y: Array) -> Array:
        """∂(dy/dt)/∂y by forward differences, for Radau.

        SciPy's own widens its step tenfold each time in a column that changes nothing, until it overflows; work
        integrals and the place of a rod without strings are such columns.
        """
        here = self._rhs(t, y)
        jacobian = np.zeros((len(y), len(y)))
        size = self.plant["state_size"]  # behind the work integrals: states of elements
        for column in (*range(size - WORK), *range(size, len(y))):
            aside = y.copy()
            aside[column] += JACOBIAN_STEP * max(1.0, abs(y[column]))
            jacobian[:, column] = (self._rhs(t, aside) - here) / (aside[column] - y[column])
        return jacobian

    def _new_solver(self, mark: float) -> Any:
        options = self.options
        first = None if self.first_step is None else min(self.first_step, mark - self.t)
        implicit = {"jac": self._jacobian} if self.kind is Radau else {}
        return self.kind(
            self._rhs,
            self.t,
            self.y,
            mark,
            rtol=options.rtol,
            atol=options.atol,
            first_step=None if first is None else min(first, self.longest_step),
            max_step=self.longest_step,
            **implicit,
        )

    def _steps_over_a_pull(self, solver: Any) -> bool:
        """Return whether a string that is slack at both ends of a step pulls within it.

        Where rest lengths follow a law at every stage there is no such moment to look for.
        """
        if not self.plant["string_count"] or self.continuous or self.plant["holds_force_density"]:
            return False
        if solver.t - self.t < LEAST_SEARCHED * self.request.duration:
            return False
        return pulls_within(self.plant, self.t, float(solver.t), self.y, solver.y, self._interpolant)

    def _interpolant(self) -> Any:
        """The last step's states at any times within; made once, as it takes evaluations."""
        if self.dense is None:
            self.dense = self.solver.dense_output()
        return self.dense

    def _try_step(self, mark: float) -> str | None:
        """A step of the solver, shortened until all its stages are states that the model can hold."""
        while True:
            try:
                if self.solver is None:
                    self.solver = self._new_solver(mark)
                elif self.solver.t_bound != mark:
                    self.solver.t_bound, self.solver.status = mark, "running"
                if not math.isfinite(self.solver.h_abs):  # SciPy would try such a step for ever
                    self._give_up(*BEYOND_FLOATS)
                return self.solver.step()
            except (ValueError, np.linalg.LinAlgError) as error:
                if isinstance(error, TensegrityError) or self.kind is not Radau:
                    raise
                self._give_up(f"{BEYOND_FLOATS[0]} ({error})", BEYOND_FLOATS[1])  # matrices that are not finite
            except _Outside:
                tried = self.first_step if self.solver is None else self.solver.h_abs
                self.first_step = RETREAT * min(tried or math.inf, mark - self.t)
                self.solver = None
                if not self.first_step >= 16 * math.ulp(max(self.t, 1e-3 * mark)):
                    raise _Singular from None

    def _step(self, mark: float, keep_last: bool) -> None:
        """One accepted step, its outputs, and a switch within it."""
        problem = self._try_step(mark)
        solver, self.dense = self.solver, None
        interrupts.raise_if_requested()
        self.run.steps += 1
        if problem is not None or not np.all(np.isfinite(solver.y)):
            self._give_up(f"the step size fell below what double precision resolves ({problem})")
        if self.run.steps % CRAWL_STEPS == 0:
            if solver.t - self.mark_of_progress < CRAWL_STEPS / self.options.max_steps * self.request.duration / 100:
                self._give_up(
                    f"the last {CRAWL_STEPS} steps came only {solver.t - self.mark_of_progress:.2g} s further"
                )
            self.mark_of_progress = float(solver.t)
        if self.run.steps % LOOK_AFTER == 0:
            self._check_drive()
        if self.run.steps >= self.options.max_steps:
            self._give_up(f"max_steps = {self.options.max_steps} steps were not enough")
        if self._steps_over_a_pull(solver):
            # Again from where it began, in steps that cannot miss it.
            self.longest_step, self.careful_until = (solver.t - self.t) / LOOKS, max(self.careful_until, solver.t)
            self.solver = None
            return
        if solver.t >= self.careful_until and math.isfinite(self.longest_step):
            self.longest_step = solver.max_step = math.inf
        self.first_step = solver.h_abs
        end, switched = solver.t, False
        stuck = guard(solver.y, self.table) == SINGULAR
        if stuck:
            dense = self._interpolant()
            end, _ = bisect(lambda t: guard(dense(t), self.table) != SINGULAR, solver.t_old, solver.t, SWITCH_TOLERANCE)
        at_end = self._interpolant()(end) if stuck else solver.y
        if self.continuous and self._feasible(end, at_end) == bool(self.plant["suspended"]):
            switched, stuck = True, False
            end = self._locate(self._interpolant(), solver.t_old, end)
        turned = False
        if self.plant["yielding"] and not switched:
            turn = turn_within(self.plant, solver.t_old, end, self._interpolant())
            turned, stuck, end = turn < end, stuck and turn == end, turn
        limit = math.nextafter(end, -math.inf) if keep_last and end == mark else end
        outputs = self.times[self.next : np.searchsorted(self.times, limit, side="right")]
        if len(outputs):
            states = np.ascontiguousarray(self._interpolant()(outputs).T)
            for at, y in zip(outputs.tolist(), states, strict=True):
                self._record(at, solver.y if at == solver.t else y, while_before=math.nextafter(at, math.inf))
        if stuck:
            self.t, self.y = end, self._interpolant()(end)
            raise _Singular
        if switched or turned:
            self.t, self.y = end, self._interpolant()(end)
            if switched:
                self._switch()
            else:
                self.solver = None
        else:
            self.t, self.y = solver.t, solver.y
            if self.run.equations.project:
                project(self.y, self.table)
                solver.f = self._rhs(self.t, self.y)
            if self.continuous and not self.plant["suspended"]:
                self._rhs_status(self.t, self.y)
                watch_strings(self.table, self.t, True)
                remember(self.table)
        if self.plant["yielding"]:
            self.plant["arrived"] = 1
            self._rhs_status(self.t, self.y)

    def _check_drive(self) -> None:
        """Give up where the law drives the structure on beyond all that its strings could hold."""
        structure, rest = self.request.scene.structure, self.plant["rest"]
        size = float(np.linalg.norm(np.ptp(self.request.scene.nodes0, axis=0)))
        if not rest.min(initial=0.0) < -FAR * size:
            return
        energy = float(rods.kinetic_energy(structure, self.plant["velocities"][None])[0])
        most = 0.5 * FAR**2 * float(structure.stiffness.sum()) * size**2
        if energy > most > 0.0:
            name, least = structure.strings[int(np.argmin(rest))].name, quantity(float(rest.min()), "m", 2)
            self._give_up(
                f"the law drives the structure on: it moves with {quantity(energy, 'J', 2)}, and the rest length of "
                f"string '{name}' is {least}",
                "take a law that damps, or give strings min_rest_length or max_force_density",
            )

    def _feasible(self, t: float, y: Array) -> bool:
        self._rhs_status(t, y)  # places the nodes
        return int(evaluate_law(self.table, t)) != NO_SOLUTION

    def _locate(self, dense: Any, start: float, end: float) -> float:
        """The time within a step at which the law loses or regains its solution, by bisection."""
        was = not self.plant["suspended"]
        before, after = bisect(lambda t: self._feasible(t, dense(t)) == was, start, end, SWITCH_TOLERANCE)
        # On the far side when regained (the law must have a solution there), on the near side when lost.
        return before if was else after

    def _switch(self) -> None:
        self.solver = None
        self.switches += 1
        if self.switches > MAX_SWITCHES:
            raise OptionError(
                f"the law lost and regained its solution {self.switches} times by t = {self.t:.6g} s: it slides along "
                "the boundary of the admissible set, which the continuous mode cannot resolve; run it sampled"
            )
        if self.plant["suspended"]:
            self.plant["suspended"] = 0
        else:
            _, status = self._rhs_status(self.t, self.y)
            if status == SOLVED:
                remember(self.table)
            self._suspend()

    def _record(self, t: float, y: Array, while_before: float) -> None:
        """Write rows for the output times before a limit, all with this state."""
        while self.next < len(self.times) and self.times[self.next] < while_before:
            _, status = self._rhs_status(t, y)
            watch_strings(self.table, t, self.continuous and not self.plant["suspended"] and status == SOLVED)
            if self.plant["suspended"]:
                evaluate_law(self.table, t)  # for its margin and V; what it holds stays held
            observe(y, self.table, self.rows[self.next])
            self.next += 1

    def _stopped(self, status: Status) -> Trajectory:
        """Trajectory up to now, with the state at which the run stopped as its last row."""
        while self.next and self.times[self.next - 1] >= self.t:
            self.next -= 1
        time = np.append(self.times[: self.next], self.t)
        rates(self.t, self.y, np.empty(len(self.y)), self.table)
        if status is Status.INFEASIBLE and self.continuous:
            evaluate_law(self.table, self.t + SWITCH_TOLERANCE)
        observe(self.y, self.table, self.rows[self.next])
        if status is Status.INFEASIBLE:
            message = self.plant.infeasible_message(self.t)
        else:
            guard(self.y, self.table)  # names what is singular
            message = self.run.equations.explain_singular(self.t)
        return self.run.finish(
            time, self.rows[: len(time)], status, message, self.clock.seconds, switches=self.switches
        )

    def _give_up(self, cause: str, remedy: str = REMEDY) -> None:
        t = self.t if self.solver is None else float(self.solver.t)
        margin = float(self.plant["report"][Report.FEASIBILITY_MARGIN])
        width = self.plant["row_width"]
        reported = self.rows[: self.next, width - REPORT_SIZE : width]
        recorded = reported[:, Report.FEASIBILITY_MARGIN]
        # At a target margins are as large as V is small, and show nothing of later ones.
        away = ~(reported[:, Report.LYAPUNOV] <= reports.V_ROUND_OFF) & np.isfinite(recorded)
        if self.continuous and margin < VANISHING_MARGIN * np.max(np.abs(recorded[away]), initial=0.0):
            cause += f", where the law's margin max(v/α) tends to zero ({margin:.2g}) and so its u to infinity"
        partial = self.run.finish(
            self.times[: self.next], self.rows[: self.next], Status.DIVERGED, cause, self.clock.seconds
        )
        raise DivergenceError(f"the integration stopped at t = {t:.6g} s: {cause}; {remedy}", t, partial)
