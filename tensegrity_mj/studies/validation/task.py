"""Task of the report: one run, a point of plain values in, its measures out. A run that ends early is a result, too.

docs/validate.md explains the measures. They are of the recorded samples: a run is recorded at every control sample
where memory allows it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.controllers import specs
from tensegrity_mj.controllers.degraded import Delayed, Noisy
from tensegrity_mj.controllers.quadratic_terms import Gains
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.errors import DivergenceError, SceneError
from tensegrity_mj.model import rods
from tensegrity_mj.model.actuation import Actuation, Mode
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.energy import winch_increments
from tensegrity_mj.runs.judgement import doubts, growth, rest
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.simulation import simulate
from tensegrity_mj.studies.parameters import Draft, NominalWinches
from tensegrity_mj.studies.sweep import scene_of

ROWS = 64 * 2**20  # bytes of recorded rows at most
TICK = 0.01  # s: what control periods, durations and break times are multiples or parts of
REFUSED = "refused"  # the status of a start that the scene does not admit
KEPT = 100  # times at which nodes are kept for comparison, as well as the start

# Values that a point may hold in addition to its engine; absent means nominal.
DEFAULTS: dict[str, Any] = {
    "engine_options": {},
    "mode": Mode.CONTINUOUS.value,
    "period": None,
    "law": None,  # another law than the one under test
    "gain": None,  # [X, Y, Z or decay_rate, factor]
    "settings": {},  # parameters of `studies.parameters`, of the plant
    "known_gravity": None,  # what the law believes in, where it is not the scene's
    "noise": None,  # [m, m/s, seed]
    "delay": 0,  # samples
    "nodes": None,  # (N, 3): another start
    "keep_nodes": False,
}


def run_point(point: dict[str, Any]) -> dict[str, Any]:
    """The task: simulate one point and measure it.

    Args:
        point: `scene` (TOML), `spec` of the law, `duration` [s], `timestep` [s], `engine`, and any of `DEFAULTS`.
    """
    case = DEFAULTS | point
    nominal = scene_of(case["scene"])
    draft = Draft(nominal, engine=case["engine"], engine_options=dict(case["engine_options"]))
    draft.apply(case["settings"])
    plant = draft.plant or draft.scene
    law = specs.make(case["law"] or case["spec"], nominal)
    if case["gain"] is not None:
        law = with_gain(law, nominal, *case["gain"])
    if case["known_gravity"] is not None:
        law = dataclasses.replace(law, gravity=tuple(case["known_gravity"]))
    if case["nodes"] is not None:
        try:
            plant = plant.with_(initial_nodes=np.array(case["nodes"]), initial_velocities=None)
        except SceneError as error:
            return {"status": REFUSED, "message": str(error), "end_time": 0.0}
    # The law promises nothing for another plant.
    promised = None if case["settings"] else native_law(law, nominal.structure).decay_rate
    floor = getattr(law, "minimum_force_density", 0.0)
    law = NominalWinches.between(law, nominal.structure, plant.structure)
    period = case["period"]
    if case["noise"] is not None:
        position, velocity, seed = case["noise"]
        law = Noisy(law, position, velocity, seed, period)
    if case["delay"]:
        law = Delayed(law, case["delay"], period)
    try:
        run = simulate(
            plant,
            law,
            draft.make_engine(),
            duration=case["duration"],
            actuation=Actuation(Mode(case["mode"]), period),
            output_interval=recording_interval(plant, period or case["timestep"], case["duration"]),
        )
    except DivergenceError as error:
        return {"status": "diverged", "message": str(error), "end_time": error.time}
    values = of_run(run, promised, floor, known_plant=not case["settings"])
    if case["keep_nodes"]:
        values["kept"] = kept_nodes(run, case["duration"])
    return values


def recording_interval(scene: Scene, base: float, duration: float) -> float:
    """The least multiple of `base` that divides `TICK` and keeps rows within `ROWS`; else the larger of both."""
    width = 6 * len(scene.structure.nodes) + 3 * len(scene.structure.strings) + len(scene.structure.rods) + 8
    whole = round(TICK / base) if base < TICK else 1
    for factor in range(1, whole + 1):
        if whole % factor == 0 and 8.0 * width * duration / (factor * base) <= ROWS:
            return factor * base
    return whole * base


def kept_nodes(run: Trajectory, duration: float) -> dict[str, Any]:
    """Nodes, target error, V, margin and the largest u at times that all runs of one duration record."""
    step = TICK * max(1, math.ceil(round(duration / TICK) / KEPT))
    wanted = np.arange(0, math.floor(run.time[-1] / step + 1e-6) + 1) * step
    rows = np.clip(np.searchsorted(run.time, wanted - 1e-6), 0, len(run.time) - 1)
    good = np.abs(run.time[rows] - wanted) < 1e-6
    rows = rows[good]
    return {
        "times": wanted[good].tolist(),
        "nodes": run.nodes[rows].tolist(),
        "error": run.target_error()[rows].tolist(),
        "lyapunov": run.lyapunov[rows].tolist(),
        "margin": run.feasibility_margin[rows].tolist(),
        "force_density": run.force_densities[rows].max(axis=1, initial=0.0).tolist(),
    }


def with_gain(law: Any, scene: Scene, gain: str, factor: float) -> Any:
    """The law with X, Y or Z of all rods, or its decay rate, times a factor; OptionError if gains are not definite."""
    if gain == "decay_rate":
        return dataclasses.replace(law, decay_rate=law.decay_rate * factor)
    names = [rod.name for rod in scene.structure.rods] + [point.node for point in scene.structure.lone_masses]

    def scaled(given: Any) -> Any:
        every = given if isinstance(given, Mapping) else dict.fromkeys(names, given)
        own = {name: every.get(name, Gains()) for name in names}
        return {
            name: dataclasses.replace(g, **{gain: np.asarray(getattr(g, gain)) * factor}) for name, g in own.items()
        }

    return dataclasses.replace(law, translation=scaled(law.translation), rotation=scaled(law.rotation))


Values = dict[str, Any]

ACTIVE = 1e-6  # part of the largest u above its floor: below it, a string counts as not pulling
FITTED_ERROR = 1e-3  # part of the largest target error down to which its rate is fitted
FITTED_V = 1e-12  # part of V(0), the same
SETTLED = (0.1, 0.02)  # parts of the largest error: settling times


def of_run(
    run: Trajectory, promised_rate: float | None = None, floor: ArrayLike = 0.0, known_plant: bool = True
) -> Values:
    """All measures of a run.

    Args:
        run: completed, or stopped for lack of a solution; with one sample at least.
        promised_rate: δ [1/s] of the law's V̇ = -δ V, or None.
        floor: ū [N/m] of the law, a number or (M,): a string at its floor does not count as pulling.
        known_plant: whether the law is to know the plant, so that what it does not know is a reason to doubt.
    """
    return {
        "status": run.status.value,
        "message": run.message,
        "end_time": float(run.time[-1]),
        "recorded_interval": float(np.median(np.diff(run.time))) if len(run.time) > 1 else 0.0,
        "error": target_error(run),
        "arrival": arrival(run),
        "lyapunov": lyapunov(run, promised_rate),
        "margin": margin(run),
        "peaks": peaks(run),
        "switching": switching(run, floor),
        "rest_lengths": run.reports.get("nonpositive_rest_lengths"),
        "limits": run.reports.get("limits", {}),
        **({"buckling": run.reports["buckling"]} if run.reports.get("buckling") else {}),
        "winch": winch(run),
        "energy_residual": run.energy_residual,
        "warnings": list(run.reports.get("warnings", [])),
        "growth": growth(run),
        "doubts": doubts(run, known_plant),
        "rest": rest(run),
        "acts": bool(np.any(np.ptp(run.rest_lengths, axis=0) > 0)) if len(run.time) else False,
        **({"end": run.nodes[-1].tolist()} if run.scene.target is None and len(run.time) else {}),
    }


def target_error(run: Trajectory) -> Values | None:
    """The largest distance of a node from its target: first, largest, last [m], its fitted rate [1/s], settling times.

    A settling time is the first after which the error stays within that part of its largest; None if it never does.
    """
    error = run.target_error()
    if not len(error) or np.any(np.isnan(error)):
        return None
    largest = float(error.max())
    return {
        "initial": float(error[0]),
        "largest": largest,
        "final": float(error[-1]),
        "rate": decay_rate(run.time, error, FITTED_ERROR * largest),
        **{f"settling_{100 * part:g}": settling_time(run.time, error, part * largest) for part in SETTLED},
    }


def decay_rate(time: Array, values: Array, least: float) -> float | None:
    """The rate δ of the least-squares fit c e^(-δt) to the values > `least`; None where fewer than three are."""
    use = (values > least) & (values > 0)
    if np.count_nonzero(use) < 3:
        return None
    return -float(np.polyfit(time[use], np.log(values[use]), 1)[0])


def settling_time(time: Array, values: Array, bound: float) -> float | None:
    """The first time from which on all values are <= the bound; None if the last is not."""
    above = np.flatnonzero(values > bound)
    if not len(above):
        return float(time[0])
    return float(time[above[-1] + 1]) if above[-1] + 1 < len(time) else None


def arrival(run: Trajectory) -> Values:
    """Return the state at a run's end: the fastest node's speed [m/s]; each rod's cos of the angle to its target."""
    speed = float(np.max(np.linalg.norm(run.velocities[-1], axis=-1), initial=0.0))
    if run.scene.target is None:
        return {"speed": speed, "alignment": None}
    aims = target_nodes(run.scene.structure, run.scene.target, run.time[-1:])[0]
    now, aim = (rods.directions(run.scene.structure, nodes) for nodes in (run.nodes[-1], aims))
    return {"speed": speed, "alignment": np.sum(now * aim, axis=-1).tolist()}


