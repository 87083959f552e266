"""The experiments of a study, open loop and closed loop, and the engines that each is swept with.

Fixed steps lie on a grid that divides the interval between recorded samples and, where a law is sampled, its period:
the interval over 1, 2, 5, 10, 20, 50, ... The finest step is the last whose run stays within a budget of right-hand
sides, weighed by strings and joints, so that what is run does not depend on how fast the machine is.
"""

from __future__ import annotations

import contextlib
import enum
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, item_of, refused, value
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.kinds import Kind
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.dynamics.native.law import NativeLaw
from tensegrity_mj.engines.table import ENGINES, engine_class, engine_settings, installed
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import Actuation, Mode, whole_ratio
from tensegrity_mj.model.forest import spanning_forest
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.convergence import way_of

PERIODS = (1e-2, 1e-3)  # s
REPEATS = 3
BUDGET = 1e6  # of right-hand sides, each weighed as in `weight`: seconds a run, for any structure


class Loop(enum.Enum):
    """Loops that are run: with the law or without."""

    OPEN = "open"
    CLOSED = "closed"


def _some(known: Iterable[Any], one: Kind) -> Kind:
    """Make the kind of a field that names at least one known item, in the order of `known`."""

    def plain(value: Any) -> tuple[Any, ...]:
        given = kinds.tuple_of(one.plain, value)
        if not given or not all(item in known for item in given):
            raise kinds.Wrong(f" = {value!r}; name at least one of {', '.join(map(str, known))}")
        return tuple(item for item in known if item in given)

    return Kind(plain)


def _falling(unit: str = "") -> Kind:
    """Numbers > 0, the largest first."""
    numbers = kinds.many(kinds.positive(unit), "numbers")
    return numbers._replace(plain=lambda value: tuple(sorted(set(numbers.plain(value)), reverse=True)))


@value("tradeoff", OptionError)
class TradeoffOptions:
    """Options of a study of cost: loops, engines, steps and tolerances that are swept.

    Attributes:
        loops: open, closed or both.
        engines: names of `engines.table.ENGINES`; all that come with the package by default.
        actuations: of the closed loop.
        periods: between control samples [s], of the held actuations.
        families: words such as "RK4" or "DAE DOP853", of which a setting's family must contain one; none: all.
        steps: fixed steps [s] in place of the grid's.
        tolerances: rtol in place of the usual ones; atol is a hundredth of it.
        duration: of each run [s]; the scene's by default.
        repeats: how often each point is timed; those that take long are timed less often, once at least.
        budget: of a run's right-hand sides, weighed by strings; see `most_evaluations`.
    """

    loops: tuple[Loop, ...] = field(_some(Loop, kinds.choice(Loop)), default=tuple(Loop))
    engines: tuple[str, ...] = field(_some(ENGINES, kinds.text()), factory=installed)
    actuations: tuple[Mode, ...] = field(_some(Mode, kinds.choice(Mode)), default=tuple(Mode))
    periods: tuple[float, ...] = field(_falling("s"), default=PERIODS)
    families: tuple[str, ...] = field(kinds.many(kinds.printable_name("a text such as 'RK4'"), "texts"), default=())
    steps: tuple[float, ...] | None = field(_falling("s"), default=None, none="None for the grid's")
    tolerances: tuple[float, ...] | None = field(_falling(), default=None, none="None for the usual ones")
    duration: float | None = field(kinds.positive("s"), default=None, none="None for the scene's")
    repeats: int = field(kinds.whole(1), default=REPEATS)
    budget: float = field(kinds.positive(), default=BUDGET)

    def __attrs_post_init__(self) -> None:
        if not self.periods and any(mode is not Mode.CONTINUOUS for mode in self.actuations):
            object.__setattr__(self, "actuations", (Mode.CONTINUOUS,))
        if not all(word.strip() for word in self.families):
            raise refused(self, f"families = {self.families!r}; each must be a text such as 'RK4'")

    def wants(self, family: str) -> bool:
        """Return whether a family is swept."""
        words = family.casefold()
        return not self.families or any(word.casefold() in words for word in self.families)

    def to_dict(self) -> dict[str, Any]:
        return plain_values(self, *item_of(type(self)).keys)


