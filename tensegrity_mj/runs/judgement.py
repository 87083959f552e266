"""Judgements: the one place where reports of a run become a verdict, with the quantity judged and its bound."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import shortened
from tensegrity_mj.basics.units import quantity

if TYPE_CHECKING:
    from tensegrity_mj.runs.trajectory import Trajectory

GOOD, LIMITED, BAD, UNJUDGED = "good", "limited", "bad", "not judged"
# What grows with the square of time, as distances and energies under a constant force do, has 16/9 = 1.78 times in the
# last quarter of a run what it had before; what grows exponentially has more once it is 16 times what it was.
GREW = 2.0
IMMATERIAL = 1e-3  # of the largest distance from the target: what grows below it is not looked at
ROUND_OFF = 1e-9  # of the structure's size, of its stiffness
RESTS = 0.05  # of the largest speed: what is slower in the last quarter has come to rest
STILL = 1e-6  # of the structure's size: what moves by less stands still
FEWEST = 8  # samples of a run whose growth can be seen
MOST_LETTERS = 160  # of a reason within a sentence
# Warnings of the difference between the law's model and the scene, which a test of that difference expects.
OF_THE_LAW = ("the law assumes", "V leaves the decay")
UNSTABLE = "is beyond the largest stable one"  # a step, in a warning
COARSE = "is too coarse for the scene's contact"


@dataclass(frozen=True)
class Verdict:
    """A verdict: `word` is "good", "limited", "bad" or "not judged".

    Attributes:
        quantity: that was judged; empty where nothing was.
        value, bound: of it, in `unit`; it is good up to the bound.
        reason: why the word is no better.
    """

    word: str
    quantity: str = ""
    value: float | None = None
    bound: float | None = None
    unit: str = ""
    reason: str = ""

    @property
    def text(self) -> str:
        """The word, the quantity with its value and bound, and the reason, in a line."""
        parts = [f"{self.quantity} {quantity(self.value, self.unit)}"] if self.value is not None else []
        if parts and self.bound is not None:
            parts[0] += f" (allowed {quantity(self.bound, self.unit)})"
        return f"{self.word}: {'; '.join([*parts, *([self.reason] if self.reason else [])])}".rstrip(": ")


def judge(name: str, value: float, bound: float, unit: str = "", doubts: Sequence[str] = ()) -> Verdict:
    """Bad beyond the bound and for NaN, limited where there are doubts, else good."""
    reason = in_short(doubts)
    if not value <= bound:
        return Verdict(BAD, name, value, bound, unit, reason)
    return Verdict(LIMITED if doubts else GOOD, name, value, bound, unit, reason)


def unjudged(reason: str) -> Verdict:
    """Not judged, and why."""
    return Verdict(UNJUDGED, reason=reason)


def combined(words: Iterable[str]) -> str:
    """Of several: good, bad or not judged where all are; limited where they differ."""
    found = set(words)
    judged = found - {UNJUDGED}
    return UNJUDGED if not judged else LIMITED if len(found) > 1 else judged.pop()


def in_short(reasons: Sequence[str]) -> str:
    """The first, and how many others there are."""
    more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
    return shortened(reasons[0], MOST_LETTERS) + more if reasons else ""


def doubts(run: Trajectory, of_the_law: bool = True) -> list[str]:
    """Reasons to doubt a run besides its end: growth, warnings, an unstable step, limits that were reached.

    Args:
        of_the_law: whether warnings count of forces that the law does not know.
    """
    reports = run.reports
    found = growth(run)
    warned = map(str, reports.get("warnings") or ())
    found += [text for text in warned if of_the_law or not any(part in text for part in OF_THE_LAW)]
    step = reports.get("stability") or {}
    for one, words in ((step, ""), (step.get("contact") or {}, " of the scene's contact")):
        if one.get("exceeded") and not any(UNSTABLE in text for text in found):
            found.append(f"the step of {quantity(step['step'], 's')} {UNSTABLE}{words}")
        if one.get("resolved") is False:
            found.append(f"the step of {quantity(step['step'], 's')} {COARSE}")
    for name, limit in (reports.get("limits") or {}).items():
        if limit["strings"]:
            found.append(f"{name} is reached by {', '.join(limit['strings'])}")
    return list(dict.fromkeys(found))


def is_of_the_step(doubt: str) -> bool:
    """Whether a doubt is one of those that `simulate` warns of before a run, with their causes and remedies."""
    return doubt.endswith(COARSE) or UNSTABLE in doubt


def growth(run: Trajectory) -> list[str]:
    """The energy, the force densities and the distances that have grown more than `GREW` times in the last quarter."""
    if len(run.time) < FEWEST:
        return []
    found = []
    part = (run.time - run.time[0]) / (run.time[-1] - run.time[0])
    # Of coarse samples the last one before the quarter is earlier, and what grows with the square of time less there.
    most = GREW * (0.75 / max(float(part[part < 0.75].max()), 1e-3)) ** 2
    for name, unit, values, floor, since in _series(run):
        last, before = (float(np.max(part, initial=0.0)) for part in quarters(run.time, values, since))
        if last > max(most * before, floor):
            now, then = quantity(last, unit), quantity(before, unit)
            found.append(f"{name} grows: up to {now} in the last quarter of the run, {then} before")
    return found


def _series(run: Trajectory) -> Iterator[tuple[str, str, Array, float, float]]:
    """Names, units, values (T,), the least that counts, and from which part of the run on what came before counts."""
    from tensegrity_mj.runs.energy import energy_exchanged, energy_unresolved

    target, size = run.scene.target, size_of(run)
    energy = run.kinetic_energy + run.gravity_energy + run.string_energy + run.element_energy
    if target is None or len(target.times) == 1:  # to follow a path may take more and more
        floor = energy_unresolved(run) + 0.01 * float(energy_exchanged(run)[-1])
        yield "the energy since the start", "J", energy - energy[0], floor, 0.0
    stiffest = float(np.max(run.scene.structure.stiffness, initial=0.0))
    yield "the largest force density", "N/m", run.force_densities.max(axis=1, initial=0.0), ROUND_OFF * stiffest, 0.0
    if target is None:
        yield "the distance from the start", "m", _moved(run), ROUND_OFF * size, 0.0
    else:  # where it comes near first and leaves then, the start is no measure
        error = run.target_error()
        floor = max(ROUND_OFF * size, IMMATERIAL * float(np.max(error, initial=0.0)))
        yield "the distance from the target", "m", error, floor, 0.5


def quarters(time: Array, values: Array, since: float = 0.0) -> tuple[Array, Array]:
    """The values in the last quarter of the time, and those before, from a part of it on."""
    part = (time - time[0]) / (time[-1] - time[0] or 1.0)
    return values[part >= 0.75], values[(part < 0.75) & (part >= since)]


def rest(run: Trajectory) -> dict[str, float]:
    """How a run comes to rest: the fastest node [m/s] in its last quarter and ever; how far a node came, in sizes."""
    if not len(run.time):
        return {"last_speed": math.nan, "largest_speed": math.nan, "moved": math.nan}
    speed = np.linalg.norm(run.velocities, axis=-1).max(axis=1, initial=0.0)
    last, moved = quarters(run.time, speed)[0], float(_moved(run).max())
    return {
        "last_speed": float(last.max()),
        "largest_speed": float(speed.max()),
        "moved": moved / (size_of(run) or 1.0),
    }


def size_of(run: Trajectory) -> float:
    """Diagonal of the structure's box at the start [m]."""
    return float(np.linalg.norm(np.ptp(run.nodes[0], axis=0))) if len(run.time) else math.nan


def _moved(run: Trajectory) -> Array:
    """(T,) [m]: the largest distance of a node from its start."""
    return np.asarray(np.linalg.norm(run.nodes - run.nodes[:1], axis=-1).max(axis=1, initial=0.0))
