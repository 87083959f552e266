"""How the time of the reference model's right-hand side grows with the number of rods of a cable.

points = cable_scaling()                                    # joint forces, K = 200 to 5000
exponent(points)                                            # about 1
cable_scaling((500,), DENSE)[0].seconds / points[1].seconds
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dense_equations import dae

from tensegrity_mj.engines.reference import equations as kernels
from tensegrity_mj.engines.reference.dae import Solver
from tensegrity_mj.engines.request import request_for
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import cable
from tensegrity_mj.model.actuation import OnInfeasible

COUNTS = (200, 500, 1000, 2000, 5000)
LEAST_TIME = 0.02  # s, of one measurement
REPEATS = 7  # measurements, of which the shortest counts: what else a machine does only adds


@dataclass(frozen=True)
class Evaluation:
    """One right-hand side, with everything that an integrator's stage takes.

    Attributes:
        elements: K.
        solver: how accelerations are found.
        seconds: of one evaluation [s].
    """

    elements: int
    solver: Solver | str
    seconds: float


def cable_scaling(counts: Sequence[int] = COUNTS, solver: Solver | str = Solver.JOINTS) -> list[Evaluation]:
    """Time the right-hand side of cables with some numbers of elements.

    The cable of `library.cable` is driven as by default, and looked at a little off its straight start.

    Raises:
        OptionError: for a number of elements that makes no cable.
    """
    return [_timed(count, solver) for count in counts]


def exponent(points: Sequence[Evaluation]) -> float:
    """p of the power law seconds ~ K^p that fits best.

    Raises:
        OptionError: for fewer than two numbers of elements.
    """
    counts, seconds = [point.elements for point in points], [point.seconds for point in points]
    if len(set(counts)) < 2:
        raise OptionError(f"an exponent takes two numbers of elements or more; there are {sorted(set(counts))}")
    return float(np.polyfit(np.log(counts), np.log(seconds), 1)[0])


def _timed(elements: int, solver: Solver | str) -> Evaluation:
    scene = cable(elements)
    request = request_for(scene, None, None, None, OnInfeasible.STOP, None, progress=False)
    run = dae(solver).prepared(request)
    y, out = run.y + 1e-3 * np.sin(np.arange(len(run.y))), np.empty(len(run.y))

    def evaluate(times: int) -> float:
        start = time.perf_counter()
        for _ in range(times):
            kernels.rates(0.1, y, out, run.table)
        return time.perf_counter() - start

    evaluate(1)  # compiles
    times = max(1, math.ceil(LEAST_TIME / max(evaluate(1), 1e-7)))
    return Evaluation(elements, solver, min(evaluate(times) for _ in range(REPEATS)) / times)
