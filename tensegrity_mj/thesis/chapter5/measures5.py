"""What the rows of chapter 5 measure: Lyapunov control of the pinned rod (§5.4) and of the prism (§5.5)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import nnls

from tensegrity_mj.controllers.scenes import from_scene
from tensegrity_mj.model.rigidity import equilibrium_matrix
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis import measures

SEEN = 0.02  # of a rod: the width of a drawn line


def coordinates_go_astray(run: Trajectory) -> bool:
    """V falls all the time, and yet the error of some coordinate grows for a while."""
    error = np.abs(measures.directions(run) - measures.directions(run, measures.aims(run)))
    grows = np.maximum.accumulate(error[::-1], axis=0)[::-1] - error  # to its largest later value
    return bool(np.all(np.diff(run.lyapunov) < 0.0)) and float(grows.max()) > SEEN


def least_norms(run: Trajectory) -> bool:
    """Whether along the run each law's u has the least of its own norm."""
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
    positions = measures.aims(run)[-1] if at_the_end else run.nodes[0]
    parts = {"b": measures.directions(run, positions), "r": measures.points(run, positions)}
    off = [np.abs(parts[key[0]][int(key[1]) - 1, : len(values)] - values) for key, values in printed.items()]
    return float(np.nanmax(np.concatenate(off)))


def unbalanced(run: Trajectory) -> float:
    """Least unbalanced force [N], at the start or at the target, under u >= 0 that sum to 1 N/m.

    Zero where the shape can be prestressed.
    """

    left = []
    for positions in (run.nodes[0], measures.aims(run)[-1]):
        matrix = equilibrium_matrix(run.scene.structure, positions)
        ones = np.ones((1, matrix.shape[1]))
        left.append(float(nnls(np.vstack([matrix, ones]), np.append(np.zeros(len(matrix)), 1.0))[1]))
    return max(left)
