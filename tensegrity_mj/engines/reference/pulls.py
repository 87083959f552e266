"""Search for strings that are slack at both ends of a step, but pull for a moment within it.

Slack strings leave a motion so smooth that error-controlled steps grow long, and none of their stages may see it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.engines.reference.equations import place

LOOKS = 16  # times within a step at which such a string is looked at, and again about its longest


def pulls_within(
    plant: Plant, start: float, end: float, before: Array, after: Array, interpolant: Callable[[], Any]
) -> bool:
    """Return whether any string does so between two times [s], by looking at states in between.

    Args:
        plant: of the run.
        start, end: of the step.
        before, after: the states there (size,).
        interpolant: makes the function of times (T,) whose values are the states (size, T); only called where a string
            may have pulled.
    """
    table, near = plant.address, np.empty(plant["string_count"], dtype=np.bool_)
    if not _may_pull(table, end - start, before, after, near):
        return False
    states, longest = interpolant(), np.zeros(len(near), dtype=np.int64)
    times = np.linspace(start, end, LOOKS + 1)
    if _look(table, states(times), near, longest):
        return True
    spacing, unused = (end - start) / LOOKS, np.empty_like(longest)
    for t in times[np.unique(longest[near])]:
        between = np.linspace(max(t - spacing, start), min(t + spacing, end), LOOKS + 1)
        if _look(table, states(between), near, unused):
            return True
    return False


@njit
def _may_pull(table: int, step: float, before: Any, after: Any, near: Any) -> bool:
    """Mark in `near` (M,) the strings that are slack at both ends, and not too slack to have pulled within a step [s].

    Both ends of a segment may run at twice the speed of the step's ends, and have to come back again.
    """
    plant = PlantView(table)
    rest, lengths, broken, velocities = plant.rest, plant.lengths, plant.broken, plant.velocities
    ranges = plant.ranges
    M, fastest = len(rest), 0.0
    gaps = np.full(M, np.inf)
    for m in range(M):
        near[m] = broken[m] == 0
    for y in (before, after):
        place(y, table)
        for m in range(M):
            gap = rest[m] - lengths[m]
            gaps[m] = min(gaps[m], gap)
            near[m] &= gap > 0.0
        for n in range(len(velocities)):
            v = velocities[n]
            fastest = max(fastest, v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    any_near = False
    for m in range(M):
        near[m] &= gaps[m] < 2.0 * (ranges[m, 1] - ranges[m, 0]) * np.sqrt(fastest) * step
        any_near |= near[m]
    return any_near


@njit
def _look(table: int, states: Any, near: Any, longest: Any) -> bool:
    """Return whether any of the strings `near` (M,) pulls in any of the states (size, T); note when each is longest."""
    plant, M = PlantView(table), len(near)
    rest, lengths = plant.rest, plant.lengths
    y, least = np.empty(states.shape[0]), np.full(M, np.inf)
    for k in range(states.shape[1]):
        y[:] = states[:, k]
        place(y, table)
        for m in range(M):
            gap = rest[m] - lengths[m]
            if near[m] and gap < 0.0:
                return True
            if gap < least[m]:
                least[m], longest[m] = gap, k
    return False
