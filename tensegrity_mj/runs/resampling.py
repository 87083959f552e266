"""A run at the times of a table: interpolated between its samples, with an estimate of what that is wrong by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.runs.convergence import common_times
from tensegrity_mj.runs.trajectory import Trajectory

ORDERS = {"nodes": 4, "velocities": 4, "tensions": 2}  # of the error, in the spacing of samples, on smooth motion
FEWEST = 9  # samples that show how an error falls


@dataclass(frozen=True, eq=False)
class Resampled:
    """A run at other times: `values` of each of `ORDERS`, and estimates of their largest `errors`; NaN for unknown."""

    values: dict[str, Array]
    errors: dict[str, float]


def resampled(run: Trajectory, times: Array) -> Resampled:
    """A run at times (T,) within it [s].

    Positions are cubic Hermite polynomials of the recorded positions and velocities (error h⁴/384 max |d⁴n/dt⁴| for
    samples h apart), velocities cubic splines, tensions straight lines, which alone make no push of a slack string.
    Where all times are samples of the run, these are taken as they are.

    The error is estimated from the samples themselves: the largest distance of those between from what every other one
    foresees falls to the spacing of the samples as it did from every fourth to every other one, at most by the order
    that smooth motion has. It is an estimate, not a bound: what leaves no trace in the samples cannot be seen.
    """
    rows, columns = common_times(run.time, times)
    if len(columns) == len(times):
        return Resampled({name: getattr(run, name)[rows] for name in ORDERS}, dict.fromkeys(ORDERS, 0.0))
    first = max(int(np.searchsorted(run.time, times[0], side="right")) - 1, 0)
    last = min(int(np.searchsorted(run.time, times[-1])), len(run.time) - 1)
    # As many samples more as make quarters of them: before, or after.
    first = max(first - (first - last) % 4, 0)
    last = min(last + (first - last) % 4, len(run.time) - 1)
    known = last - first + 1 >= FEWEST
    return Resampled(
        {name: np.asarray(_interpolant(run, name, slice(first, last + 1))(times)) for name in ORDERS},
        {name: _error(run, name, first, last - (last - first) % 4) if known else float("nan") for name in ORDERS},
    )


def _interpolant(run: Trajectory, name: str, rows: slice) -> Any:
    from scipy.interpolate import CubicHermiteSpline, CubicSpline, make_interp_spline  # slow to load

    time, values = run.time[rows], getattr(run, name)[rows]
    if name == "nodes":
        return CubicHermiteSpline(time, values, run.velocities[rows])
    return CubicSpline(time, values) if name == "velocities" else make_interp_spline(time, values, k=1)


def _error(run: Trajectory, name: str, first: int, last: int) -> float:
    """The estimate of `resampled` for one quantity, from the samples `first` to `last`, which are 1 more than 4 k."""
    differences = []
    for stride in (4, 2):
        between = slice(first + stride // 2, last, stride)
        foreseen = _interpolant(run, name, slice(first, last + 1, stride))(run.time[between])
        missed = getattr(run, name)[between] - foreseen
        size = np.linalg.norm(missed, axis=-1) if missed.ndim == 3 else np.abs(missed)
        differences.append(float(np.max(size, initial=0.0)))
    before, now = differences
    return now / min(max(before / now, 1.0), 2.0 ** ORDERS[name]) if now > 0 else 0.0
