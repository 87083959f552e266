"""The times onto which an error-controlled run steps: outputs, samples of a law, breaks, and data of motions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.bisection import bisect
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.reference.equations import place
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError

MOST_SAMPLES = 10_000_000  # of a law in a run: their times are laid out beforehand, in some gigabytes


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
