"""What the thesis states: a quantity, its value, where it stands, and how near ours must come."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tensegrity_mj.reproduction.experiments import OF_EQUILIBRIUM, OF_MOTION, EngineName

# What one engine computed: a Trajectory by the name of its experiment, a SeriesRun by that of its series (chapter 3), a
# BeamRun by that of its study (appendix C).
Runs = Mapping[str, Any]
Measure = Callable[[Runs], float | bool]


class ReadFrom(enum.Enum):
    """Where in the thesis a value stands."""

    TEXT = "text"
    CAPTION = "caption"
    CURVES = "curves"
    AXIS = "axis"
    TITLE = "title"


@dataclass(frozen=True)
class Interval:
    """The values that count as the thesis' own, ends included."""

    low: float = -math.inf
    high: float = math.inf

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


def near(value: float, tolerance: float) -> Interval:
    """A value and how far ours may be from it."""
    return Interval(value - tolerance, value + tolerance)


# A sentence that is true or not; its measure returns a truth value.
HOLDS = Interval(1.0, 1.0)


@dataclass(frozen=True)
class KnownDifference:
    """Why ours differs, and what ours is: a difference of another size has another cause."""

    cause: str
    ours: Interval


@dataclass(frozen=True)
class Statement:
    """One row of the ledger.

    Attributes:
        id: unique; begins with the figure or the section.
        figure: the number of the figure, or "" for a statement of the text alone.
        place: where it stands, such as "Fig. 5.4(a)" or "§5.6".
        page: of the thesis.
        says: what the thesis states, in our words.
        stated: the value as it stands there, with its unit.
        read_from: text, caption, curves, axis or title.
        accepted: which of our values count as reproduced.
        tolerance: why these.
        needs: names of the experiments that `measure` reads.
        measure: our value, in `unit`.
        known: the difference that is known and explained, or None.
        engines: that it can be judged in; () for all.
        unjudged: why it cannot be judged at all, or "".
    """

    id: str
    figure: str
    place: str
    page: int
    says: str
    stated: str
    read_from: ReadFrom
    accepted: Interval
    tolerance: str
    needs: tuple[str, ...]
    measure: Measure
    unit: str = ""
    known: KnownDifference | None = None
    engines: tuple[EngineName, ...] = ()
    unjudged: str = ""

    @property
    def chapter(self) -> str:
        """What stands before the first dot of the id: "3" to "7", or "C"."""
        return self.id.partition(".")[0]

    @property
    def columns(self) -> tuple[EngineName, ...]:
        """The engines beside which it stands, judged in them or not: those of statics for what is about statics."""
        return OF_EQUILIBRIUM if EngineName.STATICS in self.engines else OF_MOTION


# --------------------------------------------------------------------------------------- reading the thesis' axes

# A plot has a tick at every multiple of their distance within its limits. So a curve that its panel was made for ends
# below the next tick, and reaches beyond half of the last one.
FITS = "the axis ends below the next tick after its last; a panel is made so that its curve fills more than half of it"
INSIDE = "the axis ends below the next tick after its last; a curve that it shows lies within"


def fills(last_tick: float, tick: float) -> Interval:
    """A largest (or, with negative ticks, smallest) value that an axis was made for."""
    ends = sorted((0.5 * last_tick, last_tick + math.copysign(tick, last_tick)))
    return Interval(*ends)


def inside(low: float, high: float) -> Interval:
    """Between the ticks that would follow the first and the last."""
    return Interval(low, high)


def of(name: str, measure: Callable[..., float | bool], *arguments: Any) -> Measure:
    """The measure of one experiment's run: measure(run, *arguments)."""
    return lambda runs: measure(runs[name], *arguments)
