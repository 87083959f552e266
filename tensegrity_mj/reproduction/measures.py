"""Quantities of a trajectory that the statements and the figures speak of. Times in s, lengths in m, u in N/m."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.errors import OptionError
from tensegrity_mj.trajectory import Trajectory

Array = NDArray[np.float64]

ACTIVE = 1e-9  # N/m; below it a string is slack: what rounding leaves of u = 0 is 1e-16


def directions(run: Trajectory, nodes: Array | None = None) -> Array:
    """b (T, R, 3) of every rod."""
    structure = run.scene.structure
    positions = run.nodes if nodes is None else nodes
    pairs = structure.rod_nodes
    return (positions[..., pairs[:, 1], :] - positions[..., pairs[:, 0], :]) / structure.rod_lengths[:, None]


def rates(run: Trajectory) -> Array:
    """ḃ (T, R, 3) of every rod [1/s]."""
    return directions(run, run.velocities)


def points(run: Trajectory, nodes: Array | None = None) -> Array:
    """r (T, R, 3) of every rod: (1 - σ) n_i + σ n_j."""
    structure = run.scene.structure
    positions = run.nodes if nodes is None else nodes
    pairs = structure.rod_nodes
    sigma = np.array([rod.support.sigma for rod in structure.rods])[:, None]
    return (1.0 - sigma) * positions[..., pairs[:, 0], :] + sigma * positions[..., pairs[:, 1], :]


def aims(run: Trajectory) -> Array:
    """Target positions (T, N, 3) of the nodes."""
    if run.scene.target is None:
        raise OptionError(f"scene '{run.scene.name}' has no target")
    return target_nodes(run.scene.structure, run.scene.target, run.time)


def rotation_errors(run: Trajectory) -> Array:
    """‖e_b‖ (T, R)."""
    return np.linalg.norm(directions(run) - directions(run, aims(run)), axis=-1)


def translation_errors(run: Trajectory) -> Array:
    """‖e_r‖ (T, R)."""
    return np.linalg.norm(points(run) - points(run, aims(run)), axis=-1)


def since(run: Trajectory, time: float, values: Array) -> Array:
    """The part of the values from a time on."""
    return values[run.time >= time - 1e-9]


def at(run: Trajectory, time: float, values: Array) -> Array:
    """The values at the sample nearest to a time."""
    return values[int(np.argmin(np.abs(run.time - time)))]


def peak(run: Trajectory, start: float = 0.0) -> float:
    """Largest u of all strings from a time on."""
    return float(since(run, start, run.force_densities).max())


def decay_error(run: Trajectory, decay_rate: float) -> float:
    """Largest difference of V(t) and V(0) e^(-δt), as a fraction of V(0) e^(-δt)."""
    promised = run.lyapunov[0] * np.exp(-decay_rate * run.time)
    return float(np.max(np.abs(run.lyapunov / promised - 1.0)))


def active_strings(run: Trajectory) -> NDArray[np.int64]:
    """How many strings pull at each sample."""
    return np.sum(run.force_densities > ACTIVE, axis=1)


def spread_of_active(run: Trajectory) -> float:
    """Largest difference of two nonzero u at one time, as a fraction of the larger."""
    u = run.force_densities
    high = u.max(axis=1)
    low = np.where(u > ACTIVE, u, np.inf).min(axis=1)
    pulls = high > ACTIVE
    return float(np.max(1.0 - low[pulls] / high[pulls]))


def largest_jump(run: Trajectory, start: float = 1.0) -> float:
    """Largest change of a u between two samples from a time on, as a fraction of the largest u there."""
    u = since(run, start, run.force_densities)
    return float(np.abs(np.diff(u, axis=0)).max() / u.max())


def switches(run: Trajectory, start: float = 1.0) -> int:
    """How often a string begins or ceases to pull, as the samples show it."""
    pulls = since(run, start, run.force_densities) > ACTIVE
    return int(np.sum(pulls[1:] != pulls[:-1]))


def half_time(run: Trajectory) -> float:
    """The last time at which the error of the node farthest from its target is above half of the first."""
    error = run.target_error()
    above = np.flatnonzero(error > 0.5 * error[0])
    return float(run.time[above[-1]]) if above.size else math.nan


def top_speed(run: Trajectory) -> float:
    """Largest speed of a node [m/s]."""
    return float(np.linalg.norm(run.velocities, axis=-1).max())
