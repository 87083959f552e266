"""Reference solution of an experiment, its error, and the cost of the cheapest adequate setting."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from evidence.promise.experiments import Experiment
from tensegrity_mj.engines.accuracy.ladder import WEIGHTS
from tensegrity_mj.engines.accuracy.rates import rates_at_start
from tensegrity_mj.engines.accuracy.search import Steps
from tensegrity_mj.engines.mujoco.settings import Integrator, MuJoCo
from tensegrity_mj.engines.reference.dae import DAE
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.reference.ode import ODE
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import StabilityWarning, TensegrityError
from tensegrity_mj.runs.convergence import has_kinks, node_difference
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import simulate

DIVISIONS = [1, *(m * 2**p for p in range(30) for m in (2, 3))]  # 1, 2, 3, 4, 6, 8, 12, ...: steps a factor of √2 apart
TOLERANCES = tuple(10.0**-e for e in range(3, 14))
FINER = 4.0  # times the evaluations of a setting: so far finer ones are run, to see that it was no luck
RESOLVED = 0.1  # of the request: what two references may differ by
# Tolerances of DOP853, from the tightest: a jump of forces, as a damped string comes taut, can stop the tightest ones.
TIGHT = (1e-13, 1e-12, 1e-11, 1e-10)
COARSE = 4.0  # rad or time constants a step, with which sweeps begin
FINE = 0.25  # the same of RK4 as a reference, which begins with it
MOST_EVALUATIONS = 1e6  # of one reference


@dataclass(frozen=True)
class Truth:
    """The references of one experiment.

    Attributes:
        run: that which was computed by other means than the run that it judges.
        error: [m] what the two references differ by.
        kinks: whether strings went slack or taut, or a law had the strings at its bound.
    """

    run: Trajectory
    error: float
    kinks: bool


@dataclass(frozen=True)
class Cheapest:
    """A setting of the sweep whose true error is within the request: what it is, its evaluations and error [m]."""

    description: str
    evaluations: float
    error: float


def truth_of(experiment: Experiment, request: Request, like: Trajectory) -> Truth:
    """The references, at the recorded times of a run.

    One is the DAE by DOP853. The other is of the formulation that the run was not computed with, ODE or DAE, by RK4
    with split steps, which is refined until it is near enough, or too dear. A run by RK4 is judged by the first, one by
    DOP853 or Radau by the second.

    Raises:
        TensegrityError: where one of them cannot be made.
    """
    spacing = float(like.time[1] - like.time[0])
    first = _tight(experiment, spacing)
    wanted = RESOLVED * experiment.accuracy
    kinds = (DAE, ODE) if experiment.engine == "ODE" else (ODE, DAE)
    second = min(
        (run for kind in kinds if (run := _refined(kind, experiment, request, spacing, first, wanted)) is not None),
        key=lambda run: node_difference(run, first),
        default=None,
    )
    error = math.inf if second is None else node_difference(first, second)
    by_rk4 = like.reports["accuracy"]["chosen"]["method"] in [one.value for one in Integrator]
    return Truth(first if by_rk4 or second is None else second, error, has_kinks(first))


def _tight(experiment: Experiment, spacing: float) -> Trajectory:
    *tighter, last = (DAE(rtol=one, atol=0.01 * one, max_steps=round(MOST_EVALUATIONS / 12)) for one in TIGHT)
    for engine in tighter:
        with contextlib.suppress(TensegrityError):
            return _simulate(experiment, engine, spacing)
    return _simulate(experiment, last, spacing)


def _refined(
    kind: Any, experiment: Experiment, request: Request, spacing: float, other: Trajectory, wanted: float
) -> Trajectory | None:
    """RK4 with ever finer steps, until it is as near as wanted [m] to another run; the nearest, or None."""
    steps = Steps.of(replace(request, output_interval=spacing), FINE / max(_fastest(request), 1e-300))
    k, best, least = 1, None, math.inf
    while 4 * steps.count * k <= MOST_EVALUATIONS:
        engine = kind(method=Method.RK4, timestep=steps.unit / k, locate_slack=True)
        with contextlib.suppress(TensegrityError):
            run = _simulate(experiment, engine, spacing)
            if (away := node_difference(run, other)) < least:
                best, least = run, away
        if least <= wanted:
            break
        k *= 2
    return best if least <= wanted else None


def _fastest(request: Request) -> float:
    rates = rates_at_start(request)
    return max(rates.turn, rates.decay)


def cheapest_of(
    experiment: Experiment, request: Request, truth: Truth, most: float
) -> tuple[Cheapest | None, Cheapest | None]:
    """The cheapest settings of a sweep, among those that cost at most that many evaluations; None where there is none.

    Each method is run from coarse to fine, up to `FINER` times the evaluations of the setting in question.

    Returns:
        One within the request, as is every finer setting of the same method that was run; and one within the request,
        though finer ones may not be: nobody could choose it without the truth.
    """
    spacing = float(truth.run.time[1] - truth.run.time[0])
    adequate: Cheapest | None = None
    lucky: Cheapest | None = None
    for settings in _sweeps(experiment, request, spacing):
        candidate: Cheapest | None = None
        for engine, least in settings:
            # Without a candidate, what costs more than the cheapest so far cannot become cheaper.
            allowed = adequate.evaluations if adequate and not candidate else most
            allowed = min(allowed, FINER * candidate.evaluations if candidate else allowed)
            if least > allowed:
                break
            try:
                run = _simulate(experiment, engine, spacing)
            except TensegrityError:
                candidate = None
                continue
            method = getattr(engine, "method", None)
            cost = WEIGHTS.get(method.value if method else "", 1.0) * run.cost["evaluations"]
            if cost > allowed:
                break
            error = node_difference(run, truth.run) if run.status is Status.COMPLETED else math.inf
            if error > experiment.accuracy:
                candidate = None
                continue
            this = Cheapest(str(engine), cost, error)
            candidate = candidate or this
            lucky = this if lucky is None or cost < lucky.evaluations else lucky
        if candidate and (adequate is None or candidate.evaluations < adequate.evaluations):
            adequate = candidate
    return adequate, lucky


def _sweeps(experiment: Experiment, request: Request, spacing: float) -> Iterator[Iterator[tuple[Any, float]]]:
    """Yield for each method its engines from coarse to fine, each with its least possible number of evaluations."""
    steps = Steps.of(replace(request, output_interval=spacing), COARSE / max(_fastest(request), 1e-300))

    def fixed(make: Any, evaluations: int) -> Iterator[tuple[Any, float]]:
        return ((make(steps.unit / k), evaluations * steps.count * k) for k in DIVISIONS)

    if experiment.engine == "MuJoCo":
        for integrator in (Integrator.RK4, Integrator.EULER, Integrator.IMPLICITFAST, Integrator.DISCRETE):
            yield fixed(partial(MuJoCo, integrator=integrator), MuJoCo(integrator=integrator).stages)
        yield fixed(partial(MuJoCo, locate_slack=True), MuJoCo(integrator=Integrator.RK4).stages)
        return
    kind = DAE if experiment.engine == "DAE" else ODE
    for located in (True, False):
        yield fixed(lambda step, split=located: kind(method=Method.RK4, timestep=step, locate_slack=split), 4)
    for method in (Method.DOP853, Method.RADAU):
        yield ((kind(method=method, rtol=tol, atol=1e-2 * tol), 0.0) for tol in TOLERANCES)


def _simulate(experiment: Experiment, engine: Any, interval: float) -> Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # sweeps begin with steps that are too coarse
        return simulate(
            experiment.scene,
            experiment.law,
            engine,
            actuation=experiment.actuation,
            output_interval=interval,
        )