def lyapunov(run: Trajectory, promised_rate: float | None) -> Values | None:
    """V at both ends, the promised and the fitted rate [1/s], and the largest relative error of V(0) e^(-δt)."""
    V = run.lyapunov
    if np.any(np.isnan(V)):
        return None
    return {
        "initial": float(V[0]),
        "final": float(V[-1]),
        "promised_rate": promised_rate,
        "fitted_rate": decay_rate(run.time, V, FITTED_V * float(V[0])),
        "decay_error": run.reports.get("decay_error"),
    }


def margin(run: Trajectory) -> Values | None:
    """The smallest feasibility margin, when and where (nodes, target error [m]); the largest violation of demands."""
    known = ~np.isnan(run.feasibility_margin)
    residual = run.allocation_residual[~np.isnan(run.allocation_residual)]
    if not known.any() and not len(residual):
        return None
    found: Values = {"allocation_residual": float(residual.max()) if len(residual) else None}
    if not known.any():
        return found | {"smallest": None}
    at = int(np.nanargmin(run.feasibility_margin))
    names = run.scene.structure.node_names
    return found | {
        "smallest": float(run.feasibility_margin[at]),
        "time": float(run.time[at]),
        "target_error": float(run.target_error()[at]),
        "nodes": {name: run.nodes[at, row].tolist() for row, name in enumerate(names)},
    }


