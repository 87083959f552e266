"""Equations of motion integrated by this package: methods, their options, and one run of a model, whichever it is."""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.checks import member, positive
from tensegrity_mj.engines import integration_kernels as kernels
from tensegrity_mj.engines.accuracy import check_accuracy
from tensegrity_mj.engines.divergence import blame_divergence, check_energy
from tensegrity_mj.engines.integration_kernels import SINGULAR
from tensegrity_mj.engines.integration_rk4 import rk4_steps
from tensegrity_mj.engines.run import (
    Grid,
    Progress,
    Request,
    Stopwatch,
    allocate_rows,
    chunks,
    make_trajectory,
)
from tensegrity_mj.errors import DivergenceError, InfeasibleError, OptionError, TensegrityError
from tensegrity_mj.law import NO_SOLUTION, SOLVED
from tensegrity_mj.native.plant import HELD, RESOLUTION, RESOLUTION_KIND, STATUS, WATCHED, Plant, row_width
from tensegrity_mj.native.pointers import address_of
from tensegrity_mj.native.resolution import STAGES
from tensegrity_mj.trajectory import Status, Trajectory

Array = NDArray[np.float64]


class Method(enum.Enum):
    """How the equations are integrated."""

    DOP853 = "dop853"  # SciPy's explicit Runge-Kutta 8(5,3), error-controlled
    RADAU = "radau"  # SciPy's implicit Radau IIA of order 5, error-controlled, for stiff strings
    RK4 = "rk4"  # classical, fixed step, compiled


class Options(Protocol):
    """What the integrators need of an engine's options."""

    @property
    def method(self) -> Method: ...
    @property
    def rtol(self) -> float: ...
    @property
    def atol(self) -> float: ...
    @property
    def timestep(self) -> float | None: ...
    @property
    def locate_slack(self) -> bool: ...
    @property
    def max_steps(self) -> int: ...
    @property
    def accuracy(self) -> float | None: ...


def check_options(engine: str, options: Any) -> None:
    """Validate the fields of `Options` in a frozen dataclass, and make floats of its numbers.

    Raises:
        OptionError: naming engine, option, value and what is allowed.
    """
    member(f"{engine}: method", options.method, Method)
    if options.method is Method.RK4:
        step = positive(f"{engine}: timestep (Method.RK4 has a fixed one)", options.timestep, "s")
        object.__setattr__(options, "timestep", step)
    elif options.timestep is not None:
        raise OptionError(
            f"{engine}: timestep = {options.timestep!r}: {options.method.name} chooses its steps; leave it out"
        )
    if not isinstance(options.locate_slack, bool):
        raise OptionError(f"{engine}: locate_slack = {options.locate_slack!r}; it must be True or False")
    if options.locate_slack and options.method is not Method.RK4:
        raise OptionError(
            f"{engine}: locate_slack = True with {options.method.name}, whose steps shorten where strings go slack; "
            "it belongs to Method.RK4: leave it out"
        )
    for name in ("rtol", "atol"):
        object.__setattr__(options, name, positive(f"{engine}: {name}", getattr(options, name)))
    if max(options.rtol, options.atol) > 1e-2:
        raise OptionError(f"{engine}: rtol = {options.rtol:g}, atol = {options.atol:g}; both must be <= 1e-2")
    if options.rtol < 100 * np.finfo(float).eps:
        raise OptionError(f"{engine}: rtol = {options.rtol:g} is below what double precision can hold; use >= 2.3e-14")
    if options.accuracy is not None:
        chosen = {
            "method": (options.method, Method.DOP853),
            "timestep": (options.timestep, None),
            "rtol": (options.rtol, 1e-10),
            "atol": (options.atol, 1e-12),
        }
        object.__setattr__(options, "accuracy", check_accuracy(engine, options.accuracy, chosen))
    if not isinstance(options.max_steps, int) or isinstance(options.max_steps, bool) or options.max_steps < 1:
        raise OptionError(f"{engine}: max_steps = {options.max_steps!r}; it must be an integer >= 1")


def describe_method(options: Options) -> str:
    """The method with its step or tolerances, for people; the accuracy that chooses them."""
    if options.accuracy is not None:
        return f"accuracy {options.accuracy:g} m"
    if options.method is Method.RK4:
        located = ", slack located" if options.locate_slack else ""
        return f"RK4, h = {options.timestep:g} s{located}"
    return f"{options.method.name}, rtol = {options.rtol:g}, atol = {options.atol:g}"


