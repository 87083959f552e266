"""DAE and ODE with an accuracy: which methods are tried, and what each costs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tensegrity_mj.convergence import count_kinks
from tensegrity_mj.engines.accuracy import Way, can_locate, find, fixed_step_way, round_off
from tensegrity_mj.engines.accuracy_ladder import LEAST_TOLERANCE, Ladder
from tensegrity_mj.engines.accuracy_steps import Steps, known_rate
from tensegrity_mj.engines.integration import IntegratedRun, Method
from tensegrity_mj.engines.run import DEFAULT_INTERVAL, Request
from tensegrity_mj.trajectory import Trajectory

# Microseconds, measured on runs of 3 to 12 strings, with and without a law, of which only ratios matter: an evaluation
# by the compiled RK4 took 0.25 + (0.6 - 0.25) / 9 (M - 3) without a law and three times that with one; SciPy adds 5
# to 8 to each evaluation by DOP853 and 17 to 22 by Radau, its Jacobian's included. A Python law takes tens.
PLAIN, STRING, LAW_FACTOR, PYTHON_LAW = 0.13, 0.04, 3.0, 40.0
OVERHEAD = {Method.DOP853: 5.5, Method.RADAU: 18.0}
GROWTH = {Method.DOP853: 1 / 8, Method.RADAU: 1 / 5}  # of the work, in powers of 1 / tolerance
RK4_ORDER = 4
COARSE_ERROR = 0.02  # of the structure's extent, at which the steps of RK4 tell how fast the motion is
# Evaluations by DOP853 with rtol = 1e-5 for each step that RK4 needs for COARSE_ERROR: 4 to 30, most where strings go
# slack often.
EVALUATIONS, AT_TOLERANCE, FEWEST = 12.0, 1e-5, 100
KINK_EVALUATIONS = 25.0  # more for each decade of the tolerance where a string goes slack or taut: 22 to 50
STIFF = 2e5  # steps of an explicit method, above which an implicit one is tried
ATOL = 1e-2  # of rtol


def run_accurately(
    accuracy: float,
    request: Request,
    with_method: Callable[..., Any],
    prepared: Callable[[Any, Request], IntegratedRun],
) -> Trajectory:
    """The run of a request whose largest node error is at most `accuracy` [m], as far as it can be told.

    Args:
        accuracy: [m].
        request: the run.
        with_method: the engine's options with these: method, and timestep or rtol and atol.
        prepared: the run of options and request.

    Raises:
        TensegrityError: what the finest runs raised, where no step was fine enough.
    """
    rate = known_rate(request)
    steps = Steps.of(request, rate)
    located = can_locate(request.scene.structure)

    def fixed(step: float, adapted: Request) -> Trajectory:
        options = with_method(method=Method.RK4, timestep=step, locate_slack=located)
        return prepared(options, adapted).integrate()

    rk4 = fixed_step_way(Method.RK4.value, RK4_ORDER, 1.0, 4, steps, request, fixed, located)

    def controlled(method: Method) -> Way:
        weight = evaluation_weight(method, request)
        first = min(1e-3, max(0.3 * accuracy, LEAST_TOLERANCE))
        sampled = replace(request, output_interval=request.output_interval or min(DEFAULT_INTERVAL, request.duration))

        def first_work() -> float:
            """From what RK4 has shown of the motion, as far as it has."""
            extent = float(np.max(np.abs(request.scene.nodes0)))
            known = rk4.ladder.steps_for(COARSE_ERROR * extent, request.duration)
            evaluations = EVALUATIONS * known * (AT_TOLERANCE / first) ** GROWTH[method]
            seen = rk4.ladder.good[-1].run if rk4.ladder.good else None
            if seen is not None:
                evaluations += KINK_EVALUATIONS * math.log10(1 / first) * count_kinks(seen)
            return weight * max(FEWEST, evaluations)

        def run(rtol: float) -> Trajectory:
            return prepared(with_method(method=method, rtol=rtol, atol=ATOL * rtol), sampled).integrate()

        ladder = Ladder(
            name=method.value,
            order=0,
            first=first,
            growth=GROWTH[method],
            first_work=first_work,
            fit=lambda rtol: rtol,
            floor=round_off(request),
            least=LEAST_TOLERANCE,
        )
        return Way(ladder, weight, run, lambda rtol: {"rtol": rtol, "atol": ATOL * rtol})

    ways = [rk4, controlled(Method.DOP853)]
    if rate * request.duration > STIFF:
        ways.append(controlled(Method.RADAU))
    return find(accuracy, ways, request)


def evaluation_weight(method: Method, request: Request) -> float:
    """Work of one evaluation, in those of the compiled RK4."""
    law = request.law
    evaluation = (PLAIN + STRING * len(request.scene.structure.strings)) * (LAW_FACTOR if law.address else 1.0)
    if law.failure is not None:
        evaluation += PYTHON_LAW
    return 1.0 if method is Method.RK4 else 1 + OVERHEAD[method] / evaluation
