"""The trajectory of what was observed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.engines.jax.model import EXTERNAL, LOST, STORED, WINCH, Observed
from tensegrity_mj.engines.recording import Account, make_trajectory
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import DivergenceError
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.model.rods import inertia_of_rods
from tensegrity_mj.runs.energy import check_energy
from tensegrity_mj.runs.trajectory import Status, Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.engines.jax.engine import JAX


def trajectory_of(
    engine: JAX, request: Request, rows: Observed, cost: dict[str, float], failed: bool = False
) -> Trajectory:
    """The trajectory of a run's rows, (T, ...) each, with what it cost; whether it `failed` before its end.

    Raises:
        DivergenceError: with what was recorded before, where the run did not come to its end.
    """
    structure = request.scene.structure
    good = np.all(np.isfinite(rows.nodes), axis=(1, 2)) & np.all(np.isfinite(rows.velocities), axis=(1, 2))
    count = len(good) if good.all() else int(np.argmin(good))
    margin = rows.report[:, Report.FEASIBILITY_MARGIN]
    void = np.flatnonzero(~np.all(np.isfinite(rows.rest_lengths), axis=1) | (margin <= 0))
    infeasible = request.law.own is not None and len(void) > 0 and void[0] <= count
    status, message = Status.COMPLETED, ""
    if infeasible:
        count = max(1, int(void[0]))
        status = Status.INFEASIBLE
        message = (
            f"the law has no admissible solution after t = {rows.time[count - 1]:.6g} s (known at recorded times); "
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
        account = Account(how, text, cost, {"name": "JAX", **options}, {}, rows.constraint_forces)
        return make_trajectory(request, engine, None, rows.time, np.concatenate(columns, axis=1), multipliers, account)

    remedy = (
        f"reduce the time step (h = {engine.timestep:g} s)"
        if engine.timestep is not None
        else "loosen the tolerances, raise max_steps, or choose Method.RK4"
    )
    if not infeasible and (failed or count < len(good)):
        partial = made(Status.DIVERGED, "diverged")
        check_energy(partial, remedy)
        time = float(rows.time[-1]) if T else 0.0
        raise DivergenceError(f"diverged after t = {time:.6g} s; {remedy}", time, partial)
    run = made(status, message)
    check_energy(run, remedy)
    return run