MOST_INTERVAL, LEAST_ROWS = 0.1, 50  # s; of the recorded samples
STILL = 1e-6  # of the structure's extent: a motion below it is none
WORDS = {Mode.HOLD_FORCE_DENSITY: "force density held", Mode.HOLD_REST_LENGTH: "rest length held"}


@dataclass(frozen=True)
class Experiment:
    """One motion that settings are compared on.

    Attributes:
        scene: what is simulated.
        law: the law, or None.
        native: the same as a C function, for what it costs.
        actuation: between evaluations of the law.
        duration: [s].
        note: what a reader must know about it.
    """

    scene: Scene
    law: Any
    native: NativeLaw | None
    actuation: Actuation
    duration: float
    note: str = ""

    @property
    def loop(self) -> Loop:
        """Loop of the experiment: with the law or without."""
        return Loop.OPEN if self.law is None else Loop.CLOSED

    @property
    def key(self) -> str:
        """A short name without spaces."""
        if self.law is None:
            return "open"
        mode = self.actuation.mode.value.replace(" ", "-")
        return mode if self.actuation.period is None else f"{mode}-{self.actuation.period:g}"

    @property
    def title(self) -> str:
        """Name of the experiment, as text."""
        if self.law is None:
            return "open loop"
        if self.actuation.period is None:
            return "closed loop, law at every stage"
        return f"closed loop, {WORDS[self.actuation.mode]} for {quantity(self.actuation.period, 's', 4)}"

    @property
    def interval(self) -> float:
        """Interval between recorded samples [s]."""
        return recording_interval(self.duration)

    def to_dict(self) -> dict[str, Any]:
        own = plain_values(self, "key", "title", "loop")
        how = {"actuation": self.actuation.mode.value, "period": self.actuation.period}
        return {**own, **how, **plain_values(self, "duration", "interval", "note")}


def recording_interval(duration: float) -> float:
    """Return the interval between samples [s]: the largest of 0.1, 0.05, 0.02, ... that divides the run into >= 50.

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


def divides(time: float, step: float) -> bool:
    """Return whether a time is a whole number of steps."""
    with contextlib.suppress(OptionError):
        return whole_ratio(time, step, "time over the step") > 0
    return False


def closed_loops(scene: Scene, law: Any, native: NativeLaw, options: TradeoffOptions) -> list[Experiment]:
    """The closed-loop experiments that are requested, the continuous one first."""
    total = scene.duration if options.duration is None else options.duration
    actuations = []
    for mode in options.actuations:
        if mode is Mode.CONTINUOUS:
            actuations.append(Actuation.continuous())
        else:
            actuations += [Actuation(mode, period) for period in options.periods]
    return [Experiment(scene, law, native, actuation, total) for actuation in actuations]


def open_loop(scene: Scene, options: TradeoffOptions, start: Mapping[str, Any] | None) -> Experiment:
    """The experiment without a law: from the scene's start, or from nodes and velocities that a run had at a time."""
    total = scene.duration if options.duration is None else options.duration
    if start is None:
        return Experiment(scene, None, None, Actuation.continuous(), total)
    note = (
        "Without a law nothing moves from the scene's own start. This run begins where the closed loop has the most "
        f"kinetic energy, at {start['time']:g} s, and from there on rest lengths are the structure's own."
    )
    moved = scene.with_(initial_nodes=start["nodes"], initial_velocities=start["velocities"])
    return Experiment(moved, None, None, Actuation.continuous(), total, note)


def stays(nodes: Array) -> bool:
    """Return whether nothing moves that could be measured, of nodes (T, N, 3) [m]."""
    extent = np.linalg.norm(np.ptp(nodes[0], axis=0))  # the diagonal of their box at first
    return not way_of(nodes) > STILL * extent


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

    engine: Any
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
    for parts in (digit * 10**power for power in itertools.count() for digit in (1, 2, 5)):
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
    engine: Callable[..., Any], family: str, stages: int, experiment: Experiment, options: TradeoffOptions
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
    engine: Any = DAE if name == "dae" else ODE
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
