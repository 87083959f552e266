"""Measures that chapters 4 to 6 take of a trajectory. Times in s, lengths in m, u in N/m."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import nnls

from evidence.thesis.experiments import BEAM_CELLS, cell_strings
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.controllers.scenes import from_scene
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model import rods
from tensegrity_mj.model.rigidity import equilibrium_matrix
from tensegrity_mj.runs.trajectory import Trajectory

ACTIVE = 1e-9  # N/m; below it a string is slack: what rounding leaves of u = 0 is 1e-16
SNAPSHOTS = (0.0, 20.0, 40.0, 60.0)  # s, of figure 4.8
SEEN = 0.02  # of a rod: the width of a drawn line


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


def since(run: Trajectory, time: float, values: Array) -> Array:
    """The part of the values from a time on."""
    return values[run.time >= time - 1e-9]


def at(run: Trajectory, time: float, values: Array) -> Array:
    """The values at the sample nearest to a time."""
    return values[int(np.argmin(np.abs(run.time - time)))]


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
    """Return the times from and to which the sum of all u is above its bound by more than a thousandth."""
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


def error_dynamics(run: Trajectory) -> float:
    """Largest deviation of an error of q from (1 + t) e^(-t) e(0), over e(0)."""
    goal = cross_coordinates(run, aims(run)[-1])
    error = cross_coordinates(run) - goal
    promised = ((1.0 + run.time) * np.exp(-run.time))[:, None] * error[0]
    return float(np.max(np.abs(error - promised) / np.abs(error[0])))


def time_off(run: Trajectory, bound: float, number: int, end: int) -> float:
    """Return when [s] the sum leaves its bound (end 0) or is back on it (1), for the time of that number from 0."""
    found = times_off(run, bound)
    return found[number][end] if number < len(found) else math.nan


def drawn(run: Trajectory, axis: int) -> Array:
    """(4, N) coordinates [m] of the nodes at the times of figure 4.8."""
    return np.array([at(run, time, run.nodes[..., axis]) for time in SNAPSHOTS])


def spread_of_cells(run: Trajectory) -> float:
    """Largest over smallest sum of a cell, at the time where that is most."""
    cells = cell_sums(run)
    return float((cells.max(axis=1) / cells.min(axis=1)).max())


# ------------------------------------------------------------------------------------------------------- chapter 5


def coordinates_go_astray(run: Trajectory) -> bool:
    """V falls all the time, and yet the error of some coordinate grows for a while."""
    error = np.abs(directions(run) - directions(run, aims(run)))
    grows = np.maximum.accumulate(error[::-1], axis=0)[::-1] - error  # to its largest later value
    return bool(np.all(np.diff(run.lyapunov) < 0.0)) and float(grows.max()) > SEEN


def least_norms(run: Trajectory) -> bool:
    """Return whether along the run each law's u has the least of its own norm."""
    laws = {p: from_scene(run.scene, norm=p) for p in (1, 2, math.inf)}
    for k in range(0, len(run.time), 50):
        state = run.time[k], run.nodes[k], run.velocities[k]
        u = {p: law(*state) for p, law in laws.items()}
        for p in u:
            norms = {other: np.linalg.norm(u[other], p) for other in u}
            if norms[p] > min(norms.values()) * (1.0 + 1e-9):
                return False
    return True


def printed_off(run: Trajectory, at_the_end: bool, printed: Mapping[str, Sequence[float]]) -> float:
    """Largest difference of the prism's start, or of its target at the end, from printed components.

    Args:
        printed: of vectors such as "b1" and "r2"; NaN for those that are not printed.
    """
    positions = aims(run)[-1] if at_the_end else run.nodes[0]
    parts = {"b": directions(run, positions), "r": points(run, positions)}
    off = [np.abs(parts[key[0]][int(key[1]) - 1, : len(values)] - values) for key, values in printed.items()]
    return float(np.nanmax(np.concatenate(off)))


def unbalanced(run: Trajectory) -> float:
    """Least unbalanced force [N], at the start or at the target, under u >= 0 that sum to 1 N/m.

    Zero where the shape can be prestressed.
    """

    left = []
    for positions in (run.nodes[0], aims(run)[-1]):
        matrix = equilibrium_matrix(run.scene.structure, positions)
        ones = np.ones((1, matrix.shape[1]))
        left.append(float(nnls(np.vstack([matrix, ones]), np.append(np.zeros(len(matrix)), 1.0))[1]))
    return max(left)


# ------------------------------------------------------------------------------------------------------- chapter 6


def scalars(run: Trajectory) -> tuple[Array, ...]:
    """b_dᵀb, b_dᵀḃ, ḃᵀḃ of the first rod, (T,) each."""
    b, rate = directions(run)[:, 0], directions(run, run.velocities)[:, 0]
    goal = directions(run, aims(run))[:, 0]
    return np.sum(goal * b, axis=1), np.sum(goal * rate, axis=1), np.sum(rate * rate, axis=1)
