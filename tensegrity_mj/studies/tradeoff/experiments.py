"""The experiments of a study: open loop, closed loop, and what is held between control samples."""

from __future__ import annotations

import contextlib
import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, item_of, refused, value
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.kinds import Kind
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.dynamics.native.law import NativeLaw
from tensegrity_mj.engines.table import ENGINES, installed
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import Actuation, Mode, whole_ratio
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.convergence import way_of

PERIODS = (1e-2, 1e-3)  # s
REPEATS = 3
BUDGET = 1e6  # of right-hand sides, each weighed as in `settings.weight`: seconds a run, for any structure


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
        budget: of a run's right-hand sides, weighed by strings; see `settings.most_evaluations`.
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
        """Plain values."""
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
        """Plain values."""
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
