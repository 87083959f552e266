"""The reference engine: the thesis' differential-algebraic equations (chapter 2) in non-minimal coordinates.

State: q = (z, b) of every rod, q̇, and the work integrals of the energy ledger, integrated beside it. MuJoCo takes
no part.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.checks import member, positive
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.engines.dae_kernels import (
    CONSTANTS,
    MULTIPLIERS,
    POINT_COUNT,
    POINTS,
    Q_SIZE,
    ROD_COUNT,
    RODS,
    WORK,
    rk4_steps,
)
from tensegrity_mj.engines.run import (
    Grid,
    Progress,
    Request,
    Stopwatch,
    allocate_rows,
    blame_divergence,
    check_energy,
    chunks,
    make_trajectory,
)
from tensegrity_mj.errors import DivergenceError, OptionError, TensegrityError
from tensegrity_mj.law import SOLVED
from tensegrity_mj.native.plant import Plant, row_width
from tensegrity_mj.native.pointers import address_of
from tensegrity_mj.trajectory import Status, Trajectory

Array = NDArray[np.float64]


class Method(enum.Enum):
    """How the equations are integrated."""

    DOP853 = "dop853"  # SciPy's explicit Runge-Kutta 8(5,3), error-controlled
    RADAU = "radau"  # SciPy's implicit Radau IIA of order 5, error-controlled, for stiff strings
    RK4 = "rk4"  # classical, fixed step, compiled


class Drift(enum.Enum):
    """The treatments of constraint drift of §3.2.6."""

    MONITOR = "monitor"  # report it
    NORMALIZE = "normalize"  # (3.23)-(3.24) after each step
    BAUMGARTE = "baumgarte"  # (3.25)-(3.26) in the equations


@dataclass(frozen=True)
class DAE:
    """Options of the reference engine.

    Attributes:
        method: see `Method`.
        rtol, atol: tolerances of the error-controlled methods.
        timestep: [s], of RK4 only.
        drift: see `Drift`; the drift is reported whatever is chosen.
        baumgarte_frequency, baumgarte_damping: ω [rad/s] and ζ of k_p = ω², k_d = 2 ζ ω.
        max_steps: of the error-controlled methods, before the run is given up.
    """

    method: Method = Method.DOP853
    rtol: float = 1e-10
    atol: float = 1e-12
    timestep: float | None = None
    drift: Drift = Drift.MONITOR
    baumgarte_frequency: float = 10.0
    baumgarte_damping: float = 1.0
    max_steps: int = 1_000_000

    def __post_init__(self) -> None:
        member("DAE: method", self.method, Method)
        member("DAE: drift", self.drift, Drift)
        if self.method is Method.RK4:
            object.__setattr__(
                self, "timestep", positive("DAE: timestep (Method.RK4 has a fixed one)", self.timestep, "s")
            )
        elif self.timestep is not None:
            raise OptionError(f"DAE: timestep = {self.timestep!r}: {self.method.name} chooses its steps; leave it out")
        for name in ("rtol", "atol", "baumgarte_frequency", "baumgarte_damping"):
            object.__setattr__(self, name, positive(f"DAE: {name}", getattr(self, name)))
        if max(self.rtol, self.atol) > 1e-2:
            raise OptionError(f"DAE: rtol = {self.rtol:g}, atol = {self.atol:g}; both must be <= 1e-2")
        if self.rtol < 100 * np.finfo(float).eps:
            raise OptionError(f"DAE: rtol = {self.rtol:g} is below what double precision can hold; use >= 2.3e-14")
        if not isinstance(self.max_steps, int) or isinstance(self.max_steps, bool) or self.max_steps < 1:
            raise OptionError(f"DAE: max_steps = {self.max_steps!r}; it must be an integer >= 1")

    def __str__(self) -> str:
        if self.method is Method.RK4:
            return f"DAE RK4, h = {self.timestep:g} s, drift: {self.drift.value}"
        return f"DAE {self.method.name}, rtol = {self.rtol:g}, atol = {self.atol:g}, drift: {self.drift.value}"

    def run(self, request: Request) -> Trajectory:
        """Simulate; called by `simulate`."""
        run = DAERun(self, request)
        if self.method is Method.RK4:
            return run.fixed_step()
        from tensegrity_mj.engines.dae_adaptive import ErrorControlled

        return ErrorControlled(run).integrate()


class DAERun:
    """One run: the plant, its table of arrays, the state y."""

    def __init__(self, options: DAE, request: Request) -> None:
        self.options, self.request = options, request
        self.plant = Plant(request.scene, request.law, request.actuation, request.on_infeasible)
        structure = request.scene.structure
        self.records = records = StructureRecords.of(structure)
        baumgarte = options.drift is Drift.BAUMGARTE
        kp = options.baumgarte_frequency**2 if baumgarte else 0.0
        kd = 2 * options.baumgarte_damping * options.baumgarte_frequency if baumgarte else 0.0
        self.constants = np.array([*request.scene.gravity, kp, kd])
        self.multipliers = np.zeros(len(records.rods))
        self.table = table = self.plant.table
        table[RODS], table[ROD_COUNT] = address_of(records.rods), len(records.rods)
        table[POINTS], table[POINT_COUNT] = address_of(records.points), len(records.points)
        table[Q_SIZE] = records.nq
        table[CONSTANTS], table[MULTIPLIERS] = address_of(self.constants), address_of(self.multipliers)
        self.y = np.zeros(2 * records.nq + WORK)
        self.y[: records.nq] = records.coordinates(request.scene.nodes0)
        self.y[records.nq : 2 * records.nq] = records.coordinates(request.scene.velocities0)
        self.width = row_width(table) + len(records.rods)
        self.evaluations = 0
        self.steps = 0

    def finish(
        self, time: Array, rows: Array, status: Status, message: str, seconds: float, **reports: Any
    ) -> Trajectory:
        """The trajectory of the rows recorded so far."""
        width = row_width(self.table)
        options = {name: getattr(value, "value", value) for name, value in vars(self.options).items()}
        return make_trajectory(
            self.request,
            time,
            rows[:, :width],
            multipliers=rows[:, width:].copy(),
            engine=str(self.options),
            status=status,
            message=message,
            cost={"wall_time": seconds, "steps": self.steps, "evaluations": self.evaluations},
            provenance={"engine": {"name": "DAE", **options}},
            reports=reports,
        )

    def fixed_step(self) -> Trajectory:
        """Classical Runge-Kutta."""
        step = self.options.timestep
        assert step is not None
        grid = Grid.of(self.request, step)
        times = grid.times
        rows = allocate_rows(len(times), self.width)
        fix = self.options.drift is Drift.NORMALIZE
        remedy = f"reduce the time step (h = {step:g} s), or use Method.RADAU where strings are stiff"
        arguments = (grid.count, grid.stride, grid.ratio, fix, rows)
        rk4_steps(self.table, self.y.copy(), step, 1, 0, *arguments)  # compiles
        clock = Stopwatch()
        with Progress(self.request, "DAE RK4") as progress:
            for first, count in chunks(grid.count):
                reached, status = rk4_steps(self.table, self.y, step, first, count, *arguments)
                self.steps, self.evaluations = reached, 4 * reached
                progress.reached(reached * step)
                if status != SOLVED:
                    time = reached * step
                    before = max(1, int(np.searchsorted(times, time - 0.5 * step)))
                    partial = self.finish(times[:before], rows[:before], Status.DIVERGED, "diverged", clock.seconds)
                    try:
                        self.plant.raise_if_failed(status, time)
                    except TensegrityError:
                        blame_divergence(partial, self.plant, time, remedy)
                        raise
                    blame_divergence(partial, self.plant, time, remedy)
                    kept = np.concatenate([times[times < time - 0.5 * step], [time]])
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
