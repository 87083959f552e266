"""The verdict on a run, from what came of it, its own estimate of its error, and a reference of another formulation."""

from __future__ import annotations

import enum
import math
import re
from dataclasses import dataclass

import numpy as np

from evidence.extremes.setups import Attempt
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.errors import ControllerError, DivergenceError, TensegrityError
from tensegrity_mj.runs import convergence
from tensegrity_mj.runs.convergence import Estimate, way_of
from tensegrity_mj.runs.recorded import LAW_REPORTS, VARIABLES
from tensegrity_mj.runs.trajectory import Status, Trajectory

USEFUL = 0.05  # of the way that the nodes went: a run that bounds its error by more does not claim to be right
ROUND_OFF = 1e-11  # of the extent: a formulation's own coordinates cost this much


class Verdict(enum.Enum):
    """Verdicts on runs."""

    RIGHT = "right"  # within its own error bound
    WARNED = "warned"  # completed, and says itself that it is not to be trusted
    STOPPED = "stopped"  # on the way, with time, cause and remedy
    REFUSED = "refused"  # before the first step, with cause and remedy
    UNDETECTED = "undetected"  # wrong, and nobody said so
    UNJUDGED = "unjudged"  # no reference could be had that is accurate enough


@dataclass(frozen=True)
class Judgement:
    """A verdict and why."""

    verdict: Verdict
    cause: str = ""

    def to_dict(self) -> dict[str, str]:
        """Plain values."""
        return plain_values(self, "verdict", "cause")


# Parts that a message must have. A remedy says what to do, or what a value must be.
_TIME = re.compile(r"\bt = [-+.\de]+ s")
_VALUE = re.compile(r"\d|'[^']+'")
_REMEDY = re.compile(
    r"\b(use|reduce|tighten|loosen|choose|change|give|turn|move|run|shorten|enlarge|trade|leave|must|write|mend|correct)\b"
)


def lacks(message: str, on_the_way: bool) -> str:
    """Return what a message lacks: a time (of a run that had begun), a cause with a value, a remedy."""
    wanted = [(_VALUE, "an item or a value"), (_REMEDY, "a remedy")]
    if on_the_way:
        wanted.insert(0, (_TIME, "a time"))
    return ", ".join(name for pattern, name in wanted if not pattern.search(message))


def judge_end(attempt: Attempt, duration: float) -> Judgement | None:
    """The verdict on how a run ended; None where it completed, and its numbers are to be judged."""
    if attempt.error is not None:
        message = str(attempt.error)
        if not isinstance(attempt.error, TensegrityError):
            return Judgement(Verdict.UNDETECTED, f"a traceback: {type(attempt.error).__name__}: {message}")
        # A law that fails on the way, or at t = 0, has a time; a structure that cannot be built has none.
        on_the_way = isinstance(attempt.error, (DivergenceError, ControllerError))
        if missing := lacks(message, on_the_way):
            return Judgement(Verdict.UNDETECTED, f"the message has not {missing}: {message}")
        return Judgement(Verdict.STOPPED if on_the_way else Verdict.REFUSED, message)
    run = attempt.run
    assert run is not None
    if bad := not_finite(run):
        return Judgement(Verdict.UNDETECTED, f"{bad} holds numbers that are not finite")
    if run.status is not Status.COMPLETED:
        if missing := lacks(run.message, on_the_way=True):
            return Judgement(Verdict.UNDETECTED, f"the message has not {missing}: {run.message}")
        return Judgement(Verdict.STOPPED, run.message)
    if not len(run.time) or np.any(np.diff(run.time) <= 0) or abs(run.time[-1] - duration) > 1e-9 * duration:
        return Judgement(Verdict.UNDETECTED, "it says that it completed, and its times do not go to the end")
    return None


def judge_error(attempt: Attempt, estimate: Estimate, error: float, doubt: float) -> Judgement:
    """The verdict on a run that completed.

    Args:
        attempt: the run.
        estimate: its own, of its largest node error [m].
        error: its largest distance from the reference [m]; NaN where there is no reference.
        doubt: how far off the reference may be itself [m].
    """
    assert attempt.run is not None
    way, extent = way_of(attempt.run.nodes), extent_of(attempt.run)
    if not estimate.settled:
        return Judgement(Verdict.WARNED, f"its error estimate does not settle: {estimate.reason}")
    if estimate.value > USEFUL * way + ROUND_OFF * extent:
        return Judgement(
            Verdict.WARNED, f"its error estimate says {estimate.value:.2g} m, where the nodes moved by {way:.2g} m"
        )
    if error <= estimate.value + doubt + ROUND_OFF * extent:
        return Judgement(Verdict.RIGHT)  # a warning, as of a step beyond the limit, makes it no worse
    if attempt.warned:
        return Judgement(Verdict.WARNED, attempt.warned[0])
    if math.isnan(error):
        return Judgement(Verdict.UNJUDGED, "no reference completed")
    words = f"off by {error:.2g} m; it says {estimate.value:.2g} m"
    if doubt > 0.5 * error:
        return Judgement(Verdict.UNJUDGED, f"{words}; the reference itself may be off by {doubt:.2g} m")
    return Judgement(Verdict.UNDETECTED, words)


def is_hidden(attempt: Attempt, error: float, doubt: float) -> bool:
    """Return whether a run without an estimate of its error completed without a warning and is plainly wrong."""
    if attempt.run is None or attempt.run.status is not Status.COMPLETED or attempt.warned or math.isnan(error):
        return False
    return error - doubt > USEFUL * way_of(attempt.run.nodes) + ROUND_OFF * extent_of(attempt.run)


def has_kinks(run: Trajectory) -> bool:
    """Return whether strings went slack or taut, or something touched at a recorded time."""
    return convergence.has_kinks(run) or any(run.reports.get("contact", {}).get("touching", ()))


def not_finite(run: Trajectory) -> str:
    """The first recorded quantity that holds NaN or infinity, or ""."""
    for name in VARIABLES:
        if name not in LAW_REPORTS and not np.all(np.isfinite(getattr(run, name))):
            return name
    return ""


def extent_of(run: Trajectory) -> float:
    """Largest coordinate [m], which is what round-off is relative to."""
    return float(np.max(np.abs(run.nodes), initial=0.0))
