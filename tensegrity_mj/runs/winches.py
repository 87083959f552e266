"""Work of winches: a law sets rest lengths against the tension of the strings, and that is work on them.

Power is counted as done on the strings, P = -T dL0/dt with T the elastic tension: positive where a winch hauls in,
negative where a string pulls line out of it. A winch that stands still holds any tension at no power.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.actuation import Mode

if TYPE_CHECKING:
    from tensegrity_mj.runs.trajectory import Trajectory


def winch_increments(run: Trajectory) -> Array:
    """Work of each string's winch between samples, -∫ T dL0 [J], (T - 1, M); T is the elastic tension.

    Exact where rest lengths or force densities are held and every control sample is recorded; else by the trapezoidal
    rule, of second order in the recorded interval. Of the interval in which a string breaks, what its winch did is
    known only where a sample is recorded at the break. NaN for strings that yield, where commands are held.
    """
    structure = run.scene.structure
    curves, k = structure.curves, structure.stiffness
    L, L0 = structure.string_lengths(run.nodes), run.rest_lengths
    elastic = run.force_densities * L
    mode = (run.provenance.get("actuation") or {}).get("mode", Mode.CONTINUOUS.value)
    intact = run.time[:, None] < run.scene.break_times  # what a breaking string sets free is no winch's work
    gradual = np.asarray(-0.5 * (elastic[1:] + elastic[:-1]) * np.diff(L0, axis=0))
    if not curves.linear and mode != Mode.CONTINUOUS.value:
        if mode == Mode.HOLD_REST_LENGTH.value:
            jumps = curves.energy(L[1:] - L0[1:]) - curves.energy(L[1:] - L0[:-1])
        else:
            stored = curves.energy(curves.stretch(elastic))
            jumps = np.diff(stored, axis=0) - 0.5 * run.force_densities[:-1] * np.diff(L**2, axis=0)
        return np.where(curves.yields, np.nan, np.where(intact[1:], jumps, 0.0))
    if mode == Mode.HOLD_REST_LENGTH.value:
        # All of it at the sample, where the string's length does not change.
        before, after = np.maximum(L[1:] - L0[:-1], 0.0), np.maximum(L[1:] - L0[1:], 0.0)
        return np.asarray(intact[1:] * k / 2 * (after**2 - before**2))
    if mode == Mode.HOLD_FORCE_DENSITY.value:
        # u is held from sample to sample while the string moves, then jumps.
        u = run.force_densities
        between = -0.5 * u[:-1] * (1 - u[:-1] / k) * (L[1:] ** 2 - L[:-1] ** 2)
        return np.asarray(between + intact[1:] * 0.5 * (u[1:] ** 2 - u[:-1] ** 2) * L[1:] ** 2 / k)
    return gradual


def winch_power(run: Trajectory) -> Array:
    """Mean power of each string's winch from each recorded time to the next [W], (T - 1, M), positive where it hauls.

    Times the intervals it adds up to the run's `winch_work`: to round-off and what fixed steps add in the sampled modes
    if every control sample is recorded, else to second order in the recorded interval (see `winch_increments`). Empty
    for a run of less than two samples.
    """
    return np.asarray(winch_increments(run) / np.diff(run.time)[:, None])
