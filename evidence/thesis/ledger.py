"""The ledger: every statement next to our value, with a verdict computed from the row's tolerance."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evidence.thesis.experiments import TITLES, EngineName
from evidence.thesis.lookup import measured
from evidence.thesis.runs import Computed
from evidence.thesis.statement import HOLDS, Interval, Statement
from tensegrity_mj.runs.trajectory import Status


class Verdict(enum.Enum):
    """Verdicts on statements."""

    UNJUDGED = "cannot be judged"
    REPRODUCED = "reproduced"
    DIFFERS = "differs"  # as the row says
    UNEXPLAINED = "differs, not as recorded"


@dataclass(frozen=True)
class Cell:
    """Our value in one engine.

    Attributes:
        value: NaN where there is none.
        verdict: of this value alone.
        note: why there is no value, or "".
    """

    value: float
    verdict: Verdict
    note: str = ""


@dataclass(frozen=True)
class Row:
    """A statement and ours."""

    statement: Statement
    cells: Mapping[EngineName, Cell]

    @property
    def verdict(self) -> Verdict:
        """The worst of the engines'; UNJUDGED where none of them judges it."""
        order = list(Verdict)
        return max((cell.verdict for cell in self.cells.values()), key=order.index)

    @property
    def cause(self) -> str:
        """Reason for which ours differs, or cannot be judged; "" where it is reproduced."""
        if self.verdict is Verdict.REPRODUCED:
            return ""
        if self.verdict is Verdict.UNJUDGED:
            names = " and ".join(TITLES[engine] for engine in self.statement.engines)
            return self.statement.unjudged or f"it is about another engine: {names}"
        notes = dict.fromkeys(cell.note for cell in self.cells.values() if cell.note)
        if notes:
            return "; ".join(notes)
        known = self.statement.known
        return known.cause if self.verdict is Verdict.DIFFERS and known is not None else "it is not the recorded value"

    @property
    def is_within_ten_percent(self) -> bool:
        """True where ours is in every engine within 10 % of the number that is stated, or of its range."""
        values = [cell.value for cell in self.cells.values() if not math.isnan(cell.value)]
        return bool(values) and all(self.statement.is_within(value, 0.1) for value in values)


def judge(statements: Sequence[Statement], computed: Computed) -> list[Row]:
    """A row for each statement that one of the engines is a column of."""
    rows = []
    for statement in statements:
        order = statement.columns if EngineName.STATICS in statement.columns else computed.runs
        engines = [engine for engine in order if engine in computed.runs and engine in statement.columns]
        if engines:
            rows.append(Row(statement, {engine: _cell(statement, engine, computed) for engine in engines}))
    return rows


def verdict_of(statement: Statement, value: float) -> Verdict:
    """The verdict on a value: known causes explain only the difference that they were found for."""
    if value in statement.accepted:
        return Verdict.REPRODUCED
    known = statement.known
    return Verdict.DIFFERS if known is not None and value in known.ours else Verdict.UNEXPLAINED


def _cell(statement: Statement, engine: EngineName, computed: Computed) -> Cell:
    runs = computed.runs[engine]
    if statement.engines and engine not in statement.engines:
        return Cell(math.nan, Verdict.UNJUDGED)
    if statement.unjudged:
        completed = {name for name, run in runs.items() if run.status is Status.COMPLETED}
        known = bool(statement.measure) and completed.issuperset(statement.needs)
        return Cell(measured(statement, runs) if known else math.nan, Verdict.UNJUDGED)
    for name in statement.needs:
        if name not in runs:
            reason = computed.failures.get((engine, name), "it was not run")
            return Cell(math.nan, Verdict.UNEXPLAINED, f"no run '{name}' in {engine.value}: {reason}")
        if runs[name].status is not Status.COMPLETED:
            stopped = runs[name].time[-1]
            reason = f"{runs[name].status.value} at {stopped:g} s: {runs[name].message}"
            # The ODE's angles cannot hold every motion: that is known, and no difference of the physics.
            verdict = Verdict.DIFFERS if runs[name].status is Status.SINGULAR else Verdict.UNEXPLAINED
            return Cell(math.nan, verdict, f"run '{name}' in {engine.value} ended {reason}")
    value = measured(statement, runs)
    return Cell(value, verdict_of(statement, value))


# ------------------------------------------------------------------------------------------------------ as text


def value_text(statement: Statement, value: float) -> str:
    """A value with as many digits as its tolerance needs, which do not depend on the machine."""
    if math.isnan(value):
        return "–"
    if statement.accepted is HOLDS:
        return "true" if value else "false"
    known = statement.known
    within = known.ours if known is not None and value in known.ours else statement.accepted
    if within.low == 0.0 and 0.0 <= value < (least := within.high / 10.0):
        return f"< {least:.0e}".replace("e-0", "e-") if least < 1e-3 else f"< {least:.2g}"  # what rounding leaves
    if value.is_integer() and within.low == within.high:
        return str(int(value)).replace("-", "−")  # a count
    digits = max(0, -_last_digit(within, value))
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def _last_digit(within: Interval, value: float) -> int:
    """The power of ten of the last digit to show: a hundredth of the tolerance; six digits, or four if it is open."""
    width = within.high - within.low
    shown = float(f"{value:.3g}")  # 0.99999 leads where 1 does
    leading = math.floor(math.log10(abs(shown))) if shown else 0
    if not math.isfinite(width) or width == 0.0:
        return leading - 3
    return max(math.floor(math.log10(width)) - 2, leading - 5)
