"""What came out of a run, or of two that were compared, in a sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.units import quantity
from tensegrity_mj.runs.energy import energy_exchanged
from tensegrity_mj.runs.judgement import doubts, in_short, size_of
from tensegrity_mj.runs.trajectory import Status, Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.runs.comparison import Comparison

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
    if not aim and comparison is None and len(runs[0].time):
        lasted = quantity(float(runs[0].time[-1] - runs[0].time[0]), "s")
        moved = quantity(float(energy_exchanged(runs[0])[-1]), "J")
        balanced = f"balanced to {quantity(runs[0].energy_residual, 'J')} of {moved} exchanged"
        parts.append(f"{names[0]} ran for {lasted}; its energy is {balanced}")
    parts += [f"{name} is in doubt: {in_short(why)}" for name, why in doubted.items()]
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def is_itself(first: Trajectory, second: Trajectory) -> bool:
    """Whether two runs are one: the same object, or the same results that took the same time."""
    return first is second or (
        (first.engine, first.provenance, first.cost) == (second.engine, second.provenance, second.cost)
        and "wall_time" in first.cost
        and np.array_equal(first.time, second.time)
        and np.array_equal(first.nodes, second.nodes)
    )


def names_of(runs: Sequence[Trajectory]) -> list[str]:
    """What each run is called in a sentence: its engine's name where these differ."""
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
    allowed = CLOSE * size_of(first)
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
