"""Equations of motion integrated by this package: methods, their options, and one run of a model, whichever it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native import resolution, slack
from tensegrity_mj.dynamics.native.actuation import remember, start_ledger
from tensegrity_mj.dynamics.native.compiling import CFunction, c_function
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, SOLVED
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS
from tensegrity_mj.dynamics.native.pointers import borrowing, copy
from tensegrity_mj.dynamics.native.resolution import resolve_start
from tensegrity_mj.dynamics.native.views import Table, changing_view, fields_of
from tensegrity_mj.dynamics.native.watch import watch_strings
from tensegrity_mj.engines.continuing import saved_state
from tensegrity_mj.engines.driving import Grid, drive
from tensegrity_mj.engines.recording import Account, allocate_rows, make_trajectory
from tensegrity_mj.engines.reference.equations import (
    SINGULAR,
    WORK,
    ModelView,
    break_due_strings,
    guard,
    observe,
    project,
    rates,
    rates_of_state,
    sample_law,
)
from tensegrity_mj.engines.reference.floor import contact_report, contact_warnings
from tensegrity_mj.engines.reference.located import Room, located_step, rk4_stages
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import DivergenceError, InfeasibleError, OptionError, TensegrityError
from tensegrity_mj.runs.energy import blame_divergence, check_energy
from tensegrity_mj.runs.trajectory import Status, Trajectory


@dataclass(frozen=True)
class Equations:
    """A model's compiled functions, and what goes with them.

    Attributes:
        place, accelerate: where a state has the nodes, and its accelerations for the forces on them.
        project: puts a state where constraints hold.
        guard: says whether the coordinates can hold a state.
        extra: numbers that `accelerate` leaves behind λ: gaps of closed loops, and then forces of constraints.
        lanes: whether several runs go side by side through these functions (`in_lanes`).
        explain_singular: says why the state that `guard` or `place` refused last cannot be held, and what to do.
    """

    place: CFunction
    accelerate: CFunction
    project: CFunction | None = None
    guard: CFunction | None = None
    extra: int = 0
    lanes: bool = False
    explain_singular: Callable[[float], str] = str


class IntegratedRun:
    """One run of a model: the plant, its table, the state y, and what is made of the recorded rows.

    Attributes:
        options: the engine's.
        records: of the structure: `nq` coordinates, and q and q̇ of nodes by `state`.
        equations: of the model.
        name: of the engine.
        y: the state: at first the start's, and later that which the fixed-step method has reached.
        multipliers: (R + extra,) λ of the state that was looked at last, and what is behind it.
    """

    def __init__(self, options: Any, request: Request, plant: Plant, records: Any, equations: Equations) -> None:
        self.options, self.request, self.plant, self.records = options, request, plant, records
        self.name, self.table, self.equations = options.descriptor.title, plant.address, equations
        scene, nq = request.scene, records.nq
        y = np.zeros(2 * nq + (1 if scene.motions else 0) + WORK)
        y[:nq], y[nq : 2 * nq] = records.state(scene.nodes0, scene.velocities0)
        if scene.motions:
            y[2 * nq] = request.begin
        self.multipliers = np.zeros(len(scene.structure.rods) + equations.extra)
        functions = {name: getattr(equations, name) for name in ("place", "accelerate", "project", "guard")}
        functions["rates"] = rates_of_state
        plant.set(**{f"{name}_function": one.address if one else 0 for name, one in functions.items()})
        self.y = np.concatenate([y, plant.elements.states[0]])
        plant.set(coordinates=nq, state_size=len(y), gravity=np.array(scene.gravity), multipliers=self.multipliers)
        self.width = plant["row_width"] + len(self.multipliers)
        if request.start is not None:
            request.start.put_back(plant, y=self.y)

    def rates_at(self, time: float, y: Array, rest_lengths: Array | None) -> Array:
        """dy/dt at one state, without a step; rest lengths (M,) [m] instead of the structure's where no law sets them.

        Raises:
            OptionError: where the model's coordinates cannot hold the state.
            InfeasibleError, ControllerError: what the law says there.
        """
        if rest_lengths is not None:
            self.plant["held"][:] = rest_lengths
        out = np.empty(len(y))
        if self.request.scene.motions:
            y[2 * self.records.nq] = time
        break_due_strings(time, y, self.table)
        if SINGULAR in (guard(y, self.table), status := rates(time, y, out, self.table)):
            raise OptionError(self.equations.explain_singular(time))
        self.plant.raise_if_failed(max(status, self.plant["status"]), time)
        if status == NO_SOLUTION:
            raise InfeasibleError(self.plant.infeasible_message(time))
        return out

    def finish(
        self, time: Array, rows: Array, status: Status, message: str, cost: dict[str, float], **reports: Any
    ) -> Trajectory:
        """The trajectory of the rows recorded so far."""
        width = self.plant["row_width"]
        end = width + len(self.request.scene.structure.rods)  # behind λ: gaps of closed loops, where there are any
        if self.request.scene.contact is not None:
            reports["contact"] = contact_report(self.request.scene, rows, end)
        elif end < self.width:
            reports |= {
                "closure_drift": float(rows[:, end].max(initial=0.0)),  # [m]
                "closure_rate_drift": float(rows[:, end + 1].max(initial=0.0)),  # [m/s]
            }
        constraint_forces = rows[:, rows.shape[1] - len(self.request.scene.structure.constraints) :].copy()
        options = {name: getattr(value, "value", value) for name, value in vars(self.options).items()}
        found = make_trajectory(
            self.request,
            self.options,
            self.plant,
            time,
            rows[:, :width],
            rows[:, width:end].copy(),
            Account(status, message, cost, {"name": self.name, **options}, reports, constraint_forces),
        )
        if self.request.scene.contact is not None:
            looked = int(cost["evaluations"]) + len(time)
            found.reports["warnings"] += contact_warnings(self.plant.arrays["floor"], looked)
        return found


STEPPER = fields_of(  # a run in fixed steps
    table="table",  # its plant's
    steps="state",  # number of the step that is reached
    evaluations="state",
    known="state",  # whether the last of its room is dy/dt at y, and what was answered there: from piece to piece
    answer="state",
    y=("f8", "size"),  # the state: always one that the model can hold, that of the step reached
    room=("f8", len(Room._fields), "size"),
)
Stepper = changing_view("Stepper", STEPPER)


class FixedSteps:
    """One run with classical Runge-Kutta.

    Attributes:
        times: (T,) [s] of the rows.
        rows: recorded so far.
        status: answer of law and model where it is.
        lost: whether its state is no longer finite.
    """

    def __init__(self, run: IntegratedRun) -> None:
        self.run, self.request, self.plant, self.step = run, run.request, run.plant, run.options.timestep
        self.grid = grid = Grid.of(run.request, self.step)
        self.times, self.rows = grid.times, allocate_rows(len(grid.times), run.width)
        plant = self.plant
        grid.describe(plant, self.rows)
        plant["total"] += 1  # the state is kept before the last row is seen to
        search = slack.search_of(plant["string_count"], plant["curved"])
        plant["search"] = search if run.options.locate_slack else 0
        plant["resolution_kind"] = resolution.STAGES
        self.own = Table("stepper", STEPPER)
        self.own.set(table=run.table, y=run.y, room=np.empty((len(Room._fields), len(run.y))))
        self.own["steps"] = grid.first
        self.end: dict[str, Any] = {}
        self.status, self.lost = SOLVED, False
        softer = self.request.softer
        self._remedy = (
            f"reduce the time step (h = {self.step:g} s), {softer}or use Method.RADAU where strings are stiff"
        )
        _ = rk4_steps.address  # compiles

    def go(self) -> None:
        """Take the steps, up to where the run ends; see `conclude` for what becomes of it."""
        run, own, grid = self.run, self.own, self.grid

        def advance(first: int, count: int) -> int:
            self.status = rk4_steps(own.address, grid.first + first, count)
            self.lost = self.status == SOLVED and not np.isfinite(run.y).all()
            return first if self.lost else own["steps"] - grid.first

        if drive(grid, self.request, f"{run.name} RK4", advance):
            self.arrive()

    def arrive(self) -> None:
        """Keep the state after all steps, and record the last row."""
        run, own = self.run, self.own
        if not run.options.locate_slack:
            self.end = {"end": saved_state(run.options, self.plant, y=run.y)}
        self.plant["total"] -= 1
        self.status = rk4_steps(own.address, own["steps"], 0)

    @property
    def cost(self) -> dict[str, int]:
        """Steps and evaluations so far."""
        return {"steps": self.own["steps"] - self.grid.first, "evaluations": self.own["evaluations"]}

    @property
    def ended_early(self) -> float | None:
        """The time [s] at which it ended before its time, or None."""
        return float(self.own["steps"] * self.step) if self.lost or self.status != SOLVED else None

    def conclude(self, seconds: float) -> Trajectory:
        """Return the run's trajectory, or raise the error that it ended with."""
        run, plant, times, rows, remedy = self.run, self.plant, self.times, self.rows, self._remedy
        time, cost = self.own["steps"] * self.step, {"wall_time": seconds, **self.cost}

        def recorded(time: Array, how: Status, message: str) -> Trajectory:
            return run.finish(time, rows[: len(time)], how, message, cost)

        if self.status == SOLVED and not self.lost:
            plant.raise_if_failed(SOLVED, times[-1])  # a load, at the very end
            found = recorded(times, Status.COMPLETED, "")
            check_energy(found, remedy)
            found.provenance.update(self.end)
            return found
        recorded_times = np.concatenate([times[times < time - 0.5 * self.step], [time]])
        if self.status == SINGULAR:
            message = run.equations.explain_singular(time)
            rates(time, run.y, np.empty(len(run.y)), run.table)
            observe(run.y, run.table, rows[len(recorded_times) - 1])
            found = recorded(recorded_times, Status.SINGULAR, message)
            check_energy(found, remedy)
            return found
        before = times[: max(1, int(np.searchsorted(times, time - 0.5 * self.step)))]
        partial = recorded(before, Status.DIVERGED, "" if self.lost else "diverged")
        if self.lost:
            check_energy(partial, remedy)
            text = f"diverged by t = {time:.6g} s: the state is no longer finite; {remedy}"
            raise DivergenceError(text, time, partial)
        try:
            plant.raise_if_failed(self.status, time)
        except TensegrityError:
            blame_divergence(partial, plant, time, remedy)
            raise
        blame_divergence(partial, plant, time, remedy)
        return recorded(recorded_times, Status.INFEASIBLE, plant.infeasible_message(time))


