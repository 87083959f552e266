"""What every engine is given and what it gives back: a request, recorded rows, and the trajectory made of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj import rods, strings
from tensegrity_mj.actuation import Actuation, Mode, OnInfeasible, whole_ratio
from tensegrity_mj.errors import DivergenceError
from tensegrity_mj.law import NativeLaw
from tensegrity_mj.native.plant import NODES, VELOCITIES, Plant
from tensegrity_mj.scene import Scene
from tensegrity_mj.trajectory import VARIABLES, Status, Trajectory

Array = NDArray[np.float64]

DEFAULT_INTERVAL = 0.01  # s: a hundred samples a second

# A run has diverged when it has gained this many times the energy that it was ever given, or when a rod's length is off
# by this part. The errors of a step that is merely coarse stay below; an unstable one passes any bound soon.
ENERGY_BOUND = 2.0
WINCH_BOUND = 10.0  # where winches work
STRAIN_BOUND = 0.5
LOST = 1e10  # m, m/s: what MuJoCo takes for a divergence too


@dataclass(frozen=True)
class Request:
    """One run to be made: the same for every engine."""

    scene: Scene
    law: NativeLaw
    actuation: Actuation
    on_infeasible: OnInfeasible
    duration: float
    output_interval: float | None
    progress: bool

    @property
    def sampled(self) -> bool:
        """Whether the law is sampled."""
        return bool(self.law.address) and self.actuation.mode is not Mode.CONTINUOUS


@dataclass(frozen=True)
class Grid:
    """Fixed steps: how many, how many a row, how many a control period (0: the law is not sampled)."""

    step: float
    count: int
    stride: int
    ratio: int

    @classmethod
    def of(cls, request: Request, step: float) -> Grid:
        """The grid of a request.

        Raises:
            OptionError: where duration, output interval or control period is no multiple of the step.
        """
        count = whole_ratio(request.duration, step, "duration over the time step")
        if request.output_interval is None:
            stride = max(1, int(np.floor(DEFAULT_INTERVAL / step * (1 + 1e-12))))
        else:
            stride = whole_ratio(request.output_interval, step, "output interval over the time step")
        ratio = 0
        if request.sampled:
            assert request.actuation.period is not None
            ratio = whole_ratio(request.actuation.period, step, "control period over the time step")
        return cls(step, count, min(stride, count), ratio)

    @property
    def times(self) -> Array:
        """Output times [s]: every stride, and the end."""
        steps = list(range(0, self.count + 1, self.stride))
        if steps[-1] != self.count:
            steps.append(self.count)
        return np.array(steps) * self.step


class Stopwatch:
    """Wall time of the integration alone: not of compiling, loading or drawing."""

    def __init__(self) -> None:
        self.start = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Since the start."""
        return time.perf_counter() - self.start


class Progress:
    """A progress bar over simulated time on stderr; silent unless asked for."""

    def __init__(self, request: Request, label: str) -> None:
        self._bar: Any = None
        if request.progress:
            from tqdm import tqdm

            form = "{desc} {percentage:3.0f}% |{bar}| {n:.2f}/{total:.2f} s [{elapsed} < {remaining}]"
            self._bar = tqdm(total=request.duration, desc=label, bar_format=form, file=sys.stderr, leave=True)

    def reached(self, time: float) -> None:
        """Simulated time that the run has come to [s]."""
        if self._bar is not None:
            self._bar.update(time - self._bar.n)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


def chunks(count: int, size: int) -> Iterator[tuple[int, int]]:
    """(first, how many) of pieces of at most `size` out of `count`."""
    for first in range(0, count, size):
        yield first, min(size, count - first)


# Of a run that diverged too, where numbers overflow: what they mean is for `check_energy` to say.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def make_trajectory(
    request: Request,
    plant: Plant,
    time: Array,
    rows: Array,
    *,
    engine: str,
    status: Status,
    message: str,
    cost: dict[str, float],
    provenance: dict[str, Any],
    multipliers: Array | None = None,
    r_accelerations: Array | None = None,
    reports: dict[str, Any] | None = None,
) -> Trajectory:
    """The trajectory of recorded rows (T, row_width); λ is given, or follows from the accelerations r̈ (T, R, 3)."""
    scene, structure = request.scene, request.scene.structure
    T, N, M = len(time), len(structure.nodes), len(structure.strings)
    nodes = rows[:, : 3 * N].reshape(T, N, 3).copy()
    velocities = rows[:, 3 * N : 6 * N].reshape(T, N, 3).copy()
    at = 6 * N
    rest, elastic, tensions = (rows[:, at + part * M : at + (part + 1) * M].copy() for part in range(3))
    at += 3 * M
    margin, lyapunov, winch, lost, external = (rows[:, at + column].copy() for column in range(5))
    lengths = structure.string_lengths(nodes)
    if multipliers is None:
        assert r_accelerations is not None
        forces = rods.string_forces(structure, nodes, tensions)
        forces = forces + np.array([scene.nodal_forces(t) for t in time]).reshape(T, N, 3)
        multipliers = rods.multipliers(structure, nodes, velocities, forces, np.array(scene.gravity), r_accelerations)
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
        string_energy=np.sum(strings.energy(structure.stiffness, lengths, rest), axis=1),
        winch_work=winch,
        external_work=external,
        dissipation=lost,
        feasibility_margin=margin,
        lyapunov=lyapunov,
        status=status,
        message=message,
        engine=engine,
        cost=cost,
        provenance=provenance,
    )
    trajectory.reports.update(_reports(request, plant, trajectory), **(reports or {}))
    return trajectory


