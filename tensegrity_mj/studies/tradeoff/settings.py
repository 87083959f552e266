"""What is swept: engines with their integrators, steps and tolerances, for one scene.

Fixed steps lie on a grid that divides the interval between recorded samples and, where a law is sampled, its period:
the interval over 1, 2, 5, 10, 20, 50, ... The finest step is the last whose run stays within a budget of right-hand
sides, weighed by strings and joints, so that what is run does not depend on how fast the machine is.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.functions import function_of
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.dynamics.native.law import NativeLaw
from tensegrity_mj.engines.table import ENGINES, engine_class, engine_settings
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import whole_ratio
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.scene import Scene

if TYPE_CHECKING:
    from tensegrity_mj.engines.mujoco.engine import MuJoCo
    from tensegrity_mj.engines.reference.dae import DAE
    from tensegrity_mj.engines.reference.ode import ODE

    AnyEngine = MuJoCo | DAE | ODE

BUDGET = 1e6  # of right-hand sides, each weighed as in `weight`: seconds a run, for whatever structure
PYTHON_LAW = 50  # strings that cost as much as a call back into Python
JOINED, CLOSED = 5, 50  # strings that cost as much as a rod that shares nodes, and as a joint that closes a loop
LEAST_STEPS = 2  # of the grid, even where the budget has none
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)  # rtol
ATOL_OF_RTOL = 1e-2  # the ratio of the engines' defaults
MOST_INTERVAL, LEAST_ROWS = 0.1, 50  # s; of the recorded samples
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


def recording_interval(duration: float) -> float:
    """Between recorded samples [s]: the largest of 0.1, 0.05, 0.02, 0.01, ... that divides the run into 50 or more.

    Where none down to a thousandth of the run divides it, its hundredth part.
    """
    for exponent in range(1, 13):
        for digit in (1.0, 0.5, 0.2):
            interval = float(f"{digit * 10.0**-exponent:.1e}")
            if interval * LEAST_ROWS > duration * (1 + 1e-9):
                continue
            if duration / interval > 1000 and interval < MOST_INTERVAL:
                return duration / 100
            if divides(duration, interval):
                return interval
    return duration / 100


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
    """What a right-hand side costs, in strings of the equations of motion."""
    structure = scene.structure
    strings = max(1.0, len(structure.strings))
    if structure.class_number > 1:
        strings += JOINED * len(structure.rods) + CLOSED * len(spanning_forest(structure).closures)
    return strings + (PYTHON_LAW if law is not None and law.failure is not None else 0)


def most_evaluations(scene: Scene, law: NativeLaw | None = None, budget: float = BUDGET) -> float:
    """Right-hand sides that a run may have within a budget."""
    return budget / weight(scene, law)


def radau_steps(scene: Scene, law: NativeLaw | None = None, budget: float = BUDGET) -> int:
    """Steps of Radau within a budget: each factors matrices of the size of the state."""
    structure = scene.structure
    size = 12 * len(structure.rods) + 6 * len(structure.lone_masses) + 24 * len(structure.moving_frames) + 3
    return int(budget / (RADAU_STAGES * weight(scene, law) + size**3 / FLOPS))


@dataclass(frozen=True, eq=False)
class SettingsSweep:
    """The settings of one engine for a scene, family by family, the coarsest first in each.

    Attributes:
        engine: a name of `engines.table.ENGINES`.
        duration: of each run [s]; the scene's by default.
        period: between control samples [s]; None where the law is not sampled.
        steps: fixed steps [s] in place of the grid's.
        tolerances: rtol in place of `TOLERANCES`; atol is a hundredth of it.
        law: whose cost is counted; None: none.
        budget: of right-hand sides of a run, weighed by strings; see `most_evaluations`.

    Raises:
        OptionError: for steps or tolerances that an engine cannot have.
    """

    scene: Scene
    engine: str
    _: KW_ONLY
    duration: float | None = None
    period: float | None = None
    steps: Sequence[float] | None = None
    tolerances: Sequence[float] | None = None
    law: NativeLaw | None = None
    budget: float = BUDGET

    def __call__(self) -> list[Setting]:
        own = {"mujoco": self._of_mujoco, "dae": self._of_reference, "ode": self._of_reference}
        return own.get(self.engine, self._of_fixed_steps)()

    @property
    def _total(self) -> float:
        return self.scene.duration if self.duration is None else self.duration

    @property
    def _most(self) -> float:
        return most_evaluations(self.scene, self.law, self.budget)

    def _at_steps(self, engine: Callable[..., AnyEngine], family: str, stages: int) -> list[Setting]:
        """A family of fixed steps, of an integrator of so many stages, the coarsest first."""
        if self.steps is not None:
            steps = sorted(self.steps, reverse=True)
        else:
            interval = recording_interval(self._total)
            steps = grid_of_steps(interval, self.period, self._most / stages, self._total)
        return [Setting(engine(timestep=step), family, quantity(step, "s", 4)) for step in steps]

    def _of_mujoco(self) -> list[Setting]:
        from tensegrity_mj.engines.mujoco.engine import MuJoCo
        from tensegrity_mj.engines.mujoco.settings import Integrator

        found = []
        for integrator in Integrator:
            usual = MuJoCo(integrator=integrator)
            found += self._at_steps(partial(MuJoCo, integrator=integrator), f"MuJoCo {usual.word}", usual.stages)
        return found

    def _of_fixed_steps(self) -> list[Setting]:
        """Of an engine of which nothing more is known than that it has a time step."""
        row = ENGINES[self.engine]
        return self._at_steps(partial(engine_class(self.engine), **row.fixed_step), row.title, 1)

    def _of_reference(self) -> list[Setting]:
        from tensegrity_mj.engines.reference.dae import DAE, Drift
        from tensegrity_mj.engines.reference.method import Method
        from tensegrity_mj.engines.reference.ode import ODE

        total, most, period = self._total, self._most, self.period
        lean = period is not None  # sampled laws: no Radau, no drift treatments, half of the tolerances
        rtols = sorted(TOLERANCES[::2] if lean else TOLERANCES, reverse=True)
        if self.tolerances is not None:
            rtols = sorted(self.tolerances, reverse=True)
        engine: type[DAE] | type[ODE] = DAE if self.engine == "dae" else ODE
        found: list[Setting] = []
        for method, drift in itertools.product(Method, Drift if engine is DAE else [None]):
            usual = Drift.NORMALIZE if method is Method.RK4 else Drift.MONITOR  # the DAE's default
            treated, radau = drift not in (None, usual), method is Method.RADAU
            if treated + radau + lean > 1:
                continue
            own: dict[str, Any] = {} if drift is None else {"drift": drift}
            name = f"{ENGINES[self.engine].title} {'Radau' if radau else method.name}"
            if treated and drift is not None:
                name += f", {'Baumgarte' if drift is Drift.BAUMGARTE else drift.value}"
            if method is Method.RK4:
                found += self._at_steps(partial(engine, method=method, **own), name, 4)
                continue
            limit = radau_steps(self.scene, self.law, self.budget) if radau else int(most / DOP853_STAGES)
            restarts = 0.0 if period is None else total / period * RESTART
            if limit < (LEAST_RADAU if radau else 1) or restarts > HELD * most:
                continue
            own |= {"method": method, "max_steps": limit if period is None else HELD * limit}
            found += [
                Setting(engine(rtol=rtol, atol=ATOL_OF_RTOL * rtol, **own), name, f"rtol {power_text(rtol)}")
                for rtol in (rtols[::2] if treated else rtols)
            ]
        return found


sweep_settings = function_of(SettingsSweep)


def power_text(value: float) -> str:
    """A tolerance for people: 1e-9."""
    digits, exponent = f"{value:.2e}".split("e")
    return f"{float(digits):g}e{int(exponent)}"


def _parts() -> Iterator[int]:
    for power in itertools.count():
        for digit in (1, 2, 5):
            yield digit * 10**power


def divides(time: float, step: float) -> bool:
    """Whether a time is a whole number of steps."""
    with contextlib.suppress(OptionError):
        return whole_ratio(time, step, "time over the step") > 0
    return False
