"""Quantities of a trajectory that the statements and the figures speak of. Times in s, lengths in m, u in N/m."""

from __future__ import annotations

import math

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model import rods
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis.experiments import BEAM_CELLS, cell_strings

ACTIVE = 1e-9  # N/m; below it a string is slack: what rounding leaves of u = 0 is 1e-16


def directions(run: Trajectory, nodes: Array | None = None) -> Array:
    """b (T, R, 3) of every rod."""
    return rods.directions(run.scene.structure, run.nodes if nodes is None else nodes)


def points(run: Trajectory, nodes: Array | None = None) -> Array:
    """r (T, R, 3) of every rod."""
    return rods.support_points(run.scene.structure, run.nodes if nodes is None else nodes)


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


def peak(run: Trajectory) -> float:
    """Largest u of all strings."""
    return float(run.force_densities.max())


def decay_error(run: Trajectory, decay_rate: float) -> float:
    """Largest difference of V(t) and V(0) e^(-δt), as a fraction of V(0) e^(-δt)."""
    promised = run.lyapunov[0] * np.exp(-decay_rate * run.time)
    return float(np.max(np.abs(run.lyapunov / promised - 1.0)))


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


def time_below(run: Trajectory, part: float) -> float:
    """The last time at which the error of the node farthest from its target is above a part of the first."""
    error = run.target_error()
    above = np.flatnonzero(error > part * error[0])
    return float(run.time[above[-1]]) if above.size else math.nan


def height(run: Trajectory, positions: Array) -> float:
    """Height of the top nodes over the bottom nodes; NaN where they differ."""
    z = positions[run.scene.structure.rod_nodes, 2]
    height = z[:, 1] - z[:, 0]
    return float(height.mean()) if np.ptp(height) < 0.01 else math.nan


# ------------------------------------------------------------------------------------------------------- chapter 4


def cross_coordinates(run: Trajectory, nodes: Array | None = None) -> Array:
    """q = (y_1 [m], θ_1, θ_2 [°]) of the cross, (T, 3); the thesis' y is our z."""
    positions = run.nodes if nodes is None else nodes
    b = directions(run, positions)
    angle = np.degrees(np.arctan2(b[..., 2], b[..., 0]))
    return np.concatenate([positions[..., :1, 2], angle], axis=-1)


def sums(run: Trajectory) -> Array:
    """The sum of all u (T,)."""
    return np.sum(run.force_densities, axis=1)


def times_off(run: Trajectory, bound: float) -> list[tuple[float, float]]:
    """From when to when the sum of all u is above its bound by more than a thousandth."""
    above = np.concatenate([[False], sums(run) > bound * (1.0 + 1e-3), [False]])
    turns = np.flatnonzero(above[1:] != above[:-1])
    return [(float(run.time[a]), float(run.time[b - 1])) for a, b in zip(turns[::2], turns[1::2], strict=True)]


def sector_angle(run: Trajectory) -> Array:
    """φ (T,) of the beam's cells [rad]: between the two rims' lines at the ends of the first pair of rods."""
    first, second = _edges(run)
    return np.arctan2(np.abs(first[:, 0] * second[:, 2] - first[:, 2] * second[:, 0]), np.sum(first * second, axis=1))


def radii(run: Trajectory) -> Array:
    """r_i and r_o (T, 2) of the beam, from the chords of the first pair of rods."""
    n, half = run.nodes, np.sin(0.5 * sector_angle(run))
    inner = np.linalg.norm(n[:, 1] - n[:, 2], axis=1) / (2.0 * half)
    outer = np.linalg.norm(n[:, 3] - n[:, 0], axis=1) / (2.0 * half)
    return np.column_stack([inner, outer])


def describing_lengths(run: Trajectory) -> Array:
    """The six string lengths of figure 4.7 (T, 6): outer rim, inner rim, crossing, of cell 1 and of cell 2."""
    lengths = np.stack([run.scene.structure.string_lengths(nodes) for nodes in run.nodes])
    return lengths[:, [1, 6, 2, 7, 3, 8]]


def cell_sums(run: Trajectory) -> Array:
    """The sum of u in each of the beam's 39 cells (T, 39)."""
    u = run.force_densities
    return np.stack([u[:, list(cell_strings(cell))].sum(axis=1) for cell in range(1, BEAM_CELLS + 1)], axis=1)


def beam_group(run: Trajectory, group: str) -> Array:
    """u of a group of the beam's strings (T, n): rims, verticals, or the crossing strings of even or of odd cells."""
    cells = np.arange(BEAM_CELLS)
    chosen = {
        "verticals": 5 * np.arange(BEAM_CELLS + 1),
        "rims": np.concatenate([5 * cells + 1, 5 * cells + 2]),
        "even": np.concatenate([5 * cells[1::2] + 3, 5 * cells[1::2] + 4]),
        "odd": np.concatenate([5 * cells[::2] + 3, 5 * cells[::2] + 4]),
    }[group]
    return run.force_densities[:, chosen]


def _edges(run: Trajectory) -> tuple[Array, Array]:
    n = run.nodes
    return n[:, 0] - n[:, 2], n[:, 3] - n[:, 1]
