"""What the rows of chapter 5 measure: Lyapunov control of the pinned rod (§5.4) and of the prism (§5.5)."""

from __future__ import annotations

import math

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis import measures

# Printed in §5.5 in four digits: vector, axis, value; at the start and at the target.
PRINTED_START = {
    "b1": (0.4243, 0.4243, 0.8),
    "b2": (-0.5796, 0.1553, 0.8),
    "b3": (0.1553, -0.5796, 0.8),
    "r2": (0.4659, 0.2690),
    "r3": (None, 0.5379),
}
PRINTED_TARGET = {
    "b1": (0.5657, 0.5657, 0.6),
    "b2": (-0.7727, 0.2071, 0.6),
    "b3": (0.2071, -0.7727, 0.6),
    "r2": (0.6212, 0.3586),
    "r3": (None, 0.7173),
}
SEEN = 0.02  # of a rod: the width of a drawn line


def start_off(run: Trajectory) -> float:
    """Largest difference of b(0) from the printed (1, -√2, √2)/√5."""
    printed = np.array([1.0, -math.sqrt(2.0), math.sqrt(2.0)]) / math.sqrt(5.0)
    return float(np.abs(measures.directions(run)[0, 0] - printed).max())


def coordinates_go_astray(run: Trajectory) -> bool:
    """V falls all the time, and yet the error of some coordinate grows for a while."""
    error = np.abs(measures.directions(run) - measures.directions(run, measures.aims(run)))
    grows = np.maximum.accumulate(error[::-1], axis=0)[::-1] - error  # to its largest later value
    return bool(np.all(np.diff(run.lyapunov) < 0.0)) and float(grows.max()) > SEEN


def least_norms(run: Trajectory) -> bool:
    """Whether along the run each law's u has the least of its own norm."""
    from tensegrity_mj.controllers.scenes import from_scene

    laws = {p: from_scene(run.scene, norm=p) for p in (1, 2, math.inf)}
    for k in range(0, len(run.time), 50):
        state = run.time[k], run.nodes[k], run.velocities[k]
        u = {p: law(*state) for p, law in laws.items()}
        for p in u:
            norms = {other: np.linalg.norm(u[other], p) for other in u}
            if norms[p] > min(norms.values()) * (1.0 + 1e-9):
                return False
    return True


def strings_that_pull(run: Trajectory) -> int:
    """How many strings pull at some time."""
    return int(np.sum(run.force_densities.max(axis=0) > measures.ACTIVE))


def printed_start_off(run: Trajectory) -> float:
    """Largest difference of the prism's start from its printed components."""
    return _off_printed(run, run.nodes[0], PRINTED_START)


def printed_target_off(run: Trajectory) -> float:
    """Largest difference of the prism's target from its printed components."""
    return _off_printed(run, measures.aims(run)[-1], PRINTED_TARGET)


def _off_printed(run: Trajectory, positions: Array, printed: dict[str, tuple[float | None, ...]]) -> float:
    parts = {"b": measures.directions(run, positions), "r": measures.points(run, positions)}
    return max(
        abs(float(parts[key[0]][int(key[1]) - 1, axis]) - value)
        for key, values in printed.items()
        for axis, value in enumerate(values)
        if value is not None
    )


def unbalanced(run: Trajectory) -> float:
    """Least unbalanced force [N], at the start or at the target, under u >= 0 that sum to 1 N/m.

    Zero where the shape can be prestressed.
    """
    from scipy.optimize import nnls

    from tensegrity_mj.model.rigidity import equilibrium_matrix

    left = []
    for positions in (run.nodes[0], measures.aims(run)[-1]):
        matrix = equilibrium_matrix(run.scene.structure, positions)
        ones = np.ones((1, matrix.shape[1]))
        left.append(float(nnls(np.vstack([matrix, ones]), np.append(np.zeros(len(matrix)), 1.0))[1]))
    return max(left)


# ------------------------------------------------------------------------------------------------ gains of §5.6