class IntegratedRun:
    """One run of a model: the plant, its table, the state y, and what is made of the recorded rows.

    Attributes:
        name: of the engine.
        options: the engine's.
        y: the state: at first the start's, and later that which the fixed-step method has reached.
        functions: addresses of the model's rates and place, and of project and guard (0: none).
        explain_singular: says why the state that `guard` or `rates` refused last cannot be held, and what to do.
    """

    def __init__(
        self,
        name: str,
        options: Options,
        request: Request,
        plant: Plant,
        y: Array,
        *,
        rates: int,
        place: int,
        project: int = 0,
        guard: int = 0,
        multipliers: Array,
        keep: tuple[Any, ...] = (),
        explain_singular: Callable[[float], str] | None = None,
    ) -> None:
        self.name, self.options, self.request, self.plant, self.y = name, options, request, plant, y
        if request.scene.contact is not None:
            raise OptionError(
                f"{name}: scene '{request.scene.name}' has contact, which MuJoCo alone has: "
                "run it with MuJoCo, or without contact as scene.with_(contact=None)"
            )
        self.table = table = plant.table
        self.projects = bool(project)
        self.multipliers, self.keep = multipliers, keep  # alive while the table holds their addresses
        table[kernels.RATES], table[kernels.PLACE] = rates, place
        table[kernels.PROJECT], table[kernels.GUARD] = project, guard
        table[kernels.STATE_SIZE] = len(y)
        table[kernels.MULTIPLIERS], table[kernels.MULTIPLIER_COUNT] = address_of(multipliers), len(multipliers)
        self.explain_singular = explain_singular
        self.width = row_width(table) + len(multipliers)
        self.evaluations = 0
        self.steps = 0

    def integrate(self) -> Trajectory:
        """The whole run, by the method that the options ask for."""
        if self.options.method is Method.RK4:
            return self._fixed_step()
        from tensegrity_mj.engines.integration_adaptive import ErrorControlled

        return ErrorControlled(self).integrate()

    def rates_at(self, time: float, y: Array, rest_lengths: Array | None) -> Array:
        """dy/dt at one state, without a step; rest lengths (M,) [m] instead of the structure's where no law sets them.

        Raises:
            OptionError: where the model's coordinates cannot hold the state.
            InfeasibleError, ControllerError: what the law says there.
        """
        if rest_lengths is not None:
            self.plant[HELD][:] = rest_lengths
        out = np.empty(len(y))
        if SINGULAR in (kernels.guard(y, self.table), status := kernels.rates(time, y, out, self.table)):
            raise OptionError(self.singular_message(time))
        self.plant.raise_if_failed(max(status, int(self.table[STATUS])), time)
        if status == NO_SOLUTION:
            raise InfeasibleError(self.plant.infeasible_message(time))
        return out

    def singular_message(self, time: float) -> str:
        """What a run says that stopped because its coordinates cannot hold the state."""
        assert self.explain_singular is not None
        return self.explain_singular(time)

    def finish(
        self, time: Array, rows: Array, status: Status, message: str, seconds: float, **reports: Any
    ) -> Trajectory:
        """The trajectory of the rows recorded so far."""
        width = row_width(self.table)
        told = width + len(self.request.scene.structure.rods)  # behind λ: gaps of closed loops, where there are any
        if told < self.width:
            reports |= {
                "closure_drift": float(rows[:, told].max(initial=0.0)),  # [m]
                "closure_rate_drift": float(rows[:, told + 1].max(initial=0.0)),  # [m/s]
            }
        options = {name: getattr(value, "value", value) for name, value in vars(self.options).items()}
        return make_trajectory(
            self.request,
            time,
            rows[:, :width],
            multipliers=rows[:, width:told].copy(),
            engine=str(self.options),
            status=status,
            message=message,
            cost={"wall_time": seconds, "steps": self.steps, "evaluations": self.evaluations},
            provenance={"engine": {"name": self.name, **options}},
            reports=reports,
            plant=self.plant,
            step=self.options.timestep,
        )

    def _fixed_step(self) -> Trajectory:
        """Classical Runge-Kutta."""
        step = self.options.timestep
        assert step is not None
        grid = Grid.of(self.request, step)
        times = grid.times
        rows = allocate_rows(len(times), self.width)
        remedy = f"reduce the time step (h = {step:g} s), or use Method.RADAU where strings are stiff"
        arguments = (grid.count, grid.stride, grid.ratio, rows, self.options.locate_slack)
        rk4_steps(self.table, self.y.copy(), step, 1, 0, *arguments)  # compiles
        self.plant[WATCHED][:] = 0.0
        self.plant[RESOLUTION][:] = 0.0
        self.table[RESOLUTION_KIND] = STAGES
        clock = Stopwatch(self.request)
        with Progress(self.request, f"{self.name} RK4") as progress:
            for first, count in chunks(grid.count):
                reached, status, evaluations = rk4_steps(self.table, self.y, step, first, count, *arguments)
                self.steps, self.evaluations = reached, self.evaluations + evaluations
                progress.reached(reached * step)
                if status != SOLVED:
                    time = reached * step
                    kept = np.concatenate([times[times < time - 0.5 * step], [time]])
                    if status == SINGULAR:
                        message = self.singular_message(time)
                        kernels.rates(time, self.y, np.empty(len(self.y)), self.table)
                        kernels.observe(self.y, self.table, rows[len(kept) - 1])
                        run = self.finish(kept, rows[: len(kept)], Status.SINGULAR, message, clock.seconds)
                        check_energy(run, remedy)
                        return run
                    before = max(1, int(np.searchsorted(times, time - 0.5 * step)))
                    partial = self.finish(times[:before], rows[:before], Status.DIVERGED, "diverged", clock.seconds)
                    try:
                        self.plant.raise_if_failed(status, time)
                    except TensegrityError:
                        blame_divergence(partial, self.plant, time, remedy)
                        raise
                    blame_divergence(partial, self.plant, time, remedy)
                    message = self.plant.infeasible_message(time)
                    return self.finish(kept, rows[: len(kept)], Status.INFEASIBLE, message, clock.seconds)
                done = int(np.searchsorted(times, (first + count - 0.5) * step))
                if not np.all(np.isfinite(self.y)):
                    done = max(1, done)
                    check_energy(self.finish(times[:done], rows[:done], Status.DIVERGED, "", clock.seconds), remedy)
                    raise DivergenceError(
                        f"diverged by t = {reached * step:.6g} s: the state is no longer finite; {remedy}",
                        reached * step,
                        self.finish(times[:done], rows[:done], Status.DIVERGED, "", clock.seconds),
                    )
        self.plant.raise_if_failed(SOLVED, times[-1])  # a load, at the very end
        run = self.finish(times, rows, Status.COMPLETED, "", clock.seconds)
        check_energy(run, remedy)
        return run