def _reports(request: Request, plant: Plant, run: Trajectory) -> dict[str, Any]:
    structure = run.scene.structure
    first, second = rods.ends(structure, run.nodes)
    b = (second - first) / structure.rod_lengths[:, None]
    first, second = rods.ends(structure, run.velocities)
    b_rate = (second - first) / structure.rod_lengths[:, None]
    drift = np.abs(np.sum(b * b, axis=-1) - 1)
    rate_drift = np.abs(np.sum(b * b_rate, axis=-1))
    below = np.argwhere(run.rest_lengths <= 0)
    reports: dict[str, Any] = {
        "drift": float(drift.max(initial=0.0)),  # of bᵀb - 1
        "rate_drift": float(rate_drift.max(initial=0.0)),  # of bᵀḃ [1/s]
        "energy_residual": run.energy_residual,
        "nonpositive_rest_lengths": {
            "samples": len({int(t) for t, _ in below}),
            "first_time": float(run.time[below[0][0]]) if len(below) else None,
            "strings": sorted({structure.strings[int(m)].name for _, m in below}),
        },
    }
    if request.sampled:
        # A held rest length adds a viscosity of about k H: right only where this ratio is small.
        period = request.actuation.period or 0.0
        lengths = structure.string_lengths(run.nodes)
        rates = np.abs(structure.string_rates(run.nodes, run.velocities))
        loaded = run.force_densities > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(loaded, structure.stiffness * period * rates / (run.force_densities * lengths), 0.0)
        reports["largest_holding_ratio"] = float(ratio.max(initial=0.0))
    return reports


@np.errstate(over="ignore", invalid="ignore")
def check_energy(run: Trajectory, remedy: str, dampers_as_recorded: bool = True) -> None:
    """Raise DivergenceError, with what came before, if a run is not finite, tore its rods, or made energy from nothing.

    Args:
        run: all of it, or what there was when it ended.
        remedy: what the message advises.
        dampers_as_recorded: whether the dampers' forces that were recorded are those that acted. An integrator that is
            implicit in them applies others, so that the recorded dissipation may exceed what there was to dissipate.
    """
    finite = np.ones(len(run.time), bool)
    for name in VARIABLES:
        if name not in ("feasibility_margin", "lyapunov"):  # NaN where the law has none
            values = np.isfinite(getattr(run, name))
            finite &= values.all(axis=tuple(range(1, values.ndim)))
    good = len(finite) if finite.all() else int(np.argmin(finite))
    cause = "positions, velocities or forces are no longer finite"
    for bad, reason in (_torn_rods(run.until(good)), _energy_from_nowhere(run.until(good), dampers_as_recorded)):
        if bad < good:
            good, cause = bad, reason
    if good == len(run.time):
        return
    at = float(run.time[good])
    raise DivergenceError(f"diverged by t = {at:.6g} s: {cause}; {remedy}", at, run.until(good))


def blame_divergence(
    partial: Trajectory, plant: Plant, time: float, remedy: str, dampers_as_recorded: bool = True
) -> None:
    """Raise DivergenceError if a law or a load stopped a run because its state was none of a structure any more.

    Args:
        partial: what was recorded before.
        plant: with the nodes that the law was given last.
        time: when it stopped the run [s].
        remedy, dampers_as_recorded: as for `check_energy`.
    """
    check_energy(partial, remedy, dampers_as_recorded)
    if not all(np.all(np.abs(plant[slot]) < LOST) for slot in (NODES, VELOCITIES)):
        raise DivergenceError(
            f"diverged by t = {time:.6g} s: positions or velocities are beyond {LOST:g} m or m/s; {remedy}",
            time,
            partial,
        )


def _torn_rods(run: Trajectory) -> tuple[int, str]:
    """The first sample at which a rod is not nearly as long as it should be (none: their number), and what to say."""
    structure = run.scene.structure
    first, second = rods.ends(structure, run.nodes)
    strain = np.linalg.norm(second - first, axis=-1) / structure.rod_lengths - 1
    bad = np.any(np.abs(strain) > STRAIN_BOUND, axis=1)
    if not bad.any():
        return len(bad), ""
    at = int(np.argmax(bad))
    worst = int(np.argmax(np.abs(strain[at])))
    return at, f"rod '{structure.rods[worst].name}' has {strain[at, worst] + 1:.3g} times its length"


def _energy_from_nowhere(run: Trajectory, dampers_as_recorded: bool) -> tuple[int, str]:
    """The first sample with more energy than there can be (none: their number), and what to say."""
    if len(run.time) == 0:
        return 0, ""
    given = np.full(len(run.time), run.kinetic_energy[0] + run.string_energy[0])
    for term in (run.winch_work, run.external_work, run.gravity_energy - run.gravity_energy[0]):
        given += np.maximum.accumulate(np.abs(term))
    gained = run.energy_balance - (0.0 if dampers_as_recorded else run.dissipation)
    # Round-off of the positions alone, in the stiffest string.
    floor = 1e-12 * (1.0 + float(np.max(run.scene.structure.stiffness, initial=0.0)))
    # Winch work that is integrated at the first order may be off by what it is itself.
    bound = WINCH_BOUND if np.any(run.winch_work) else ENERGY_BOUND
    # In the first steps from rest next to nothing has been given yet, and its relative error is large: the verdict is
    # by the largest of the whole run, its time by the first.
    if not gained.max() > bound * given[-1] + floor:
        return len(run.time), ""
    at = int(np.argmax(gained > bound * given + floor))
    return at, f"energy came from nowhere: {gained[at]:.3g} J gained, {given[at]:.3g} J given"
