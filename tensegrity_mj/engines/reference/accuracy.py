"""DAE and ODE with an accuracy: which methods are tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from tensegrity_mj.engines.accuracy.ladder import ATOL, LEAST_TOLERANCE, Ladder
from tensegrity_mj.engines.accuracy.rates import Rates, rates_at_start
from tensegrity_mj.engines.accuracy.search import find, fixed_steps, round_off
from tensegrity_mj.engines.accuracy.steps import FEWEST_STEPS
from tensegrity_mj.engines.driving import DEFAULT_INTERVAL
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.request import Request
from tensegrity_mj.runs.trajectory import Trajectory

GROWTH = {Method.DOP853: 1 / 8, Method.RADAU: 1 / 5}  # of the cost, in powers of 1 / tolerance
RK4_ORDER, RK4_STAGES = 4, 4
FIRST_TOLERANCE = 1e-3
FEWEST = 100.0  # evaluations of any error-controlled run
PER_TURN = 2.0  # evaluations by DOP853 for each radian or time constant of the fastest motion: 12 for 6, where it ends
STIFF = 2e4  # of these, above which an implicit method is tried, which may skip what is fast
DAMPED = 500.0  # the same, where what is fast dies away
IMPLICIT = 300.0  # evaluations of its first run


def run_accurately(
    accuracy: float,
    request: Request,
    with_method: Callable[..., Any],
    made: Callable[[Any, Request], Trajectory],
) -> Trajectory:
    """The run of a request whose largest node error is at most `accuracy` [m], as far as it can be known.

    Args:
        accuracy: [m].
        request: the run.
        with_method: the engine's options with these: method, and timestep or rtol and atol.
        made: the run of options and request.

    Raises:
        TensegrityError: what the finest runs raised, where no step was fine enough.
    """
    start = rates_at_start(request)

    def fixed(step: float, adapted: Request) -> Trajectory:
        options = with_method(method=Method.RK4, timestep=step, locate_slack=True)
        return made(options, adapted)

    def longest(rates: Rates) -> float:
        return rates.resolving_step(request.duration, RK4_ORDER)

    def controlled(method: Method, first_cost: float) -> Ladder:
        interval = request.output_interval or min(DEFAULT_INTERVAL, request.duration / FEWEST_STEPS)
        sampled = replace(request, output_interval=interval)

        def run(rtol: float) -> Trajectory:
            return made(with_method(method=method, rtol=rtol, atol=ATOL * rtol), sampled)

        return Ladder(
            name=method.value,
            run=run,
            order=0,
            first=FIRST_TOLERANCE,
            growth=GROWTH[method],
            first_cost=first_cost,
            fit=lambda rtol: rtol,
            floor=round_off(request),
            least=LEAST_TOLERANCE,
        )

    fast = max(start.turn, start.decay) * request.duration
    rk4 = fixed_steps(Method.RK4.value, RK4_ORDER, RK4_STAGES, longest, start, request, fixed, located=True)
    ladders = [rk4, controlled(Method.DOP853, FEWEST + PER_TURN * fast)]
    if fast > (DAMPED if start.decay > start.turn else STIFF):
        ladders.append(controlled(Method.RADAU, IMPLICIT))
    return find(accuracy, ladders, request)
