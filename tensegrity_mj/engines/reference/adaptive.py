"""Error-controlled integration: the compiled loop of `controlled` in pieces, and what is made of where it comes to."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.dynamics.native.actuation import evaluate_law
from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS, REPORT_SIZE
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines import driving, recording, reports
from tensegrity_mj.engines.reference import controlled, dop853
from tensegrity_mj.engines.reference.controlled import JUMP, SAMPLE, SWITCH_TOLERANCE
from tensegrity_mj.engines.reference.equations import guard, observe, rates
from tensegrity_mj.engines.reference.floor import LONGEST_STEP
from tensegrity_mj.engines.reference.integration import IntegratedRun
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.reference.radau import RadauSteps
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import DivergenceError, OptionError, TensegrityError
from tensegrity_mj.model import rods
from tensegrity_mj.runs.energy import check_energy
from tensegrity_mj.runs.trajectory import Status, Trajectory

MOST_SAMPLES = 10_000_000  # of a law in a run: their times are laid out beforehand, in some gigabytes
# At the pace of a run that needs a hundred times max_steps, it is given up long before.
CRAWL_STEPS = 5000
# Steps shrink without end where a law drives a structure on. Looked at every so many steps, such a run is given up once
# a rest length is that many sizes below zero, and the energy that square times what strings stretched by the size hold.
FAR, LOOK_AFTER = 10.0, 100
LEAST_SEARCHED = 1e-9  # of the duration: shorter steps are not searched for short pulls of strings
GIVEN_UP = -1  # where a run came to, beside the answers of `dop853`
VANISHING_MARGIN = (
    1e-2  # of the largest margin before: below it, an integrator that gives up gave up for the law's sake
)


BEYOND = (
    "accelerations or their derivatives are beyond double precision",
    "give masses, lengths, stiffnesses and forces that are nearer to 1 in SI units",
)


class ErrorControlled:
    """One run with DOP853 or Radau.

    Attributes:
        times: (T,) [s] of the rows.
        rows: recorded so far, with room for one more.
        came_to: where it is.
    """

    def __init__(self, run: IntegratedRun) -> None:
        self.run, self.options, self.request, self.plant = run, run.options, run.request, run.plant
        self.table = run.table
        self.continuous = self.plant["mode"] == CONTINUOUS
        self.times = driving.output_times(run.request)
        self.rows = recording.allocate_rows(len(self.times) + 1, run.width)  # one more, for where a run stops
        self.mark_of_progress = -math.inf  # the first stretch has all the time it wants
        explicit = run.options.method is Method.DOP853
        # DOP853's dense output has a local error of the order of the method's global one; Radau's has not, so there
        # the solver steps onto the output times.
        marks = marks_of(run.request, self.times, with_outputs=not explicit)
        size, strings = len(run.y), self.plant["string_count"]
        self.own = own = Table("Controlled", dop853.CONTROLLED)
        own.set(
            table=self.table,
            sampled=run.request.sampled,
            continuous=self.continuous,
            least_searched=LEAST_SEARCHED * run.request.duration,
            rtol=run.options.rtol,
            atol=run.options.atol,
            t=run.request.begin,
            **dict.fromkeys(
                ("longest_step", "widest_step"), math.inf if run.request.scene.contact is None else LONGEST_STEP
            ),
            marks=np.array([mark for mark, _, _ in marks]),
            kinds=np.array([JUMP * jumps + SAMPLE * samples for _, jumps, samples in marks]),
            times=self.times,
            rows=self.rows,
            y=run.y,
            stages=np.zeros((dop853.STAGES_IN_ALL, size)),
            powers=np.zeros((dop853.POWERS, size)),
            **{name: np.zeros(size) for name in ("new", "x", "dy", "error")},
            **{name: np.zeros(strings, np.int64) for name in ("near", "longest")},
            gaps=np.zeros(strings),
        )
        self.radau = None if explicit else RadauSteps(own, self.plant)
        self.came_to = dop853.PAUSED
        self.cause: tuple[str, str] | None = None  # and remedy, where it is given up
        _ = controlled.advance.address  # compiles
        own["method"] = dop853.dop853_step.address if self.radau is None else self.radau.address

    def go(self) -> None:
        """Take the steps, up to where the run ends; see `conclude` for what becomes of it."""
        with driving.progress(self.request, f"{self.run.name} {self.options.method.name}") as show:
            for _, count in driving.chunks(self.options.max_steps):
                self.came_to = self._advance(count)
                show(self.own["t"])
                if self.came_to != dop853.PAUSED:
                    break

    @property
    def cost(self) -> dict[str, int]:
        """Steps and evaluations so far."""
        own = self.own
        return {
            "steps": own["steps"],
            "evaluations": own["evaluations"] + (self.radau.evaluations if self.radau else 0),
        }

    @property
    def ended_early(self) -> float | None:
        """The time [s] at which it ended before its time, or None."""
        return None if self.came_to == dop853.ENDED else self.own["t"]

    def conclude(self, seconds: float) -> Trajectory:
        """Return the run's trajectory, or raise the error that it ended with.

        Raises:
            DivergenceError: where the solver cannot go on, or energy comes from nowhere.
        """
        self.seconds, came_to = seconds, self.came_to
        if came_to == dop853.ENDED:
            run = self._finish(self.times, self.rows[:-1], Status.COMPLETED, "", switches=self.own["switches"])
            check_energy(run, "tighten rtol and atol")
            return run
        if came_to in (dop853.UNSOLVED, dop853.UNHELD):
            return self._stopped(Status.INFEASIBLE if came_to == dop853.UNSOLVED else Status.SINGULAR)
        raise self._failure(came_to)

    def _advance(self, count: int) -> int:
        """Take up to so many steps, and look at the run in between."""
        while count:
            piece = min(count, LOOK_AFTER - self.own["steps"] % LOOK_AFTER)
            came_to = controlled.advance(self.own.address, piece)
            if came_to != dop853.PAUSED:
                return int(came_to)
            count -= piece
            steps, t = self.own["steps"], self.own["t"]
            if steps % CRAWL_STEPS == 0:
                came = t - self.mark_of_progress
                if came < CRAWL_STEPS / self.options.max_steps * self.request.duration / 100:
                    self.cause = (f"the last {CRAWL_STEPS} steps came only {came:.2g} s further", self._remedy)
                self.mark_of_progress = t
            if steps % LOOK_AFTER == 0:
                self._check_drive()
            if self.cause:
                return GIVEN_UP
        return dop853.PAUSED

    def _failure(self, came_to: int) -> BaseException:
        """The error of a run that cannot go on from where it came to."""
        own, error = self.own, self.radau.error if self.radau else None
        if self.cause:
            return self._given_up(*self.cause)
        if came_to == dop853.FAILED:
            self.plant.raise_if_failed(max(own["answer"], self.plant["status"]), own["failed_at"])
        if came_to == dop853.SLIDES:
            return OptionError(
                f"the law lost and regained its solution {own['switches']} times by t = {own['t']:.6g} s: it slides "
                "along the boundary of the admissible set, which the continuous mode cannot resolve; run it sampled"
            )
        if came_to == dop853.BEYOND_FLOATS:
            return self._given_up(*BEYOND)
        if came_to == dop853.TOO_SHORT:
            return self._given_up("the step size fell below what double precision resolves")
        if isinstance(error, ValueError | np.linalg.LinAlgError) and not isinstance(error, TensegrityError):
            return self._given_up(f"{BEYOND[0]} ({error})", BEYOND[1])  # matrices that are not finite
        return error or self._given_up(f"max_steps = {self.options.max_steps} steps were not enough")

    def _finish(self, time: Array, rows: Array, status: Status, message: str, **reports: Any) -> Trajectory:
        return self.run.finish(time, rows, status, message, {"wall_time": self.seconds, **self.cost}, **reports)

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
            self.cause = (
                f"the law drives the structure on: it moves with {quantity(energy, 'J', 2)}, and the rest length of "
                f"string '{name}' is {least}",
                "take a law that damps, or give strings min_rest_length or max_force_density",
            )

    def _stopped(self, status: Status) -> Trajectory:
        """Trajectory up to now, with the state at which the run stopped as its last row."""
        t, y, rows = self.own["t"], self.own["y"], self.own["next"]
        while rows and self.times[rows - 1] >= t:
            rows -= 1
        time = np.append(self.times[:rows], t)
        rates(t, y, np.empty(len(y)), self.table)
        if status is Status.INFEASIBLE and self.continuous:
            evaluate_law(self.table, t + SWITCH_TOLERANCE)
        observe(y, self.table, self.rows[rows])
        if status is Status.INFEASIBLE:
            message = self.plant.infeasible_message(t)
        else:
            guard(y, self.table)  # names what is singular
            message = self.run.equations.explain_singular(t)
        return self._finish(time, self.rows[: len(time)], status, message, switches=self.own["switches"])

    @property
    def _remedy(self) -> str:
        other = "" if self.options.method is Method.RADAU else "use Method.RADAU for stiff strings, "
        return f"{other}{self.request.softer}loosen the tolerances, or run a discontinuous law sampled"

    def _given_up(self, cause: str, remedy: str = "") -> DivergenceError:
        remedy = remedy or self._remedy
        t, rows = self.own["t"], self.own["next"]
        margin = float(self.plant["report"][Report.FEASIBILITY_MARGIN])
        width = self.plant["row_width"]
        reported = self.rows[:rows, width - REPORT_SIZE : width]
        recorded = reported[:, Report.FEASIBILITY_MARGIN]
        # At a target margins are as large as V is small, and show nothing of later ones.
        away = ~(reported[:, Report.LYAPUNOV] <= reports.V_ROUND_OFF) & np.isfinite(recorded)
        if self.continuous and margin < VANISHING_MARGIN * np.max(np.abs(recorded[away]), initial=0.0):
            cause += f", where the law's margin max(v/α) tends to zero ({margin:.2g}) and so its u to infinity"
        partial = self._finish(self.times[:rows], self.rows[:rows], Status.DIVERGED, cause)
        return DivergenceError(f"the integration stopped at t = {t:.6g} s: {cause}; {remedy}", t, partial)


def marks_of(request: Request, times: Array, with_outputs: bool) -> list[tuple[float, bool, bool]]:
    """Times to step onto, each with whether something jumps there, and whether that is a sample of the law."""
    jumps: dict[float, bool] = {}

    def add(time: float, window: float, is_sample: bool) -> None:
        # The very float of an output or a sample where they coincide, so that no sliver of a step lies between.
        nearest = int(np.searchsorted(times, time - window))
        candidates = (float(times[min(nearest, len(times) - 1)]), *(() if is_sample else jumps))
        at = next((other for other in candidates if abs(other - time) < window), time)
        jumps[at] = jumps.get(at, False) or is_sample

    if request.sampled:
        period = request.actuation.period
        assert period is not None
        count = request.duration / period * (1 + 1e-12)
        if count > MOST_SAMPLES:
            raise OptionError(
                f"control period = {period:g} s: a run of {request.duration:g} s samples the law {count:.3g} times; at "
                f"most {MOST_SAMPLES} samples are taken: choose a longer period or a shorter run"
            )
        begun = math.floor(request.begin / period * (1 + 1e-12))
        for number in range(begun + 1, math.floor((request.begin + request.duration) / period * (1 + 1e-12)) + 1):
            add(number * period, 1e-9 * period, is_sample=True)
    for time in request.scene.break_times:
        if times[0] < time <= times[-1]:
            add(float(time), 1e-12 * time, is_sample=False)
    marks = {time: (True, is_sample) for time, is_sample in jumps.items()}
    if with_outputs:
        for time in times[1:]:
            marks.setdefault(float(time), (False, False))
    for motion in request.scene.motions:  # a derivative of data jumps at each of their times
        for time in motion.times:
            if times[0] < time < times[-1]:
                marks.setdefault(float(time), (False, False))
    marks.setdefault(float(times[-1]), (False, False))
    return [(time, *what) for time, what in sorted(marks.items())]
