"""Task of the study: draw one extreme run from its seed, make it, and judge it."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from evidence.extremes import naive
from evidence.extremes.kinds import Kind
from evidence.extremes.references import Reference, reference_of, tight_dae
from evidence.extremes.setups import COARSER, Attempt, Setup, attempt, draw_setup
from evidence.extremes.verdicts import (
    Judgement,
    Verdict,
    extent_of,
    has_kinks,
    is_hidden,
    judge_end,
    judge_error,
    lacks,
)
from tensegrity_mj.errors import TensegrityError
from tensegrity_mj.runs.convergence import Estimate, estimate_error, node_difference, way_of
from tensegrity_mj.runs.trajectory import Status

CLEARLY_WITHIN = 0.9  # of the stability limit at the start: a step beyond it may be stopped
CLOSE = 1e-3  # of the way: where the coarsest run is off by more, two differences may show any order by chance
FINER = 64  # a run that completes with so many times smaller a step was stopped for its step, and rightly so


def run_extreme(point: dict[str, Any]) -> dict[str, Any]:
    """The task of the study.

    Args:
        point: `kind`, `number` of the run, `seed` of the study, `autoreset` (see `naive`).
    """
    kind = Kind[point["kind"]]
    rng = np.random.default_rng([point["seed"], point["number"]])
    values: dict[str, Any] = {"kind": kind.name, "engine": "none", "facts": {}}
    try:
        setup = draw_setup(rng, kind)
    except TensegrityError as problem:  # before there is an engine
        missing = lacks(str(problem), on_the_way=False)
        return values | Judgement(Verdict.UNDETECTED if missing else Verdict.REFUSED, str(problem)).to_dict()
    values |= {
        "engine": setup.engine,
        "step": setup.step if setup.fixed else None,
        "tolerance": None if setup.fixed else setup.tolerance,
        "duration": setup.duration,
        "facts": setup.experiment.facts,
    }
    by_hand = point["autoreset"] and naive.applies(setup)
    own = (naive.attempt if by_hand else attempt)(setup, setup.engine_at(setup.levels[-1]))
    early = judge_end(own, setup.duration)
    if early is not None:
        return values | early.to_dict() | {"false refusal": _false_refusal(setup, early)}
    assert own.run is not None
    # A script of one's own has no estimate: it is held to the part of the way that any run may be off.
    estimate = naive.claim(own.run) if by_hand else _estimate(setup, own)
    reference = reference_of(setup)
    error, doubt = _distance(own, reference)
    judgement = judge_error(own, estimate, error, doubt)
    return {
        **values,
        **judgement.to_dict(),
        "bound": estimate.value,
        "error": error,
        "doubt": doubt,
        "settled": estimate.settled,
        "said by the estimate alone": judgement.verdict is Verdict.WARNED and not own.warned,
        "hidden without the estimate": is_hidden(own, error, doubt),
    }


def _estimate(setup: Setup, own: Attempt) -> Estimate:
    """The run's own estimate of its error, from two coarser runs."""
    assert own.run is not None
    coarser = [attempt(setup, setup.engine_at(level)) for level in setup.levels[:-1]]
    if any(one.run is None for one in coarser[1:]):
        why = next(str(one.error) for one in coarser[1:] if one.run is None)
        return Estimate(math.inf, False, f"a run of twice the step or ten times the tolerance fails: {why}")
    known = [(one.run, factor) for one, factor in zip(coarser, COARSER, strict=False) if one.run is not None]
    series, factors = [*(run for run, _ in known), own.run], [*(factor for _, factor in known), COARSER[-1]]
    gaps = [node_difference(one, other) for one, other in itertools.pairwise(series)]
    regular = setup.fixed and not has_kinks(own.run) and gaps[0] <= CLOSE * way_of(own.run.nodes)
    if regular:
        return estimate_error(series, factors, setup.order)
    # Where strings go slack or taut, where tolerances steer, and where the coarsest run is far off, differences fall
    # irregularly, and the last may be small by chance: no order above 1 is believed, nor less than the two together
    # say. Three tolerances may even take the very same few steps: no run claims more than its tolerance.
    found = estimate_error(series, factors, 1)
    together = 2 * math.exp(sum(math.log(gap or 1e-300) for gap in gaps) / len(gaps))
    least = 0.0 if setup.fixed else setup.tolerance * extent_of(own.run)
    return replace(found, value=max(found.value, together) + least)


def _distance(own: Attempt, reference: Reference | None) -> tuple[float, float]:
    """Return the distance of a run from the reference, and how far that may be off [m]; NaN where there is none."""
    if reference is None or own.run is None:
        return math.nan, math.nan
    if reference.run is None:
        return math.inf, 0.0
    return node_difference(own.run, reference.run), reference.doubt


def _false_refusal(setup: Setup, judgement: Judgement) -> bool:
    """Return whether the run was refused or stopped although a tight DAE completes it, and its step is not to blame."""
    if judgement.verdict not in (Verdict.REFUSED, Verdict.STOPPED):
        return False
    if setup.fixed and setup.experiment.excess is not None and setup.experiment.excess > CLEARLY_WITHIN:
        return False
    tight = tight_dae(setup)
    if tight is None or not tight.completed:
        return False
    if not setup.fixed:
        return True
    finer = attempt(setup, setup.engine_at(setup.step / FINER))
    return finer.run is None or finer.run.status is not Status.COMPLETED
