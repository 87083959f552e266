"""One extreme run: drawn, made, and judged by another formulation at a tighter tolerance, with its own doubt."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tensegrity_mj.engines.reference.dae import DAE
from tensegrity_mj.engines.reference.method import Method
from tensegrity_mj.engines.reference.ode import ODE
from tensegrity_mj.errors import ControllerError, TensegrityError
from tensegrity_mj.runs.convergence import Estimate, estimate_error, node_difference, way_of
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.studies.extremes import naive
from tensegrity_mj.studies.extremes.kinds import Kind
from tensegrity_mj.studies.extremes.setups import COARSER, GRAIN, Attempt, Setup, attempt, draw_setup
from tensegrity_mj.studies.extremes.verdicts import (
    Judgement,
    Verdict,
    extent_of,
    has_kinks,
    is_hidden,
    judge_end,
    judge_error,
    lacks,
)

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
    """How far a run is from the reference, and how far that may be off [m]; NaN where there is none."""
    if reference is None or own.run is None:
        return math.nan, math.nan
    if reference.run is None:
        return math.inf, 0.0
    return node_difference(own.run, reference.run), reference.doubt


def _false_refusal(setup: Setup, judgement: Judgement) -> bool:
    """Whether the run was refused or stopped although a tight DAE completes it, and its step is not to blame."""
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


TIGHT, LOOSE = 1e-11, 1e-9  # rtol; the second shows how far the first may be off
STIFF_TIGHT, STIFF_LOOSE = 1e-9, 1e-8
MOST_STEPS = 20_000  # of an error-controlled method
FINE = 0.02  # h times the fastest rate, of fixed steps
MOST_FINE_STEPS = 400_000
MOST_TURNS = 3000.0  # [rad] of the fastest vibration: beyond, no method has an answer in that many steps
MANY_RODS = 50  # beyond, some rod is near a pole, and fine steps are dear


@dataclass(frozen=True, eq=False)
class Reference:
    """A run that others are held against.

    Attributes:
        run: the trajectory; it may have stopped where the law has no solution. None where the law returned nonsense,
            which no run may complete.
        doubt: how far it may be off itself [m]: twice its distance from a coarser one.
    """

    run: Trajectory | None
    doubt: float

    @property
    def completed(self) -> bool:
        """Whether it came to the end."""
        return self.run is not None and self.run.status is Status.COMPLETED


def reference_of(setup: Setup) -> Reference | None:
    """The DAE for MuJoCo and the ODE; for the DAE the ODE, or at a pole MuJoCo; None if none will do.

    MuJoCo alone has contact. There its RK4 at fine steps is the reference, which shows whether a run is too coarse, and
    not whether the law of contact is the one meant: tests/engines/test_contact.py does that.
    """
    if setup.experiment.scene.contact is not None:
        return _first(setup, _fixed("mujoco", setup))
    if not setup.engine.startswith("dae"):
        return tight_dae(setup)
    pairs = _fixed("mujoco", setup)
    if len(setup.experiment.scene.structure.rods) <= MANY_RODS:
        pairs = [*_adaptive(ODE, setup), *_fixed("ode", setup), *pairs]
    return _first(setup, pairs)


def tight_dae(setup: Setup) -> Reference | None:
    """The DAE, error-controlled, or with fine fixed steps where that gives up."""
    return _first(setup, [*_adaptive(DAE, setup), *_fixed("dae", setup)])


def _adaptive(engine: Any, setup: Setup) -> list[tuple[Any, Any]]:
    stiff = setup.pace.decay > 20 * max(setup.pace.vibration, setup.pace.spin)
    method, *tolerances = (Method.RADAU, STIFF_TIGHT, STIFF_LOOSE) if stiff else (Method.DOP853, TIGHT, LOOSE)
    tight, loose = (engine(method=method, rtol=r, atol=1e-2 * r, max_steps=MOST_STEPS) for r in tolerances)
    return [(tight, loose)]


def _fixed(family: str, setup: Setup) -> list[tuple[Any, Any]]:
    rate = setup.rate + setup.pace.decay + setup.pace.vibration
    fineness = FINE if len(setup.experiment.scene.structure.rods) <= MANY_RODS else 5 * FINE
    steps = GRAIN * math.ceil(setup.duration * rate / fineness / GRAIN)
    if steps > MOST_FINE_STEPS:
        return []
    fine = setup.duration / steps
    scene = setup.experiment.scene
    # Of steps that are not split where strings go slack, two may be wrong by nearly the same.
    located = scene.contact is None
    if family == "mujoco":
        from tensegrity_mj.engines.mujoco.engine import MuJoCo

        return [(MuJoCo(fine, locate_slack=located), MuJoCo(2 * fine, locate_slack=located))]
    make: Any = partial(DAE if family == "dae" else ODE, method=Method.RK4, locate_slack=located)
    return [(make(timestep=fine), make(timestep=2 * fine))]


def _first(setup: Setup, pairs: list[tuple[Any, Any]]) -> Reference | None:
    if setup.duration * setup.rate > MOST_TURNS:
        return None
    for tight, loose in pairs:
        best = attempt(setup, tight)
        if isinstance(best.error, ControllerError):
            return Reference(None, 0.0)
        if best.run is None or best.run.status is Status.SINGULAR:
            continue
        if best.run.status is Status.INFEASIBLE:  # fixed steps might step over the moment
            return Reference(best.run, 0.0)
        other = attempt(setup, loose)
        doubt = 2 * node_difference(best.run, other.run) if other.run is not None else math.inf
        return Reference(best.run, doubt)
    return None
