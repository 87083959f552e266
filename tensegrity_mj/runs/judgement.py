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
from tensegrity_mj.runs.energy import energy_exchanged, energy_unresolved
from tensegrity_mj.runs.trajectory import Status, Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.runs.comparison import Comparison

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
    """Judge a value: bad beyond the bound and for NaN, limited where there are doubts, else good."""
    reason = in_short(doubts)
    if not value <= bound:
        return Verdict(BAD, name, value, bound, unit, reason)
    return Verdict(LIMITED if doubts else GOOD, name, value, bound, unit, reason)


def unjudged(reason: str) -> Verdict:
    """Verdict "not judged", with its reason."""
    return Verdict(UNJUDGED, reason=reason)


def combined(words: Iterable[str]) -> str:
    """Combine several verdicts: good, bad or not judged where all are; limited where they differ."""
    found = set(words)
    judged = found - {UNJUDGED}
    return UNJUDGED if not judged else LIMITED if len(found) > 1 else judged.pop()


def in_short(reasons: Sequence[str]) -> str:
    """The first, and how many others there are."""
    more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
    return shortened(reasons[0], MOST_LETTERS) + more if reasons else ""


def doubts(run: Trajectory, of_the_law: bool = True) -> list[str]:
    """Reasons to doubt a run, apart from its end: growth, warnings, an unstable step, limits that were reached.

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
    """Return whether a doubt is one of those that `simulate` warns of before a run, with their causes and remedies."""
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
    """Measures of rest: the fastest node [m/s] in a run's last quarter and ever; how far a node came, in sizes."""
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
    """Largest distance of a node from its start (T,) [m]."""
    return np.asarray(np.linalg.norm(run.nodes - run.nodes[:1], axis=-1).max(axis=1, initial=0.0))


CLOSE = 0.01  # of the structure's size: runs nearer than that agree, and a target is met
APPROACHED = 0.05  # of the first distance to the target: what comes nearer has met it, too


def verdict(runs: Sequence[Trajectory], comparison: Comparison | None = None) -> str:
    """One sentence about a run, or about two and their comparison; empty where there is nothing to judge.

    For example: "MuJoCo and the DAE agree to 1.4 nm over 10 s (allowed 17 mm); the target is met to 4.5 mm (allowed
    44 mm)." What warned, grew, reached a limit or ended early confirms nothing, and is named.
    """
    names, parts, ended = names_of(runs), [], []
    for name, run in zip(names, runs, strict=True):
        if run.status is not Status.COMPLETED:
            ended.append(name)
            when = f" at t = {quantity(float(run.time[-1]), 's')}" if len(run.time) else ""
            parts.append(f"{name} ended early: {run.status.value}{when}")
    doubted = {name: why for name, run in zip(names, runs, strict=True) if (why := doubts(run))}
    if comparison is not None:
        sound = not (ended or doubted)
        parts.append(_agreement(names, runs, comparison, sound))
    aim = next((text for name, run in zip(names, runs, strict=True) if (text := _target(run, name not in ended))), "")
    parts += [aim] if aim else []
    if not aim and comparison is None and len(runs[0].time) and not ended:
        lasted = quantity(float(runs[0].time[-1] - runs[0].time[0]), "s")
        moved = quantity(float(energy_exchanged(runs[0])[-1]), "J")
        balanced = f"balanced to {quantity(runs[0].energy_residual, 'J')} of {moved} exchanged"
        parts.append(f"{names[0]} ran for {lasted}; its energy is {balanced}")
    parts += [f"{name} is in doubt: {in_short(why)}" for name, why in doubted.items()]
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def is_itself(first: Trajectory, second: Trajectory) -> bool:
    """Return whether two runs are one: the same object, or the same results that took the same time."""
    return first is second or (
        (first.engine, first.provenance, first.cost) == (second.engine, second.provenance, second.cost)
        and "wall_time" in first.cost
        and np.array_equal(first.time, second.time)
        and np.array_equal(first.nodes, second.nodes)
    )


def names_of(runs: Sequence[Trajectory]) -> list[str]:
    """Names of runs in a sentence: their engines' names where these differ."""
    short = [run.engine.split(" ")[0] or "the run" for run in runs]
    if len(set(short)) == len(short):
        return [name if name in ("MuJoCo", "the run") else f"the {name}" for name in short]
    long = [run.engine for run in runs]
    ordinals = ("the first run", "the second run")
    return long if len(set(long)) == len(long) else [*ordinals, *long[2:]][: len(runs)]


def _agreement(names: Sequence[str], runs: Sequence[Trajectory], comparison: Comparison, sound: bool) -> str:
    both, first = " and ".join(names[:2]), runs[0]
    if is_itself(*runs[:2]):
        return "one run is compared with itself, which shows nothing"
    error, span = comparison.max_node_error, quantity(float(comparison.time[-1] - comparison.time[0]), "s")
    if not math.isfinite(error):
        return f"{both} cannot be compared where positions are not finite"
    given = comparison.tolerance_of("node_error")
    allowed = CLOSE * size_of(first) if math.isnan(given) else given
    if not sound:
        return f"{both} are {quantity(error, 'm', 2)} apart at most over {span}, which confirms neither"
    if error == 0.0 and first.engine == runs[1].engine:
        return f"{both} are the same over {span}: the engine repeats, which does not show that it is right"
    if error == 0.0:
        return f"{both} agree exactly over {span}"
    verb = "agree to" if error <= allowed else "differ by up to"
    return f"{both} {verb} {quantity(error, 'm', 2)} over {span} (allowed {quantity(allowed, 'm', 2)})"


def _target(run: Trajectory, completed: bool) -> str:
    error = run.target_error() if run.scene.target is not None and len(run.time) else np.zeros(0)
    if not error.size or not np.isfinite(error[-1]):
        return ""
    first, last = float(error[0]), float(error[-1])
    allowed = max(CLOSE * size_of(run), APPROACHED * first)
    left, most = quantity(last, "m", 2), f"allowed {quantity(allowed, 'm', 2)}"
    if not completed:
        return f"the target is {left} away where it ended"
    if last > allowed:
        return f"the target is missed by {left} ({most}, at the start {quantity(first, 'm', 2)})"
    return f"the target is met to {left} ({most})" + (", as at the start" if first <= allowed else "")
