"""The largest step at which lengths drift no more than allowed (§3.5.4)."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Unpack

from evidence.cable.cases import (
    DURATION,
    INTERVAL,
    STABLE,
    Case,
    case_of,
    drift_of,
    fastest,
    point_of,
    simulated,
)
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.engines.table import engine_of
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.runs.trajectory import Status
from tensegrity_mj.studies.many import RunOptions, run_study
from tensegrity_mj.vibration.stepping import Scheme

LARGEST = 0.1  # s, the largest step tried
RESOLUTION = 0.01  # of a step: where the search ends
SMALLEST = 1 / 32  # of the largest stable step: below it the search is given up


@dataclass(frozen=True)
class FoundStep:
    """The largest step within a drift.

    Attributes:
        elements: K.
        step: [s]; NaN where none was found down to a 32nd of the limit.
        drift: largest | ‖b_i‖ - 1 | at that step.
        limit: [s], the largest stable step of the hanging chain in RK4.
        beyond: the drift at the next larger step that was tried; NaN where that run diverged.
        runs: how many were made.
    """

    elements: int
    step: float
    drift: float
    limit: float
    beyond: float
    runs: int


def steps_within(
    cases: Sequence[Case],
    drift: float = 0.02,
    folder: str | os.PathLike[str] | None = None,
    *,
    duration: float = DURATION,
    **how: Unpack[RunOptions],
) -> list[FoundStep]:
    """The largest step of each case with which the DAE's RK4, without any treatment of drift, keeps within a drift.

    Steps are whole parts of the duration; the search narrows them down to 1 %.

    Args:
        cases: their engines do not count.
        drift: allowed, of a rod's length.
        folder: see `run_many`.
        duration: of a run [s].
        how: identity, workers, progress and label, see `run_many`.

    Raises:
        OptionError: as `run_many`.
    """
    positive("drift", drift)
    plain = engine_of("dae", 0.01)
    points = [
        {"scenes": {"scene": scene_to_toml(case.scene)}, **point_of(replace(case, engine=plain), "scene")}
        for case in cases
    ]
    study = run_study(find_step, points, folder, "steps", how, {"drift": drift, "duration": duration})
    lost = [FoundStep(len(case.scene.structure.rods), math.nan, math.nan, math.nan, math.nan, 0) for case in cases]
    return [replace(one, **outcome.get("values", {})) for one, outcome in zip(lost, study.outcomes, strict=True)]


def find_step(point: dict[str, Any]) -> dict[str, Any]:
    """The task of `steps_within`: bisection between a step that keeps within the drift and one that does not."""
    case, duration, allowed = case_of(point), point["duration"], point["drift"]
    limit = STABLE[Scheme.RUNGE_KUTTA] / fastest(case.scene)
    tried: dict[int, float] = {}

    def drift(count: int) -> float:
        if count not in tried:
            step = duration / count
            interval = step * max(1, round(INTERVAL / step))
            run = simulated(replace(case, engine=engine_of("dae monitor", step)), duration, interval)
            tried[count] = drift_of(run) if run.status is Status.COMPLETED else math.inf
        return tried[count]

    # Beyond the limit nothing holds; so the fewest steps that can do are those of the limit, or of the largest step.
    few = max(1, math.ceil(duration / min(limit, LARGEST)))
    found = FoundStep(len(case.scene.structure.rods), math.nan, math.nan, limit, math.nan, 0)
    if drift(few) > allowed:
        low, more = few, RESOLUTION
        # Most are just beyond: in motion the chain pulls harder than at rest, and its fastest oscillation is faster.
        while drift(high := math.ceil(low * (1 + more))) > allowed:
            low, more = high, 2 * more
            if low * SMALLEST > few:
                return asdict(replace(found, beyond=_known(drift(low)), runs=len(tried)))
        while high - low > max(1, RESOLUTION * low):
            middle = (low + high) // 2
            low, high = (middle, high) if drift(middle) > allowed else (low, middle)
        few, found = high, replace(found, beyond=_known(drift(low)))
    return asdict(replace(found, step=duration / few, drift=drift(few), runs=len(tried)))


def _known(drift: float) -> float:
    return drift if math.isfinite(drift) else math.nan
