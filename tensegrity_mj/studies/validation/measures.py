"""Measures of one run in the report, from its trajectory, as plain values; docs/validate.md explains them.

Everything is of the recorded samples: a run is recorded at every control sample where memory allows it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.model import rods
from tensegrity_mj.runs.energy import winch_increments
from tensegrity_mj.runs.judgement import doubts, growth, rest
from tensegrity_mj.runs.trajectory import Trajectory

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
