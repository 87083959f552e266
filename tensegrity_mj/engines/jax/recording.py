"""The trajectory of what was observed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import diffrax
import jax
import numpy as np

from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.engines.jax.integrate import TO_THE_END, UNDEFINED
from tensegrity_mj.engines.jax.model import EXTERNAL, LOST, STORED, VOID, WINCH, Observed
from tensegrity_mj.engines.recording import Account, make_trajectory
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import ControllerError, DivergenceError
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.model.rods import inertia_of_rods
from tensegrity_mj.runs.energy import check_energy
from tensegrity_mj.runs.trajectory import Status, Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.engines.jax.engine import JAX

VERSIONS = {one.__name__: one.__version__ for one in (jax, diffrax)}  # which decide the numbers


def trajectory_of(
    engine: JAX, request: Request, rows: Observed, cost: dict[str, float], ended: int = TO_THE_END
) -> Trajectory:
    """The trajectory of a run's rows, (T, ...) each, with what it cost, and how it `ended`.

    Raises:
        ControllerError: where the law returned something that is not finite.
        DivergenceError: with what was recorded before, where the run did not come to its end.
    """
    structure = request.scene.structure
    good = np.all(np.isfinite(rows.nodes), axis=(1, 2)) & np.all(np.isfinite(rows.velocities), axis=(1, 2))
    count = len(good) if good.all() else int(np.argmin(good))
    void = np.flatnonzero((rows.works[:, VOID] > 0) & np.isfinite(rows.works[:, VOID]))
    first_void = int(void[0]) if len(void) else count
    status, message = Status.COMPLETED, ""
    if request.law.own is not None and (len(void) > 0 or ended == UNDEFINED) and first_void <= count:
        count = max(1, first_void)
        after = f"after t = {rows.time[count - 1]:.6g} s (known at recorded times)"
        if np.all(np.isnan(rows.report[: count + 1, Report.FEASIBILITY_MARGIN])):
            raise ControllerError(f"the law returned a value that is not finite {after}; it must be for every string")
        status = Status.INFEASIBLE
        message = (
            f"the law has no admissible solution {after}; "
            "change the target or the options of the law, or take another engine with OnInfeasible.PASSIVE"
        )
    rows = Observed(*(np.asarray(one)[:count] for one in rows))
    T, elastic = len(rows.time), rows.elastic_tensions
    energy = np.sum(structure.curves.stored(rows.lengths - rows.rest_lengths, elastic), axis=1)
    winch = np.zeros(T)
    if request.actuation.mode is Mode.HOLD_REST_LENGTH:
        winch = rows.works[:, WINCH]
    elif request.law.own is not None:  # by parts, -∫ T dL0 = Δ(energy) - ∫ T dL
        winch = energy - energy[:1] - rows.works[:, STORED]
    columns = [
        rows.nodes.reshape(T, -1),
        rows.velocities.reshape(T, -1),
        rows.rest_lengths,
        elastic,
        rows.tensions,
        winch[:, None],
        rows.works[:, [LOST, EXTERNAL]],
        rows.report,
    ]
    multipliers = rows.rod_force_densities * structure.rod_lengths**2 / inertia_of_rods(structure)[1]
    options = {name: getattr(one, "value", one) for name, one in vars(engine).items()}

    def made(how: Status, text: str) -> Trajectory:
        account = Account(how, text, cost, {"name": "JAX", "versions": VERSIONS, **options}, {}, rows.constraint_forces)
        return make_trajectory(request, engine, None, rows.time, np.concatenate(columns, axis=1), multipliers, account)

    remedy = (
        f"reduce the time step (h = {engine.timestep:g} s)"
        if engine.timestep is not None
        else "loosen the tolerances, raise max_steps, or choose Method.RK4"
    )
    if status is Status.COMPLETED and (ended != TO_THE_END or count < len(good)):
        partial = made(Status.DIVERGED, "diverged")
        check_energy(partial, remedy)
        time = float(rows.time[-1]) if T else 0.0
        raise DivergenceError(f"diverged after t = {time:.6g} s; {remedy}", time, partial)
    run = made(status, message)
    check_energy(run, remedy)
    return run
