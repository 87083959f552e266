"""Statements of the thesis: a row of the tables, its class, its value, and how near ours must come."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from evidence.thesis.experiments import OF_EQUILIBRIUM, OF_MOTION, EngineName
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import Kind, Wrong, choice, many, part, rows, text, whole
from tensegrity_mj.basics.toml_values import is_list, is_number, is_table
from tensegrity_mj.errors import FormatError

# Results of one engine: a Trajectory by the name of its experiment, a SeriesRun by that of its series (chapter 3), a
# BeamRun by that of its study (chapter 7, appendix C).
Runs = Mapping[str, Any]


class Class(enum.Enum):
    """Classes of rows, by the kind of evidence.

    NUMBER: a value that stands in the thesis' text, in a caption or in a table, and that nothing here was given.
    STATEMENT: a sentence of the thesis that can be true or false.
    AXIS: a curve of ours fits the axes of the thesis' figure, whose ticks are in its text.
    INPUT: an echo of what was put in, or what is true by construction of scene, law or engine.
    CALIBRATED: a start, a seed or a parameter was chosen so that the figure or the sentence is reproduced.
    INDEPENDENT: the value comes from another coding of the same equations, and stands nowhere in the thesis.
    """

    NUMBER = "number"
    STATEMENT = "statement"
    AXIS = "axis"
    INPUT = "input"
    CALIBRATED = "calibrated"
    INDEPENDENT = "independent computation"

    @property
    def is_evidence(self) -> bool:
        """True where rows of this class count in the headline."""
        return self in (Class.NUMBER, Class.STATEMENT)


@dataclass(frozen=True)
class Interval:
    """The values that count as the thesis' own, ends included."""

    low: float = -math.inf
    high: float = math.inf

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


# A sentence that is true or not; its measure returns a truth value.
HOLDS = Interval(1.0, 1.0)
NO_CAUSE = "no cause known"


def _interval(given: Any) -> Interval:
    if isinstance(given, Interval):
        return given
    ends = given if is_list(given, is_number) and len(given) == 2 else ()
    if not ends or not ends[0] <= ends[1]:
        raise Wrong(f" = {given!r}; it must be two numbers, [low, high], the first not above the second")
    return Interval(float(ends[0]), float(ends[1]))


ENDS = Kind(_interval, "two numbers, [low, high]")
TEXTS = many(text(), "a list of texts in quotes")


@value("differs", FormatError)
class KnownDifference:
    """Range of ours where it differs, and its cause, if known: a difference of another size has another cause."""

    cause: str = field(text())
    ours: Interval = field(ENDS)

    @property
    def is_explained(self) -> bool:
        """True where a cause is known."""
        return not self.cause.startswith(NO_CAUSE)


@value("row {id!r}", FormatError)
class Statement:
    """One row of the ledger, as a table of `tables/` has it.

    Attributes:
        id: unique; begins with the figure or the section.
        kind: its class.
        figure: the number of the figure, or "" for a statement of the text alone.
        place: where it stands, such as "Fig. 5.4(a)" or "§5.6".
        page: of the thesis.
        says: what is measured.
        stated: what the thesis states, with its unit, or where a value is from that it does not state.
        accepted: which of our values count as reproduced.
        tolerance: why these.
        needs: names of the experiments, series and studies that the measure is given, in order.
        measure: name of a function of the modules of measures, or an expression, see `expression`.
        arguments: further ones that a function is given by name.
        unit: of our value.
        value: the number as it is stated, in that unit, or the ends of the range that is stated; () where none is.
        printed: the digits as they stand in the thesis, of a number.
        line: of the thesis' text where they stand, counted from 1; 0 where none is given.
        origin: what was chosen so that a calibrated row is reproduced, or where an independent value is from, or "".
        known: the difference that is known, or None.
        engines: that it can be judged in; () for all.
        unjudged: why it cannot be judged at all, or "".
    """

    id: str = field(text())
    kind: Class = field(choice(Class), key="class")
    place: str = field(text(), key="where")
    page: int = field(whole(1))
    says: str = field(text(), key="words")
    stated: str = field(text())
    figure: str = field(text(), default="")
    accepted: Interval = field(ENDS, default=None, none="None", key="band")  # never None once made
    tolerance: str = field(text(), default="", key="reason")
    needs: tuple[str, ...] = field(TEXTS, default=(), key="runs")
    measure: str = field(text(), default="")
    arguments: Mapping[str, Any] = field(Kind(dict, "a table", is_table), factory=dict)
    unit: str = field(text(), default="")
    value: tuple[float, ...] = field(rows(), default=())
    printed: tuple[str, ...] = field(TEXTS, default=())
    line: int = field(whole(0), default=0)
    origin: str = field(text(), default="")
    known: KnownDifference | None = field(part(KnownDifference), default=None, none="None", key="differs")
    engines: tuple[EngineName, ...] = field(many(choice(EngineName), "a list of engines"), default=())
    unjudged: str = field(text(), default="")

    def __attrs_post_init__(self) -> None:
        if not self.measure and not self.unjudged:
            raise refused(self, "it has neither a measure nor a reason why it cannot be judged (unjudged)")
        if self.accepted is None:
            object.__setattr__(self, "accepted", Interval() if self.unjudged else HOLDS)

    @property
    def chapter(self) -> str:
        """Chapter of the statement, before the first dot of its id: "3" to "7", or "C"."""
        return self.id.partition(".")[0]

    @property
    def columns(self) -> tuple[EngineName, ...]:
        """Engines in whose columns it stands, judged in them or not: those of statics for what is about statics."""
        return OF_EQUILIBRIUM if EngineName.STATICS in self.engines else OF_MOTION

    def is_within(self, ours: float, part: float) -> bool:
        """Return whether a value of ours is at most a part away from the number that is stated, or within its range."""
        if not self.value:
            return False
        low, high = min(self.value), max(self.value)
        return low - part * abs(low) <= ours <= high + part * abs(high)
