"""Settings that are swept: engines with their integrators, steps and tolerances, for one scene.

Fixed steps lie on a grid that divides the interval between recorded samples and, where a law is sampled, its period:
the interval over 1, 2, 5, 10, 20, 50, ... The finest step is the last whose run stays within a budget of right-hand
sides, weighed by strings and joints, so that what is run does not depend on how fast the machine is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.units import quantity
from tensegrity_mj.dynamics.native.law import NativeLaw
from tensegrity_mj.engines.table import ENGINES, engine_class, engine_settings
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.tradeoff.experiments import Experiment, TradeoffOptions, divides

if TYPE_CHECKING:
    from tensegrity_mj.engines.mujoco.settings import MuJoCo
    from tensegrity_mj.engines.reference.dae import DAE
    from tensegrity_mj.engines.reference.ode import ODE

    AnyEngine = MuJoCo | DAE | ODE

PYTHON_LAW = 50  # strings that cost as much as a call back into Python
JOINED, CLOSED = 5, 50  # strings that cost as much as a rod that shares nodes, and as a joint that closes a loop
LEAST_STEPS = 2  # of the grid, even where the budget has none
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)  # rtol
ATOL_OF_RTOL = 1e-2  # the ratio of the engines' defaults
DOP853_STAGES, RADAU_STAGES = 12, 10  # right-hand sides a step, at least
FLOPS = 100  # of linear algebra that cost as much as a string in a right-hand side
LEAST_RADAU = 50  # steps; where the budget has fewer, Radau is left out
RESTART = 13  # right-hand sides that DOP853 needs for a stretch between two control samples
HELD = 2  # times the budget where the law is sampled, which then costs nothing at most right-hand sides


@dataclass(frozen=True)
class Setting:
    """One engine with all its options.

    Attributes:
        engine: the options.
        family: what it shares with its neighbours on a curve: engine, integrator or method, drift treatment.
        knob: what moves along the curve: the step or the tolerance.
    """

    engine: AnyEngine
    family: str
    knob: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values: the engine's name and its options."""
        name, options = engine_settings(self.engine)
        return {"family": self.family, "knob": self.knob, "engine": name, "options": options}


def grid_of_steps(interval: float, period: float | None, most_steps: float, duration: float) -> list[float]:
    """Steps [s] of the grid, the coarsest first: they divide the interval and the period.

    At most so many a run, but `LEAST_STEPS` different ones if they exist among the first hundred parts.
    """
    steps: list[float] = []
    for parts in _parts():
        step = interval / parts
        beyond = duration / step > most_steps * (1 + 1e-9)
        if beyond and (len(steps) >= LEAST_STEPS or parts > 100):
            return steps
        if period is None or divides(period, step):
            steps.append(step)
    raise AssertionError("the parts never end")


def weight(scene: Scene, law: NativeLaw | None = None) -> float:
    """Return the cost of a right-hand side, in strings of the equations of motion."""
    structure = scene.structure
    strings = max(1.0, len(structure.strings))
    if structure.class_number > 1:
        strings += JOINED * len(structure.rods) + CLOSED * len(spanning_forest(structure).closures)
    return strings + (PYTHON_LAW if law is not None and law.failure is not None else 0)


def most_evaluations(scene: Scene, law: NativeLaw | None, budget: float) -> float:
    """Right-hand sides that a run may have within a budget."""
    return budget / weight(scene, law)


def radau_steps(scene: Scene, law: NativeLaw | None, budget: float) -> int:
    """Steps of Radau within a budget: each factors matrices of the size of the state."""
    structure = scene.structure
    size = 12 * len(structure.rods) + 6 * len(structure.lone_masses) + 24 * len(structure.moving_frames) + 3
    return int(budget / (RADAU_STAGES * weight(scene, law) + size**3 / FLOPS))


