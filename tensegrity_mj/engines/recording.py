"""Recorded rows, and the trajectory made of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.reports import reports_of
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model import rods
from tensegrity_mj.model.elements.element import forces_of
from tensegrity_mj.runs.trajectory import Status, Trajectory

MEMORY_LIMIT = 4 * 2**30  # bytes of recorded rows


def allocate_rows(count: int, width: int) -> Array:
    """Room for `count` recorded rows."""
    check_rows(count, width)
    return np.full((count, width), np.nan)


def check_rows(count: float, width: int) -> None:
    """Raise OptionError where `count` rows are more than a machine should hold."""
    size = 8.0 * count * width
    if size > MEMORY_LIMIT:
        raise OptionError(
            f"the run would record {count:.3g} samples, {size / 2**30:.3g} GiB; at most {MEMORY_LIMIT / 2**30:g} GiB "
            "are recorded: shorten the duration or enlarge output_interval"
        )


@dataclass(frozen=True)
class RodMotion:
    """Data that λ follows from: r̈ (T, R, 3) [m/s²], and forces (T, N, 3) [N] of contacts or constraints on nodes."""

    r_accelerations: Array
    more_forces: Array | None = None


@dataclass(frozen=True)
class Account:
    """Outcome of a run: how it ended, what it cost, its engine's options and its reports."""

    status: Status
    message: str
    cost: dict[str, float]
    engine: dict[str, Any]
    reports: dict[str, Any] = field(default_factory=dict)
    constraint_forces: Array | None = None  # (T, C) [N]


# Of a run that diverged too, where numbers overflow: what they mean is for `check_energy` to say.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def make_trajectory(
    request: Request,
    options: Any,
    plant: Plant | None,
    time: Array,
    rows: Array,
    rod: Array | RodMotion,
    account: Account,
) -> Trajectory:
    """The trajectory of recorded rows.

    Args:
        request: of the run.
        options: the engine's; `timestep` is that of fixed steps, or None.
        plant: what the run was made with; None of an engine without one, whose rows have no states of elements.
        time, rows: (T,) [s] and (T, row_width).
        rod: λ (T, R) [1/s²], or what it follows from.
        account: what the run says of itself.
    """
    scene, structure = request.scene, request.scene.structure
    T, N, M = len(time), len(structure.nodes), len(structure.strings)
    nodes = rows[:, : 3 * N].copy().reshape(T, N, 3)
    velocities = rows[:, 3 * N : 6 * N].copy().reshape(T, N, 3)
    at = 6 * N
    rest, elastic, tensions = (rows[:, at + part * M : at + (part + 1) * M].copy() for part in range(3))
    at += 3 * M
    winch, lost, external = (rows[:, at + column].copy() for column in range(3))
    at += 3
    if request.begin > 0:  # the ledger may have all that was before
        winch, lost, external = (column - column[:1] for column in (winch, lost, external))
    states = rows[:, at : at + (0 if plant is None else plant.elements.states.shape[1])].copy()
    at += states.shape[1]
    reported: dict[str, Any] = {name.lower(): rows[:, at + n].copy() for n, name in enumerate(Report.__members__)}
    lengths = structure.string_lengths(nodes)
    if isinstance(rod, RodMotion):
        forces = rods.string_forces(structure, nodes, tensions)
        if scene.effects:  # added mass acts across rods alone
            forces = forces + forces_of(scene.effects, scene, time, nodes, velocities, states)
        if rod.more_forces is not None:
            forces = forces + rod.more_forces
        gravity = np.array(scene.gravity)
        multipliers = rods.multipliers(
            structure, nodes, velocities, *rods.ends(structure, forces), gravity, rod.r_accelerations
        )
    else:
        multipliers = rod
    if structure.elastic.any():
        multipliers = rods.with_elastic_multipliers(structure, nodes, velocities, multipliers)
    spent = dict(zip(("law_calls", "law_time"), request.law.spent or (), strict=False))  # of a law in Python
    trajectory = Trajectory(
        scene=scene,
        time=time,
        nodes=nodes,
        velocities=velocities,
        force_densities=elastic / lengths,
        rest_lengths=rest,
        tensions=tensions,
        multipliers=multipliers,
        rod_force_densities=rods.force_densities(structure, multipliers),
        kinetic_energy=rods.kinetic_energy(structure, velocities),
        gravity_energy=rods.gravity_energy(structure, nodes, np.array(scene.gravity)),
        string_energy=np.sum(structure.curves.stored(lengths - rest, elastic), axis=1),  # none in slack and broken ones
        winch_work=winch,
        external_work=external,
        dissipation=lost,
        **reported,
        element_states=states,
        constraint_forces=np.zeros((T, 0)) if account.constraint_forces is None else account.constraint_forces,
        status=account.status,
        message=account.message,
        engine=str(options),
        cost=account.cost | spent,
        provenance={
            "engine": account.engine,
            "actuation": {"mode": request.actuation.mode.value, "period": request.actuation.period},
        },
    )
    trajectory.reports.update(reports_of(request, trajectory, plant, options.timestep), **account.reports)
    return trajectory
