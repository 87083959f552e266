"""An extreme run in full: an experiment, an engine, a step or a tolerance, and how it is called."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from evidence.extremes.experiment import Experiment
from evidence.extremes.kinds import FIXED_STEP, Kind
from evidence.extremes.pace import Pace, pace
from evidence.random_linked import log_uniform
from tensegrity_mj.engines.reports import BUCKLES, NO_LINE, NO_PUSH
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.model.actuation import Actuation, Mode
from tensegrity_mj.model.capabilities import refusal
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.simulation import simulate

ENGINES = (*FIXED_STEP, "dae dop853", "dae radau", "ode dop853")
RUNGE_KUTTA = ("rk4", "dae rk4", "ode rk4")
OUTPUTS = 40  # recorded times; everything is judged at these
SAMPLES = 40  # of a sampled law
GRAIN = 160  # steps come in multiples: with four times the step, outputs and samples still fall on steps
MOST_STEPS = 4000
PAST_STEPS = 320  # where the step itself is what is tried
# An estimate needs two coarser steps, or two looser tolerances. Errors follow a tolerance only loosely: ten times the
# tolerance is taken for twice a step of order one, which claims least.
COARSER, LOOSER = (4, 2, 1), (100.0, 10.0, 1.0)


@dataclass(frozen=True)
class Setup:
    """One run to be made and judged.

    Attributes:
        kind, experiment: what is run.
        engine: a name out of `ENGINES`.
        step: [s], of fixed-step engines.
        tolerance: rtol of the others.
        duration: [s].
        pace: of the scene at its start.
        rate: the fastest rate [1/s], that of the law included.
    """

    kind: Kind
    experiment: Experiment
    engine: str
    step: float
    tolerance: float
    duration: float
    pace: Pace
    rate: float

    @property
    def fixed(self) -> bool:
        """True where the engine makes fixed steps."""
        return self.engine in FIXED_STEP

    @property
    def order(self) -> int:
        """Order of the error in the step; of tolerances see `COARSER`."""
        return 4 if self.engine in RUNGE_KUTTA else 1

    @property
    def levels(self) -> tuple[float, ...]:
        """Steps [s] or tolerances, falling; the last is the run's own."""
        if self.fixed:
            return tuple(self.step * factor for factor in COARSER)
        return tuple(self.tolerance * factor for factor in LOOSER)

    def engine_at(self, level: float) -> Any:
        """The engine with a step or a tolerance."""
        return engine_of(self.engine, level)


def draw_setup(rng: np.random.Generator, kind: Kind) -> Setup:
    """Draw the setup of a run of a kind.

    Raises:
        TensegrityError: where the scene that was drawn is refused.
    """
    experiment = kind.draw(rng)
    wanted = experiment.engines or ENGINES
    engine = str(rng.choice([one for one in wanted if refusal(engine_of(one, 1e-6), experiment.scene) is None]))
    here = pace(experiment.scene, experiment.force_density)
    rate = here.fastest + experiment.rate
    cycles = log_uniform(rng, *experiment.cycles)
    # Oscillations are stable up to 2/ω, with RK4 2.8/ω; decays up to 2/λ and 2.8/λ: nothing here hangs on more digits.
    limit = (2.8 if engine in RUNGE_KUTTA else 2.0) / (here.vibration + here.decay + here.spin + experiment.rate or 1.0)
    small = log_uniform(rng, 0.01, 0.15) if engine in RUNGE_KUTTA else log_uniform(rng, 3e-4, 0.01)
    step = (experiment.excess or small) * limit
    if experiment.steps:
        step, steps = 1e-3 * limit, experiment.steps
    elif experiment.excess:
        steps = PAST_STEPS
    else:
        count = cycles * 2 * math.pi / rate / step
        steps = GRAIN * max(1, min(MOST_STEPS // GRAIN, round(count / GRAIN)))
    duration = steps * step if engine in FIXED_STEP else cycles * 2 * math.pi / rate
    return Setup(kind, experiment, engine, step, log_uniform(rng, 1e-9, 1e-5), duration, here, rate)


@dataclass(frozen=True, eq=False)
class Attempt:
    """Outcome of a run: a trajectory or an exception, and the warnings that came with it."""

    run: Trajectory | None
    error: BaseException | None
    warned: tuple[str, ...]


def attempt(setup: Setup, engine: Any) -> Attempt:
    """Run a setup with an engine; an error that it raises is the result."""
    experiment = setup.experiment
    interval, period = setup.duration / OUTPUTS, setup.duration / SAMPLES
    actuation = Actuation(experiment.mode, None if experiment.mode is Mode.CONTINUOUS else period)

    def run() -> Trajectory:
        return simulate(
            experiment.scene,
            None if experiment.law is None else experiment.law(setup.duration),
            engine,
            duration=setup.duration,
            actuation=actuation,
            on_infeasible=experiment.on_infeasible,
            output_interval=interval,
        )

    return caught(run)


def caught(run: Callable[[], Trajectory]) -> Attempt:
    """Call what makes a trajectory, and keep its exception and its warnings."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            found, error = run(), None
        except (Exception, SystemExit) as problem:
            found, error = None, problem
    # Words for the user, not what numpy says of an overflow on the way.
    words = [str(w.message) for w in heard if issubclass(w.category, UserWarning) or str(w.message)[:7] == "MuJoCo:"]
    if found is not None:
        warned = found.reports.get("warnings", [])
        words += [text for text in warned if not any(part in text for part in (NO_LINE, NO_PUSH, BUCKLES))]
    return Attempt(found, error, tuple(words))
