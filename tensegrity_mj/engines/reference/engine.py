"""Base of the engines that integrate equations of their own; with an accuracy, several methods."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, flag, number, positive, whole
from tensegrity_mj.engines.accuracy import ACCURACY, check_accuracy
from tensegrity_mj.engines.accuracy.ladder import ATOL_OF_RTOL, LEAST_TOLERANCE, Ladder
from tensegrity_mj.engines.accuracy.rates import Rates, rates_at_start
from tensegrity_mj.engines.accuracy.search import FEWEST_STEPS, find, fixed_steps, round_off
from tensegrity_mj.engines.driving import DEFAULT_INTERVAL
from tensegrity_mj.engines.reference import equations, integration
from tensegrity_mj.engines.reference.ensemble import IntegratedEnsemble, integrate
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.request import Accelerations, ReadyRun, Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.vibration.stepping import Scheme, Stepping

# Kinds of options; below the first limit double precision cannot hold what is requested.
RTOL = number("from 2.3e-14 to 1e-2", lambda x: 100 * sys.float_info.epsilon <= x <= 1e-2)
ATOL = number("> 0 and at most 1e-2", lambda x: 0 < x <= 1e-2)
# What the methods work with, in numbers of the size of the state.
DOUBLE = 8  # bytes
RK4_VECTORS = 6  # the state, four rates, a trial state
DOP853_VECTORS = 28  # 16 rates with those of the dense output, its 7 powers, the state at both ends, three of scratch
RADAU_VECTORS = 15  # three stages in three forms, state, rates, dense output
RADAU_MATRICES = 4  # the Jacobian, and two factored matrices of which one is complex


@value(error=OptionError)
class ReferenceEngine:
    """DAE and ODE: options with an `accuracy` or without, and a run that is prepared before it is integrated.

    Attributes:
        method: see `Method`.
        rtol, atol: tolerances of the error-controlled methods.
        timestep: [s], of RK4 only.
        max_steps: of the error-controlled methods, before the run is given up.
        accuracy: [m] largest node error over the run, from 1e-10 to 1e-2, in place of method, tolerances and step,
            which it chooses for each run (evidence/docs/accuracy.md).
        locate_slack: of RK4 only, whether steps are split at the instants where strings go slack or taut, so that it
            keeps its order of 4 there (evidence/docs/accuracy.md).
    """

    method: Method = field(choice(Method), default=Method.DOP853)
    rtol: float = field(RTOL, default=1e-10)
    atol: float = field(ATOL, default=1e-12)
    timestep: float | None = field(positive("s"), default=None, none="None")
    max_steps: int = field(whole(1), default=1_000_000)
    accuracy: float | None = field(ACCURACY, default=None, none="None")
    locate_slack: bool = field(flag(), default=False)

    def __attrs_post_init__(self) -> None:
        method, fixed = self.method, self.method is Method.RK4
        if fixed and self.timestep is None:
            raise refused(self, "timestep = None: Method.RK4 has a fixed one; it must be > 0 s")
        if not fixed and self.timestep is not None:
            raise refused(self, f"timestep = {self.timestep!r}: {method.name} chooses its steps; leave it out")
        if self.locate_slack and not fixed:
            raise refused(
                self,
                f"locate_slack = True with {method.name}, whose steps shorten where strings go slack; it belongs to "
                "Method.RK4: leave it out",
            )
        check_accuracy(self, ("method", "timestep", "rtol", "atol"))

    @property
    def stepping(self) -> Stepping:
        """Integrator and step, for the stability of small motions."""
        fixed = self.method is Method.RK4 and self.accuracy is None
        return Stepping(
            Scheme.RUNGE_KUTTA if fixed else None,
            float(self.timestep) if fixed and self.timestep is not None else None,
            against_all="Method.RADAU, which chooses its steps",
            by_accuracy=True,
        )

    def _described(self) -> str:
        """Text of the method with its step or tolerances, or of the accuracy that chooses them."""
        if self.accuracy is not None:
            return f"accuracy {self.accuracy:g} m"
        if self.method is Method.RK4:
            located = ", slack located" if self.locate_slack else ""
            return f"RK4, h = {self.timestep:g} s{located}"
        return f"{self.method.name}, rtol = {self.rtol:g}, atol = {self.atol:g}"

    def _bytes(self, nq: int) -> int:
        """Bytes of state, stages and matrices for nq coordinates: the same on every run."""
        size = 2 * nq + equations.WORK
        if self.method is Method.RK4:
            return DOUBLE * RK4_VECTORS * size
        if self.method is Method.DOP853:
            return DOUBLE * DOP853_VECTORS * size
        return DOUBLE * (RADAU_VECTORS * size + RADAU_MATRICES * size**2)

    def prepared(self, request: Request) -> integration.IntegratedRun:
        """A run that is ready to start: for those who want its right-hand side rather than a trajectory."""
        raise NotImplementedError

    def _node_accelerations(self, run: integration.IntegratedRun, accelerations: Array) -> Array:
        """Node accelerations (N, 3) [m/s²] of q̈ (nq,) at the run's state."""
        found: Array = run.records.node_accelerations(accelerations)
        return found

    def accelerations(self, request: Request) -> Accelerations:
        """Node accelerations of the equations that `run` integrates."""
        run = self.prepared(request)
        nq = run.records.nq

        def at(time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None) -> tuple[Array, Array]:
            run.y[:nq], run.y[nq : 2 * nq] = run.records.state(nodes, velocities)
            rates = run.rates_at(time, run.y, rest_lengths)
            return run.plant["nodes"].copy(), self._node_accelerations(run, rates[nq : 2 * nq])

        return at

    def prepare(self, request: Request) -> ReadyRun:
        """A run with its plant and equations; called by `simulate`."""
        if self.accuracy is None:
            run = self.prepared(request)
            return ReadyRun(partial(integrate, run), run.plant)
        plain: Any = partial(replace, self, accuracy=None)
        return ReadyRun(
            partial(
                run_accurately, self.accuracy, request, plain, lambda options, one: integrate(options.prepared(one))
            )
        )

    def ensemble(self, requests: Sequence[Request], threads: int) -> IntegratedEnsemble:
        """Many runs on threads, for `simulate_many`."""
        return IntegratedEnsemble(self, requests, threads)

    def run(self, request: Request) -> Trajectory:
        """Simulate."""
        return self.prepare(request).run()


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
    """Make a run whose largest node error is at most `accuracy` [m], as far as it can be known.

    Args:
        accuracy: [m].
        request: the run.
        with_method: the engine's options with these: method, and timestep or rtol and atol.
        made: the run of options and request.

    Raises:
        TensegrityError: what the finest runs raised, where no step was fine enough.
    """
    start = rates_at_start(request)
    located = request.scene.contact is None  # whose forces jump at other instants

    def fixed(step: float, adapted: Request) -> Trajectory:
        options = with_method(method=Method.RK4, timestep=step, locate_slack=located)
        return made(options, adapted)

    def longest(rates: Rates) -> float:
        return rates.resolving_step(request.duration, RK4_ORDER)

    def controlled(method: Method, first_cost: float) -> Ladder:
        interval = request.output_interval or min(DEFAULT_INTERVAL, request.duration / FEWEST_STEPS)
        sampled = replace(request, output_interval=interval)

        def run(rtol: float) -> Trajectory:
            return made(with_method(method=method, rtol=rtol, atol=ATOL_OF_RTOL * rtol), sampled)

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
    rk4 = fixed_steps(Method.RK4.value, RK4_ORDER, RK4_STAGES, longest, start, request, fixed, located)
    ladders = [rk4, controlled(Method.DOP853, FEWEST + PER_TURN * fast)]
    if fast > (DAMPED if start.decay > start.turn else STIFF):
        ladders.append(controlled(Method.RADAU, IMPLICIT))
    return find(accuracy, ladders, request)
