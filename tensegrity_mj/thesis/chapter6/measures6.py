"""What the rows of chapter 6 measure: projection based control of the pinned rod (§6.2) and of the prism (§6.3)."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.controllers.landscape import angles
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis import measures


def _scalars(run: Trajectory) -> tuple[Array, ...]:
    """b_dᵀb, b_dᵀḃ, ḃᵀḃ of the first rod, (T,) each."""
    b, rate = measures.directions(run)[:, 0], measures.directions(run, run.velocities)[:, 0]
    goal = measures.directions(run, measures.aims(run))[:, 0]
    return np.sum(goal * b, axis=1), np.sum(goal * rate, axis=1), np.sum(rate * rate, axis=1)


def candidate_off(run: Trajectory, number: int) -> float:
    """Largest difference of the printed V1, V2 or V3, (6.18) to (6.20), from the V that the law reports."""
    aligned, along, square = _scalars(run)
    if number == 1:
        value = 1.0 - aligned - along + 0.75 * square
    else:
        mixed = along if number == 2 else aligned * along
        value = 0.5 - 0.5 * aligned**2 - mixed + 0.75 * square
    return float(np.abs(value - run.lyapunov).max())


def candidate_in_angles_off(run: Trajectory, number: int) -> float:
    """Largest difference of V_φ + V_θ, (6.21) to (6.23), from the V that the law reports."""
    way = angles(run)
    phi, rate = way.phi, way.phi_rate
    first = 1.0 - np.cos(phi) if number == 1 else 0.5 * np.sin(phi) ** 2
    mixed = rate * np.sin(phi) * (np.cos(phi) if number == 3 else 1.0)
    turning = 0.75 * (np.sin(phi) * way.theta_rate) ** 2
    return float(np.abs(first + mixed + 0.75 * rate**2 + turning - run.lyapunov).max())