def peaks(run: Trajectory) -> Values:
    """The largest u [N/m], tension [N], rod compression and rod tension [N]: value, member, time; and the RMS of u."""
    structure = run.scene.structure
    strings = [string.name for string in structure.strings]
    members = [rod.name for rod in structure.rods]
    forces = run.rod_forces
    u = run.force_densities
    return {
        "force_density": _peak(run.time, u, strings),
        "tension": _peak(run.time, run.tensions, strings),
        "compression": _peak(run.time, -forces, members),
        "rod_tension": _peak(run.time, forces, members),
        "rms_force_density": float(np.sqrt(np.mean(u**2))) if u.size else 0.0,
    }


def _peak(time: Array, values: Array, names: list[str]) -> Values | None:
    if not values.size:
        return None
    row, column = np.unravel_index(int(np.argmax(values)), values.shape)
    return {"value": float(values[row, column]), "of": names[int(column)], "time": float(time[row])}


def switching(run: Trajectory, floor: ArrayLike = 0.0) -> Values:
    """Count how often strings begin or cease to pull: per second, of all strings and of each."""
    u = run.force_densities
    least = np.broadcast_to(np.asarray(floor, float), (u.shape[1],))
    above = u - least
    threshold = ACTIVE * float(np.max(above, initial=0.0))
    counts = np.count_nonzero(np.diff((above > threshold).astype(np.int8), axis=0), axis=0)
    span = float(run.time[-1] - run.time[0])
    rates = counts / span if span > 0 else np.zeros(len(counts))
    names = [string.name for string in run.scene.structure.strings]
    return {
        "count": int(counts.sum()),
        "rate": float(rates.sum()),
        "strings": dict(zip(names, rates.tolist(), strict=True)),
        "threshold": threshold,
    }


def winch(run: Trajectory) -> Values:
    """Energy and power of the winches: what they do, what they get back, and the peak and the mean of the power.

    Power is work over the time between samples; `net` = done - recovered; `closure` is its difference from the engine's
    own ledger.
    """
    work = winch_increments(run)
    names = [string.name for string in run.scene.structure.strings]
    if not len(work):
        return {"done": 0.0, "recovered": 0.0, "net": 0.0, "closure": 0.0, "peak": None, "mean": 0.0, "strings": {}}
    power = work / np.diff(run.time)[:, None]
    span = float(run.time[-1] - run.time[0])
    done, back = np.where(work > 0, work, 0.0).sum(axis=0), np.where(work < 0, -work, 0.0).sum(axis=0)
    size = np.abs(power)
    total = np.abs(power.sum(axis=1))
    each = np.stack([done, back, size.max(axis=0), (done + back) / span], axis=1).tolist()
    return {
        "done": float(done.sum()),
        "recovered": float(back.sum()),
        "net": float(work.sum()),
        "closure": float(work.sum() - (run.winch_work[-1] - run.winch_work[0])),
        "peak": _peak(run.time[1:], size, names),
        "peak_total": {"value": float(total.max()), "time": float(run.time[1:][int(np.argmax(total))])},
        "mean": float((done.sum() + back.sum()) / span),
        "strings": {
            name: dict(zip(("done", "recovered", "peak", "mean"), row, strict=True))
            for name, row in zip(names, each, strict=True)
        },
    }