def settings_of(experiment: Experiment, options: TradeoffOptions) -> list[Setting]:
    """The settings that an experiment is swept with, engine by engine, family by family, the coarsest first in each.

    Raises:
        OptionError: for steps or tolerances that an engine cannot have.
    """
    own = {"mujoco": _of_mujoco, "dae": _of_reference, "ode": _of_reference}
    found = (own.get(engine, _of_fixed_steps)(engine, experiment, options) for engine in options.engines)
    return [setting for some in found for setting in some if options.wants(setting.family)]


def _at_steps(
    engine: Callable[..., AnyEngine], family: str, stages: int, experiment: Experiment, options: TradeoffOptions
) -> list[Setting]:
    """A family of fixed steps, of an integrator of so many stages, the coarsest first."""
    steps: Sequence[float] | None = options.steps
    if steps is None:
        most = most_evaluations(experiment.scene, experiment.native, options.budget) / stages
        steps = grid_of_steps(experiment.interval, experiment.actuation.period, most, experiment.duration)
    return [Setting(engine(timestep=step), family, quantity(step, "s", 4)) for step in steps]


def _of_mujoco(_: str, experiment: Experiment, options: TradeoffOptions) -> Iterator[Setting]:
    from tensegrity_mj.engines.mujoco.settings import Integrator, MuJoCo

    for integrator in Integrator:
        usual, engine = MuJoCo(integrator=integrator), partial(MuJoCo, integrator=integrator)
        yield from _at_steps(engine, f"MuJoCo {usual.word}", usual.stages, experiment, options)


def _of_fixed_steps(name: str, experiment: Experiment, options: TradeoffOptions) -> list[Setting]:
    """Make the settings of an engine of which nothing is known except that it has a time step."""
    row = ENGINES[name]
    return _at_steps(partial(engine_class(name), **row.fixed_step), row.title, 1, experiment, options)


def _of_reference(name: str, experiment: Experiment, options: TradeoffOptions) -> Iterator[Setting]:
    from tensegrity_mj.engines.reference.dae import DAE, Drift
    from tensegrity_mj.engines.reference.method import Method
    from tensegrity_mj.engines.reference.ode import ODE

    scene, period, native = experiment.scene, experiment.actuation.period, experiment.native
    most = most_evaluations(scene, native, options.budget)
    lean = period is not None  # sampled laws: no Radau, no drift treatments, half of the tolerances
    rtols = (TOLERANCES[::2] if lean else TOLERANCES) if options.tolerances is None else options.tolerances
    engine: type[DAE] | type[ODE] = DAE if name == "dae" else ODE
    for method, drift in itertools.product(Method, Drift if engine is DAE else [None]):
        usual = Drift.NORMALIZE if method is Method.RK4 else Drift.MONITOR  # the DAE's default
        treated, radau = drift not in (None, usual), method is Method.RADAU
        if treated + radau + lean > 1:
            continue
        own: dict[str, Any] = {} if drift is None else {"drift": drift}
        family = f"{ENGINES[name].title} {'Radau' if radau else method.name}"
        if treated and drift is not None:
            family += f", {'Baumgarte' if drift is Drift.BAUMGARTE else drift.value}"
        if method is Method.RK4:
            yield from _at_steps(partial(engine, method=method, **own), family, 4, experiment, options)
            continue
        limit = radau_steps(scene, native, options.budget) if radau else int(most / DOP853_STAGES)
        restarts = 0.0 if period is None else experiment.duration / period * RESTART
        if limit < (LEAST_RADAU if radau else 1) or restarts > HELD * most:
            continue
        own |= {"method": method, "max_steps": limit if period is None else HELD * limit}
        for rtol in rtols[::2] if treated else rtols:
            made = engine(rtol=rtol, atol=ATOL_OF_RTOL * rtol, **own)
            yield Setting(made, family, f"rtol {power_text(rtol)}")


def power_text(value: float) -> str:
    """Return a tolerance as text: 1e-9."""
    digits, exponent = f"{value:.2e}".split("e")
    return f"{float(digits):g}e{int(exponent)}"


def _parts() -> Iterator[int]:
    for power in itertools.count():
        for digit in (1, 2, 5):
            yield digit * 10**power
