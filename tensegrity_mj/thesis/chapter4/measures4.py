"""What the rows of chapter 4 measure: coordinates and sums of u of the cross (§4.6.1) and of the beam (§4.6.2)."""

from __future__ import annotations

import math

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis import measures

SNAPSHOTS = (0.0, 20.0, 40.0, 60.0)  # s, of figure 4.8


def error_dynamics(run: Trajectory) -> float:
    """Largest deviation of an error of q from (1 + t) e^(-t) e(0), over e(0)."""
    goal = measures.cross_coordinates(run, measures.aims(run)[-1])
    error = measures.cross_coordinates(run) - goal
    promised = ((1.0 + run.time) * np.exp(-run.time))[:, None] * error[0]
    return float(np.max(np.abs(error - promised) / np.abs(error[0])))


# ------------------------------------------------------------------------------------------------------- sums of u


def time_off(run: Trajectory, bound: float, number: int, end: int) -> float:
    """When [s] the sum leaves its bound (end 0) or is back on it (1), for the time of that number from 0."""
    found = measures.times_off(run, bound)
    return found[number][end] if number < len(found) else math.nan


# ---------------------------------------------------------------------------------------------- shape of the beam


def shape_equation(run: Trajectory) -> float:
    """Largest residual of (4.15), as corrected, over ℓ², with h = 1 m and ℓ² = 2 m²."""
    phi, inner = measures.sector_angle(run), measures.radii(run)[:, 0]
    found = (1.0 + inner * (1.0 - np.cos(phi))) ** 2 + (inner * np.sin(phi)) ** 2
    return float(np.abs(found / 2.0 - 1.0).max())


# ------------------------------------------------------------------------------------------------- groups and cells


def drawn(run: Trajectory, axis: int) -> Array:
    """(4, N) coordinates [m] of the nodes at the times of figure 4.8."""
    return np.array([measures.at(run, time, run.nodes[..., axis]) for time in SNAPSHOTS])


def spread_of_cells(run: Trajectory) -> float:
    """Largest over smallest sum of a cell, at the time where that is most."""
    cells = measures.cell_sums(run)
    return float((cells.max(axis=1) / cells.min(axis=1)).max())
