"""Where error-controlled steps must end, and what is looked for within them.

They step onto samples of a law, breaks, data of motions and some outputs (`marks_of`); they end where a string that
yields begins to grow shorter. Strings that are slack at both ends of a step may pull for a moment within it: slack
strings leave a motion so smooth that steps grow long, and none of their stages may see it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, bisect
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.engines.reference.equations import place
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError

MOST_SAMPLES = 10_000_000  # of a law in a run: their times are laid out beforehand, in some gigabytes
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


def marks_of(request: Request, times: Array, with_outputs: bool) -> list[tuple[float, bool, bool]]:
    """Times to step onto, each with whether something jumps there, and whether that is a sample of the law."""
    jumps: dict[float, bool] = {}

    def add(time: float, window: float, is_sample: bool) -> None:
        # The very float of an output or a sample where they coincide, so that no sliver of a step lies between.
        nearest = int(np.searchsorted(times, time - window))
        candidates = (float(times[min(nearest, len(times) - 1)]), *(() if is_sample else jumps))
        at = next((other for other in candidates if abs(other - time) < window), time)
        jumps[at] = jumps.get(at, False) or is_sample

    if request.sampled:
        period = request.actuation.period
        assert period is not None
        count = request.duration / period * (1 + 1e-12)
        if count > MOST_SAMPLES:
            raise OptionError(
                f"control period = {period:g} s: a run of {request.duration:g} s samples the law {count:.3g} times; at "
                f"most {MOST_SAMPLES} samples are taken: choose a longer period or a shorter run"
            )
        begun = math.floor(request.begin / period * (1 + 1e-12))
        for number in range(begun + 1, math.floor((request.begin + request.duration) / period * (1 + 1e-12)) + 1):
            add(number * period, 1e-9 * period, is_sample=True)
    for time in request.scene.break_times:
        if times[0] < time <= times[-1]:
            add(float(time), 1e-12 * time, is_sample=False)
    marks = {time: (True, is_sample) for time, is_sample in jumps.items()}
    if with_outputs:
        for time in times[1:]:
            marks.setdefault(float(time), (False, False))
    for motion in request.scene.motions:  # a derivative of data jumps at each of their times
        for time in motion.times:
            if times[0] < time < times[-1]:
                marks.setdefault(float(time), (False, False))
    marks.setdefault(float(times[-1]), (False, False))
    return [(time, *what) for time, what in sorted(marks.items())]


def turn_within(plant: Plant, start: float, end: float, states: Any) -> float:
    """The first time [s] just after which such a string grows shorter; `end` where none turns.

    Args:
        plant: of the run.
        start, end: of the step.
        states: the function of times whose values are the states.
    """
    yields = plant["yields"].astype(bool)

    def rates(time: float) -> Array:
        place(np.ascontiguousarray(states(time)), plant.address)
        return np.array(plant["rates"])

    turning: NDArray[np.bool_] = yields & (rates(start) > 0) & (rates(end) < 0)
    if not turning.any():
        return end
    return bisect(lambda time: not np.any(rates(time)[turning] <= 0), start, end)[1]