@c_function("int64(int64, int64, int64)", "runs in fixed steps")
def rk4_steps(own_at, first, count):  # type: ignore[no-untyped-def]
    """`count` classical Runge-Kutta steps from number `first` of the run whose table is at an address; its status."""
    return _steps(Stepper(own_at), first, count)


@borrowing
def _steps(own: Any, first: int, count: int) -> int:
    table, y, k = own.table, own.y, own.room
    model = ModelView(table)
    h, total, stride, ratio, rows = model.step, model.total, model.stride, model.ratio, model.rows
    room = Room(k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7])
    known, answer = own.known != 0, own.answer
    begin = model.first_step
    row = (first - begin + stride - 1) // stride
    stop = first + count
    for n in range(first, stop + 1 if stop == total else stop):
        own.steps = n
        t, last = n * h, n == total
        status = SOLVED
        broke = break_due_strings(t, y, table)
        if ratio > 0 and n % ratio == 0:
            status = sample_law(t, y, table)
            if n == 0:
                start_ledger(table)
        model.arrived = model.yielding
        if known and not broke and not last and not model.yielding:
            copy(room.k_end, room.k1)
        else:
            answer = rates(t, y, room.k1, table)
            own.evaluations += not last
        if answer > NO_SOLUTION:
            status = answer
        watch_strings(table, t, n % ratio == 0 and status == SOLVED if ratio else answer == SOLVED)
        resolve_start(table, h)
        if n == 0 and ratio == 0:
            start_ledger(table)
        if ratio == 0:
            status = answer
            if status == SOLVED and model.mode == CONTINUOUS:
                remember(table)
        if status > NO_SOLUTION or (status == NO_SOLUTION and not model.passive) or (model.status != 0 and not last):
            observe(y, table, rows[row])
            return max(status, model.status)
        if (n - begin) % stride == 0 or last:
            observe(y, table, rows[row])
            row += 1
        if last:
            return SOLVED
        if model.search:
            worst, took, known, answer = located_step(table, n, h, y, room)
            own.evaluations += took
        else:
            worst = rk4_stages(table, t, h, y, room, room.x)
            own.evaluations += 3
            if worst <= NO_SOLUTION:
                project(room.x, table)
        if worst <= NO_SOLUTION:
            worst = guard(room.x, table)
        if worst > NO_SOLUTION:
            return worst
        copy(room.x, y)
        own.steps = n + 1
    own.known, own.answer = known, answer
    return SOLVED
