"""What came out of a run, or of two that were compared, in a sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.units import quantity
from tensegrity_mj.runs.trajectory import Status, Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.runs.comparison import Comparison

CLOSE = 0.01  # of the structure's size: runs nearer than that agree, and a target is met
APPROACHED = 0.05  # of the first distance to the target: what comes nearer has met it, too


def verdict(runs: Sequence[Trajectory], comparison: Comparison | None = None) -> str:
    """One sentence about a run, or about two and their comparison; empty where there is nothing to judge.

    For example: "MuJoCo and the DAE agree to 1.4 nm over 10 s; the target is met to 4.5 mm."
    """
    names = names_of(runs)
    parts = []
    for name, run in zip(names, runs, strict=True):
        if run.status is not Status.COMPLETED:
            when = f" at t = {quantity(float(run.time[-1]), 's')}" if len(run.time) else ""
            parts.append(f"{name} ended early: {run.status.value}{when}")
    if comparison is not None:
        parts.append(_agreement(" and ".join(names[:2]), runs[0], comparison))
    aim = next((text for run in runs if (text := _target(run))), "")
    parts += [aim] if aim else []
    if not aim and comparison is None and len(runs[0].time):
        lasted = quantity(float(runs[0].time[-1] - runs[0].time[0]), "s")
        parts.append(f"{names[0]} ran for {lasted}; its energy is balanced to {quantity(runs[0].energy_residual, 'J')}")
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def names_of(runs: Sequence[Trajectory]) -> list[str]:
    """What each run is called in a sentence: its engine's name where these differ."""
    short = [run.engine.split(" ")[0] or "the run" for run in runs]
    if len(set(short)) == len(short):
        return [name if name in ("MuJoCo", "the run") else f"the {name}" for name in short]
    long = [run.engine for run in runs]
    ordinals = ("the first run", "the second run")
    return long if len(set(long)) == len(long) else [*ordinals, *long[2:]][: len(runs)]


def size_of(run: Trajectory) -> float:
    """Diagonal of the structure's box at the start [m]."""
    return float(np.linalg.norm(np.ptp(run.nodes[0], axis=0))) if len(run.time) else math.nan


def _agreement(names: str, run: Trajectory, comparison: Comparison) -> str:
    error, span = comparison.max_node_error, quantity(float(comparison.time[-1] - comparison.time[0]), "s")
    if not math.isfinite(error):
        return f"{names} cannot be compared where positions are not finite"
    if error == 0.0:
        return f"{names} agree exactly over {span}"
    verb = "agree to" if error <= CLOSE * size_of(run) else "differ by up to"
    return f"{names} {verb} {quantity(error, 'm', 2)} over {span}"


def _target(run: Trajectory) -> str:
    error = run.target_error() if run.scene.target is not None and len(run.time) else np.zeros(0)
    if not error.size or not np.isfinite(error[-1]):
        return ""
    first, last = float(error[0]), float(error[-1])
    if last <= max(CLOSE * size_of(run), APPROACHED * first):
        return f"the target is met to {quantity(last, 'm', 2)}"
    return f"the target is missed by {quantity(last, 'm', 2)} (at the start {quantity(first, 'm', 2)})"
