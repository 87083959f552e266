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
from tensegrity_mj.errors import DivergenceError, OptionError
from tensegrity_mj.law import NativeLaw, Report
from tensegrity_mj.native.plant import NODES, VELOCITIES, Plant
from tensegrity_mj.resistance import resisting_forces
from tensegrity_mj.scene import Scene
from tensegrity_mj.trajectory import LAW_REPORTS, VARIABLES, Status, Trajectory
from tensegrity_mj.water import water_forces

Array = NDArray[np.float64]

DEFAULT_INTERVAL = 0.01  # s: a hundred samples a second
MEMORY_LIMIT = 4 * 2**30  # bytes of recorded rows

# A run has diverged when it has gained this many times the energy that it was ever given, or when a rod's length is off
# by this part. The errors of a step that is merely coarse stay below; an unstable one passes any bound soon.
ENERGY_BOUND = 2.0
WINCH_BOUND = 10.0  # where winches work
# In the continuous mode: this part of all the energy that was exchanged. Measured on the prism and the pinned rod with
# every integrator: a coarse step gains up to 0.87 of it, past the limit it is 0.95 to 1.5 whatever the garbage's size.
GAIN_BOUND = 0.9
STRAIN_BOUND = 0.5
ENERGY_WARNING = 0.01  # part of the energy exchanged beyond which a run says that its balance is off
# Of bᵀb - 1: rods half as much off their lengths. The energy need not see it, where it is mostly that of prestress.
DRIFT_WARNING = 1e-3
LIMIT_ROUND_OFF = 1e-6  # part of a limit: u = k (1 - L0/L) loses digits where k is much larger than u
DECAY_WARNING = 0.01  # part of V
V_ROUND_OFF = 1e-26  # V of errors of 1e-13 m and rad: one that starts below it starts at the target
V_RESOLVED = 1e-20  # of V(0): below it, errors squared are not far from round-off squared
BEYOND = 1e10  # m, m/s: mjMAXVAL, what MuJoCo takes for a divergence too; it zeroes all controls for one of them


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
    multipliers: Array | None = None,
    r_accelerations: Array | None = None,
    contact_forces: Array | None = None,
    reports: dict[str, Any] | None = None,
) -> Trajectory:
    """The trajectory of recorded rows (T, row_width); λ is given, or follows from the accelerations r̈ (T, R, 3).

    Contact forces (T, N, 3) [N] are those on the nodes that contacts come to, where λ is to follow from all forces.
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
    trajectory.reports.update(_reports(request, trajectory), **(reports or {}))
    return trajectory


def cost_of_law(request: Request) -> dict[str, float]:
    """How often a law in Python was called, and its part of the wall time [s]; nothing for a compiled one."""
    if request.law.spent is None:
        return {}
    calls, seconds = request.law.spent
    return {"law_calls": calls, "law_time": seconds}


def _reports(request: Request, run: Trajectory) -> dict[str, Any]:
    structure = run.scene.structure
    first, second = rods.ends(structure, run.nodes)
    b = (second - first) / structure.rod_lengths[:, None]
    first, second = rods.ends(structure, run.velocities)
    b_rate = (second - first) / structure.rod_lengths[:, None]
    drift = np.abs(np.sum(b * b, axis=-1) - 1)
    rate_drift = np.abs(np.sum(b * b_rate, axis=-1))
    below = np.argwhere(run.rest_lengths <= 0)
    warnings = []
    exchanged = float(energy_exchanged(run)[-1]) if len(run.time) else 0.0
    if run.energy_residual > ENERGY_WARNING * exchanged + _energy_unresolved(run):
        warnings.append(
            f"the energy balance is off by {run.energy_residual:.2g} J of {exchanged:.2g} J exchanged: "
            "reduce the time step or the tolerances before trusting this run"
        )
    if drift.max(initial=0.0) > DRIFT_WARNING:
        row, column = np.unravel_index(np.argmax(drift), drift.shape)
        first_time = float(run.time[np.argmax(np.any(drift > DRIFT_WARNING, axis=1))])
        warnings.append(
            f"rod '{structure.rods[int(column)].name}' drifts off its length by "
            f"{abs(np.linalg.norm(b[row, column]) - 1):.2g} of it (bᵀb by {DRIFT_WARNING:g} first at "
            f"t = {first_time:.6g} s): reduce the time step or the tolerances, or let the DAE keep lengths with "
            "Drift.NORMALIZE, before trusting this run"
        )
    twice = run.scene.redundancy
    if twice.singular:
        warnings.append(twice.warning)
    known = request.law.gravity
    if known is not None and known != run.scene.gravity:
        warnings.append(f"the law reckons with gravity {known}, the scene has {run.scene.gravity} m/s²")
    if known is not None and request.law.water != run.scene.water:
        theirs, ours = request.law.water, run.scene.water
        kind = "with no water" if theirs is None else "with other water than the scene's" if ours else "with water"
        warnings.append(f"the law reckons {kind}" + ("" if ours else ", and the scene has none"))
    if known is not None and run.scene.motions:
        warnings.append(f"the law reckons with supports at rest, and '{run.scene.motions[0].support}' moves")
    decay_error, since = _decay_error(request, run)
    if decay_error is not None and decay_error > DECAY_WARNING and not request.sampled:
        warnings.append(
            f"V leaves the decay that the law promises by {decay_error:.2g} of itself (by {DECAY_WARNING:g} first at "
            f"t = {since:.6g} s): the law is near a singularity there (its margin falls to zero), the step is too "
            "coarse, or forces act that the law does not know"
        )
    if request.law.until is not None and request.law.until < request.duration * (1 - 1e-9):
        warnings.append(
            f"the recording ends at {request.law.until:g} s; until {request.duration:g} s its last values are held"
        )
    limits = _limits(request, run)
    for name, bound in limits.items():
        if bound["exceeded"] is not None:
            warnings.append(
                f"{name} of string '{bound['string']}' is exceeded: {bound['exceeded']:.3g} at t = {bound['time']:.6g} "
                f"s, allowed {bound['limit']:.3g}; docs/laws.md says which actuation keeps which limit"
            )
    reports: dict[str, Any] = {
        "warnings": warnings,
        "limits": limits,
        "decay_error": decay_error,  # of V against V(0) e^(-δt), relative
        "drift": float(drift.max(initial=0.0)),  # of bᵀb - 1
        "rate_drift": float(rate_drift.max(initial=0.0)),  # of bᵀḃ [1/s]
        "energy_residual": run.energy_residual,
        # Rods whose λ and force density are one choice of many; None where too many hang together to tell.
        "undetermined_forces": None if twice.skipped else list(twice.undetermined),
        "singular_start": list(twice.singular),
        "nonpositive_rest_lengths": {  # at recorded times
            "samples": len({int(t) for t, _ in below}),
            "first_time": float(run.time[below[0][0]]) if len(below) else None,
            "intervals": _intervals(run.time, np.any(run.rest_lengths <= 0, axis=1)),
            "strings": sorted({structure.strings[int(m)].name for _, m in below}),
        },
    }
    if run.scene.water is not None and len(run.time):
        from tensegrity_mj.flow_regime import flow_numbers

        reports["water"] = flow_numbers(run).report() | {"segments": run.scene.water_segments.report()}
        warnings.extend(run.scene.water_segments.warnings)
    if request.sampled:
        # A held rest length adds a viscosity of the order of k H (docs/laws.md): right only where this ratio is small.
        period = request.actuation.period or 0.0
        lengths = structure.string_lengths(run.nodes)
        rates = np.abs(structure.string_rates(run.nodes, run.velocities))
        loaded = run.force_densities > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(loaded, structure.stiffness * period * rates / (run.force_densities * lengths), 0.0)
        reports["largest_holding_ratio"] = float(ratio.max(initial=0.0))
    return reports


def _limits(request: Request, run: Trajectory) -> dict[str, Any]:
    """For each limit that some string has: how long any string was at or beyond it, and the worst beyond it."""
    structure = run.scene.structure
    mode, period = request.actuation.mode, request.actuation.period or 0.0
    spacing = np.maximum(np.diff(run.time), period if mode is Mode.HOLD_REST_LENGTH else 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.abs(np.diff(run.rest_lengths, axis=0)) / spacing[:, None]
    values = {
        "max_force_density": (run.force_densities, 1.0),
        "min_rest_length": (run.rest_lengths, -1.0),
        # From sample to sample, so that a winch that may only move at samples is not taken for a fast one.
        "winch_speed": (
            np.concatenate([np.zeros_like(speed[:1]), speed]) if len(run.time) > 1 else 0 * run.tensions,
            1.0,
        ),
    }
    found: dict[str, Any] = {}
    for name, (value, sign) in values.items():
        limit = structure.limits(name)
        if not np.any(np.isfinite(limit)) or not len(run.time):
            continue
        beyond = np.where(np.isfinite(limit), sign * (value - limit) / np.abs(limit), -np.inf)
        row, column = np.unravel_index(np.argmax(beyond), beyond.shape)
        over = beyond[row, column] > LIMIT_ROUND_OFF
        found[name] = {
            "reached": _intervals(run.time, np.any(beyond > -LIMIT_ROUND_OFF, axis=1)),
            "strings": [
                s.name for s, at in zip(structure.strings, beyond.max(axis=0), strict=True) if at > -LIMIT_ROUND_OFF
            ],
            "exceeded": float(value[row, column]) if over else None,
            "string": structure.strings[int(column)].name if over else None,
            "time": float(run.time[row]) if over else None,
            "limit": float(limit[column]) if over else None,
        }
    return found


def _decay_error(request: Request, run: Trajectory) -> tuple[float | None, float]:
    """Largest relative error of V against V(0) e^(-δt), and when it first exceeds what is warned of.

    None where the law promises no decay, or where the run starts at the target, so that V(0) is round-off.
    """
    if request.law.decay_rate is None or len(run.time) == 0 or not run.lyapunov[0] > V_ROUND_OFF:
        return None, 0.0
    promised = run.lyapunov[0] * np.exp(-request.law.decay_rate * run.time)
    resolved = promised > V_RESOLVED * run.lyapunov[0]
    error = np.abs(run.lyapunov[resolved] / promised[resolved] - 1)
    return float(error.max()), float(run.time[resolved][np.argmax(error > DECAY_WARNING)])


def _intervals(time: Array, true: NDArray[np.bool_]) -> list[list[float]]:
    """First and last recorded time of each stretch in which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return [[float(time[a]), float(time[b - 1])] for a, b in edges.reshape(-1, 2)]


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
        if name not in LAW_REPORTS:  # NaN where the law has none
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
    if not all(np.all(np.abs(plant[slot]) < BEYOND) for slot in (NODES, VELOCITIES)):
        raise DivergenceError(
            f"diverged by t = {time:.6g} s: positions or velocities are beyond {BEYOND:g} m or m/s; {remedy}",
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
    # A damper that gives back what it took, as one does beyond the limit of an explicit step, gives from nowhere.
    given_back = np.maximum.accumulate(run.dissipation) - run.dissipation
    gained = run.energy_balance + (given_back if dampers_as_recorded else -run.dissipation)
    if run.provenance["actuation"]["mode"] == Mode.CONTINUOUS.value and np.any(run.winch_work):
        # Winch work by parts contains the strings' work itself, which grows with whatever garbage there is.
        bound, given = GAIN_BOUND, _energy_at_work(run)
    else:
        bound, given = WINCH_BOUND if np.any(run.winch_work) else ENERGY_BOUND, _energy_given(run)
    floor = _energy_round_off(run)
    # In the first steps from rest next to nothing has been given yet, and its relative error is large: the verdict is
    # by the largest of the whole run, its time by the first.
    if not gained.max() > bound * given[-1] + floor:
        return len(run.time), ""
    at = int(np.argmax(gained > bound * given + floor))
    return at, f"energy came from nowhere: {gained[at]:.3g} J gained, {given[at]:.3g} J given"


def _energy_round_off(run: Trajectory) -> float:
    """[J]: what the round-off of positions alone makes of the energy, in the stiffest string and under gravity."""
    return 1e-12 * (1.0 + float(np.max(run.scene.structure.stiffness, initial=0.0)))


def _energy_unresolved(run: Trajectory) -> float:
    """[J]: a residual that says nothing of the motion: round-off of sums of energies, and of places where forces act.

    A place is known to 1e-16 of its coordinates, and the energy to that times the force; steps add up as a random walk.
    Measured on random prestressed structures: up to 1e-16 of forces times coordinates in 1000 steps. To it comes what
    prestressed rods do where their lengths drift, which has a warning of its own: the DAE lets them by its tolerance.
    """
    structure = run.scene.structure
    terms = (
        run.kinetic_energy,
        run.gravity_energy,
        run.string_energy,
        run.bending_energy,
        run.winch_work,
        run.external_work,
        run.dissipation,
    )
    total = sum(float(np.max(np.abs(term), initial=0.0)) for term in terms)
    masses = structure.rod_masses.sum() + sum(point.mass for point in structure.point_masses)
    forces = float(np.max(run.tensions, axis=0, initial=0.0).sum() + masses * np.linalg.norm(run.scene.gravity))
    extent = float(np.max(np.abs(run.nodes), initial=0.0))
    walk = max(1.0, float(np.sqrt(run.cost.get("steps", 0.0))) / 30)
    first, second = rods.ends(structure, run.nodes)
    drift = np.abs(np.sum((second - first) ** 2, axis=-1) - structure.rod_lengths**2)
    drifted = 0.0
    if np.all(drift <= DRIFT_WARNING * structure.rod_lengths**2):  # beyond, nothing is excused
        drifted = float(np.max(np.sum(np.abs(run.rod_force_densities) * drift, axis=1), initial=0.0))
    return 1e-14 * total + 1e-15 * walk * forces * extent + drifted


def _energy_given(run: Trajectory) -> Array:
    """(T,) [J]: the initial energy and the largest works of winches, loads and gravity up to each time."""
    given = np.full(len(run.time), run.kinetic_energy[0] + run.string_energy[0] + run.bending_energy[0])
    for term in (run.winch_work, run.external_work, run.gravity_energy - run.gravity_energy[0]):
        given += np.maximum.accumulate(np.abs(term))
    return given


def _energy_at_work(run: Trajectory) -> Array:
    """(T,) [J]: `energy_exchanged`, or what strings hold at the start or bent joints at any time, if that is more."""
    stored = np.maximum.accumulate(np.maximum(np.abs(run.bending_energy), run.string_energy[0]))
    return np.asarray(np.maximum(energy_exchanged(run), stored))


def energy_exchanged(run: Trajectory) -> Array:
    """(T,) [J]: how much energy was on the move up to each time, which an error of the energy is to be held against.

    The largest of the kinetic energy, of the works of strings, gravity and bent joints since the start, of the work of
    loads, contact and supports, and of what dampers took. Energy that strings only store is none of it: prestress may
    hold a million times what a vibration moves to and fro, and would hide the loss of all of that. The strings' work is
    their energy less the winches' work, which may cancel: where a law sets force densities both grow, the work not.
    """
    terms = (
        run.kinetic_energy,
        run.string_energy - run.string_energy[:1] - run.winch_work,
        run.gravity_energy - run.gravity_energy[:1],
        run.bending_energy - run.bending_energy[:1],
        run.external_work,
        run.dissipation,
    )
    return np.asarray(np.maximum.accumulate(np.max(np.abs(terms), axis=0)))
