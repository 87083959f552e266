"""What an experiment's run truly is, how well that is known, and what the cheapest adequate setting would have cost."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from tensegrity_mj.convergence import has_kinks, node_difference
from tensegrity_mj.engines.accuracy_steps import Steps, known_rate
from tensegrity_mj.engines.dae import DAE
from tensegrity_mj.engines.integration import Method
from tensegrity_mj.engines.integration_accuracy import evaluation_weight
from tensegrity_mj.engines.mujoco import Integrator, MuJoCo
from tensegrity_mj.engines.mujoco_accuracy import WEIGHT
from tensegrity_mj.engines.ode import ODE
from tensegrity_mj.engines.run import Request
from tensegrity_mj.errors import StabilityWarning, TensegrityError
from tensegrity_mj.simulation import simulate
from tensegrity_mj.studies.promise_experiments import Experiment
from tensegrity_mj.trajectory import Status, Trajectory

# As `mujoco_accuracy.WEIGHT`, of those that are not tried there.
MUJOCO_WEIGHT = WEIGHT | {Integrator.IMPLICITFAST: 1.1, Integrator.IMPLICIT: 1.15, Integrator.DISCRETE: 1.2}
DIVISIONS = [1, *(m * 2**p for p in range(30) for m in (2, 3))]  # 1, 2, 3, 4, 6, 8, 12, ...: steps a factor of √2 apart
TOLERANCES = tuple(10.0**-e for e in range(3, 14))
FINER = 8.0  # times the work of a setting: so far finer ones are run, to see that it was no luck
TIGHT, TIGHTER = (1e-12, 1e-14), (1e-13, 1e-15)  # rtol and atol of the reference, and of the one that tells its error


@dataclass(frozen=True)
class Truth:
    """The reference of one experiment.

    Attributes:
        run: of the DAE at the tightest tolerance.
        error: [m] its difference from one less tight.
        kinks: whether strings went slack or taut, or a law had the strings at its bound.
    """

    run: Trajectory
    error: float
    kinks: bool


@dataclass(frozen=True)
class Cheapest:
    """A setting of the sweep whose true error is within the request: what it is, its work, error [m] and time [s]."""

    words: str
    work: float
    error: float
    wall_time: float


class Yardsticks(NamedTuple):
    """The cheapest settings of a sweep; None where there is none.

    Attributes:
        adequate: within the request, and so is every finer setting of the same method that was run.
        lucky: within the request, whatever finer ones are: nobody could choose it without the truth.
    """

    adequate: Cheapest | None
    lucky: Cheapest | None


class Setting(NamedTuple):
    """One point of the sweep: the engine, the work of its evaluations, the least work that it can be, its samples."""

    engine: Any
    weight: float
    least: float
    interval: float


def truth_of(experiment: Experiment, like: Trajectory) -> Truth:
    """The reference, at the recorded times of a run.

    Raises:
        TensegrityError: what the DAE raises where it cannot make it.
    """
    spacing = float(like.time[1] - like.time[0])
    runs = [_simulate(experiment, DAE(rtol=rtol, atol=atol), spacing) for rtol, atol in (TIGHT, TIGHTER)]
    return Truth(runs[1], node_difference(*runs), has_kinks(runs[1]))


def cheapest_of(experiment: Experiment, request: Request, truth: Truth, most_work: float) -> Yardsticks:
    """The cheapest settings, among those that cost at most `most_work`.

    Each method is run from coarse to fine, up to `FINER` times the work of the setting in question.
    """
    spacing = float(truth.run.time[1] - truth.run.time[0])
    adequate: Cheapest | None = None
    lucky: Cheapest | None = None
    for settings in _sweeps(experiment, request, spacing):
        candidate: Cheapest | None = None
        for engine, weight, least, interval in settings:
            # Without a candidate, what costs more than the cheapest so far cannot become cheaper.
            most = adequate.work if adequate and not candidate else most_work
            most = min(most, FINER * candidate.work if candidate else most)
            if least > most:
                break
            try:
                run = _simulate(experiment, engine, interval)
            except TensegrityError:
                candidate = None
                continue
            work = weight * run.cost["evaluations"]
            if work > most:
                break
            error = node_difference(run, truth.run) if run.status is Status.COMPLETED else math.inf
            if error > experiment.accuracy:
                candidate = None
                continue
            this = Cheapest(str(engine), work, error, run.cost["wall_time"])
            candidate = candidate or this
            lucky = this if lucky is None or work < lucky.work else lucky
        if candidate and (adequate is None or candidate.work < adequate.work):
            adequate = candidate
    return Yardsticks(adequate, lucky)


def _sweeps(experiment: Experiment, request: Request, sampled_each: float) -> Iterator[Iterator[Setting]]:
    """For each method its settings from coarse to fine."""
    steps = Steps.of(request, known_rate(request))

    def fixed(make: Callable[[float], Any], weight: float, evaluations: int) -> Iterator[Setting]:
        return (
            Setting(make(steps.step(k)), weight, weight * evaluations * steps.count(k), steps.recorded_each(k))
            for k in DIVISIONS
        )

    if experiment.engine == "MuJoCo":
        for integrator in Integrator:
            stages = MuJoCo(integrator=integrator).stages
            yield fixed(partial(MuJoCo, integrator=integrator), MUJOCO_WEIGHT[integrator], stages)
        rk4 = Integrator.RK4
        yield fixed(partial(MuJoCo, locate_slack=True), MUJOCO_WEIGHT[rk4], MuJoCo(integrator=rk4).stages)
        return
    kind = DAE if experiment.engine == "DAE" else ODE
    yield fixed(lambda step: kind(method=Method.RK4, timestep=step), 1.0, 4)
    yield fixed(lambda step: kind(method=Method.RK4, timestep=step, locate_slack=True), 1.0, 4)
    for method in (Method.DOP853, Method.RADAU):
        weight = evaluation_weight(method, request)
        yield (Setting(kind(method=method, rtol=tol, atol=1e-2 * tol), weight, 0.0, sampled_each) for tol in TOLERANCES)


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
