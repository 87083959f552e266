"""When a string that yields turns back within a step: from then on it unloads, which no stage of that step has seen."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.reference.equations import place


def bisect(holds: Callable[[float], bool], start: float, end: float, within: float = 0.0) -> tuple[float, float]:
    """Two times between which something ends that holds at `start` and not at `end`.

    They are so far apart [s] or, where times are coarser, neighbours.
    """
    while end - start > within:
        middle = 0.5 * (start + end)
        if not start < middle < end:
            break
        if holds(middle):
            start = middle
        else:
            end = middle
    return start, end


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
