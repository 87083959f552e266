"""Measures that chapter 7 takes of the tower before and after form-finding, and in waves (§7.2.3)."""

from __future__ import annotations

import numpy as np

from evidence.families.thesis_towers import CHAPTER7_STAGES, PRESTRESS_MEASURES, STIFFNESSES
from evidence.thesis.appendix_c.beams import BeamRun
from tensegrity_mj.basics.arrays import Array


def label_of(stiffness: float, measure: float) -> str:
    """The name of a case of the tower in waves."""
    return f"{stiffness / 1e3:g} kN/m {measure:g} m"


FIRST, STAGES = 8, 3  # of the close view of figure 7.6: stages 8 to 10 of 15
FORMED = f"full {label_of(10e3, 0.10)}"
SOFT = label_of(STIFFNESSES[0], PRESTRESS_MEASURES[0])
SHOWN = label_of(STIFFNESSES[2], PRESTRESS_MEASURES[0])  # of figure 7.8
PERIODS = 3  # of the wave, at the end of each run
LIKE = 0.1  # of D: how far periods may differ that count as alike


# ------------------------------------------------------------------------------------------------------ form-finding


def stage_turn(run: BeamRun) -> float:
    """[°] by which each stage is turned from the one below, before form-finding, within 120°."""
    nodes = run.of(FORMED, "before").reshape(CHAPTER7_STAGES, 2, 3, 3)
    angles = np.degrees(np.arctan2(nodes[:, 0, 0, 2], nodes[:, 0, 0, 1]))
    return float(np.max(np.mod(np.diff(angles), 120.0)))


# ---------------------------------------------------------------------------------------------------------- in waves


def grid(run: BeamRun, name: str = "largest") -> Array:
    """(3, 3): of each stiffness a row, over prestress measures."""
    return np.array([[run.values[label_of(k, p)][name] for p in PRESTRESS_MEASURES] for k in STIFFNESSES], float)


def cyclic(run: BeamRun, label: str) -> float:
    """Return the spread of the largest D of the last periods, over their mean."""
    time, D = run.of(label, "time"), run.of(label, "D")
    period = run.values[label]["period"]
    largest = [D[(time > time[-1] - (n + 1) * period) & (time <= time[-1] - n * period)].max() for n in range(PERIODS)]
    return float(np.ptp(largest) / np.mean(largest))


def _afloat(run: BeamRun, label: str) -> bool:
    """Return whether the axis was below the surface and then is about it."""
    height = run.of(label, "height")
    return bool(height[0] < -0.9 and abs(height[-len(height) // 8 :].mean()) < 0.5)


def floats_and_repeats(run: BeamRun) -> bool:
    """Return whether the tower comes to float, and its motion to repeat, in all cases."""
    return all(cyclic(run, label) < LIKE and _afloat(run, label) for label in run.values)
