"""What every engine is given and what it gives back: a request, recorded rows, and the trajectory made of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj import interrupts, rods
from tensegrity_mj.actuation import Actuation, Mode, OnInfeasible, whole_ratio
from tensegrity_mj.engines.reports import reports_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.law import NativeLaw, Report
from tensegrity_mj.native.plant import Plant
from tensegrity_mj.resistance import resisting_forces
from tensegrity_mj.scene import Scene
from tensegrity_mj.trajectory import Status, Trajectory
from tensegrity_mj.water import water_forces

Array = NDArray[np.float64]

DEFAULT_INTERVAL = 0.01  # s: a hundred samples a second
MEMORY_LIMIT = 4 * 2**30  # bytes of recorded rows


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


class Accelerations(Protocol):
    """Accelerations of the nodes from an engine's own equations, at one state and without a step.

    Called with time [s], node positions and velocities (N, 3), and rest lengths (M,) [m] (None: the structure's, or
    what the law sets). Returns the positions (N, 3) [m] where the engine places the nodes, and their accelerations
    (N, 3) [m/s²].
    """

    def __call__(
        self, time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None
    ) -> tuple[Array, Array]: ...


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
        check_rows(count / stride)
        ratio = 0
        if request.sampled:
            assert request.actuation.period is not None
            ratio = whole_ratio(request.actuation.period, step, "control period over the time step")
        for event in request.scene.breaks:
            if 0 < event.time < request.duration:
                whole_ratio(event.time, step, f"break of string '{event.string}' over the time step")
        return cls(step, count, min(stride, count), ratio)

    @property
    def times(self) -> Array:
        """Output times [s]: every stride, and the end."""
        steps = np.arange(0, self.count + 1, self.stride)
        if steps[-1] != self.count:
            steps = np.append(steps, self.count)
        return np.asarray(steps * self.step, float)


def allocate_rows(count: int, width: int) -> Array:
    """Room for `count` recorded rows."""
    check_rows(count, width)
    return np.full((count, width), np.nan)


def check_rows(count: float, width: int = 1) -> None:
    """Raise OptionError where `count` rows are more than a machine should be asked for."""
    size = 8.0 * count * width
    if size > MEMORY_LIMIT:
        raise OptionError(
            f"the run would record {count:.3g} samples, {size / 2**30:.3g} GiB; at most {MEMORY_LIMIT / 2**30:g} GiB "
            "are recorded: shorten the duration or enlarge output_interval"
        )


class Stopwatch:
    """Wall time of the integration alone, not of compiling, loading or drawing; that of laws in Python likewise."""

    def __init__(self, *requests: Request) -> None:
        for request in requests:
            if request.law.spent is not None:
                request.law.spent[:] = [0.0, 0.0]  # they were called to compile, and by earlier runs
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
            self._bar = tqdm(total=request.duration, desc=label, bar_format=form, file=sys.stderr, disable=None)

    def reached(self, time: float) -> None:
        """Simulated time that the run has come to [s]."""
        if self._bar is not None:
            self._bar.update(time - self._bar.n)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


def chunks(count: int) -> Iterator[tuple[int, int]]:
    """(first, how many) of pieces out of `count` steps, of a fraction of a second each, with Ctrl-C heard between."""
    size, first = 64, 0
    while first < count:
        piece = min(size, count - first)
        start = time.perf_counter()
        yield first, piece
        interrupts.raise_if_requested()
        first += piece
        seconds = time.perf_counter() - start
        if seconds < 0.1:
            size *= 8 if seconds < 0.01 else 2
        elif seconds > 0.4:
            size = max(1, size // 2)


# Of a run that diverged too, where numbers overflow: what they mean is for `check_energy` to say.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def make_trajectory(
    request: Request,
    time: Array,
    rows: Array,
    *,
    engine: str,
    status: Status,
    message: str,
    cost: dict[str, float],
    provenance: dict[str, Any],
    plant: Plant,
    step: float | None,
    multipliers: Array | None = None,
    r_accelerations: Array | None = None,
    contact_forces: Array | None = None,
    reports: dict[str, Any] | None = None,
) -> Trajectory:
    """The trajectory of recorded rows (T, row_width); λ is given, or follows from the accelerations r̈ (T, R, 3).

    `plant` is what the run was made with, `step` [s] that of fixed steps. Contact forces (T, N, 3) [N] are those on the
    nodes that contacts come to, where λ is to follow from all forces.
    """
    scene, structure = request.scene, request.scene.structure
    T, N, M = len(time), len(structure.nodes), len(structure.strings)
    nodes = rows[:, : 3 * N].reshape(T, N, 3).copy()
    velocities = rows[:, 3 * N : 6 * N].reshape(T, N, 3).copy()
    at = 6 * N
    rest, elastic, tensions = (rows[:, at + part * M : at + (part + 1) * M].copy() for part in range(3))
    at += 3 * M
    winch, lost, external = (rows[:, at + column].copy() for column in range(3))
    told: dict[str, Any] = {report.name.lower(): rows[:, at + 3 + report].copy() for report in Report}
    lengths = structure.string_lengths(nodes)
    if multipliers is None:
        assert r_accelerations is not None
        forces = rods.string_forces(structure, nodes, tensions)
        forces = forces + np.array([scene.nodal_forces(t) for t in time]).reshape(T, N, 3)
        forces = forces + resisting_forces(scene, nodes, velocities)
        if scene.water is not None:
            forces = forces + water_forces(scene, time, nodes, velocities)[0]  # added mass acts across rods alone
        if contact_forces is not None:
            forces = forces + contact_forces
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
        string_energy=np.sum(elastic**2 / (2 * structure.stiffness), axis=1),  # none in slack and broken strings
        winch_work=winch,
        external_work=external,
        dissipation=lost,
        **told,
        status=status,
        message=message,
        engine=engine,
        cost=cost | cost_of_law(request),
        provenance=provenance
        | {"actuation": {"mode": request.actuation.mode.value, "period": request.actuation.period}},
    )
    trajectory.reports.update(reports_of(request, trajectory, plant, step), **(reports or {}))
    return trajectory


def cost_of_law(request: Request) -> dict[str, float]:
    """How often a law in Python was called, and its part of the wall time [s]; nothing for a compiled one."""
    if request.law.spent is None:
        return {}
    calls, seconds = request.law.spent
    return {"law_calls": calls, "law_time": seconds}
