"""When a string that yields turns back within a step: from then on it unloads, which no stage of that step has seen."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.bisection import bisect
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.reference.equations import place


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
