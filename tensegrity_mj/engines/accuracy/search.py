"""A run with an accuracy instead of a step: which integrator, which step or tolerance, and how wrong the result is.

Several methods are tried side by side, each from coarse to fine (`ladder`). The next run is always that of the
method which will have cost least with it, counted in evaluations of the forces and never in measured time, so that the
same request gives the same run on every machine. Nothing but the end of this sequence depends on the accuracy: a looser
request makes a part of the runs of a tighter one. The finest run is returned; its error is estimated from its
difference to coarser runs of the same method over the whole time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tensegrity_mj.engines.accuracy.ladder import FIRST_STEP, HALF, STRIKES, Ladder, Rung
from tensegrity_mj.engines.accuracy.rates import Rates, rates_along
from tensegrity_mj.engines.accuracy.steps import Steps
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import ControllerError, DivergenceError, OptionError, TensegrityError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.convergence import ROUND_OFF
from tensegrity_mj.runs.trajectory import Status, Trajectory

LEAST_STEP = 1e-9  # of the duration
PARTS = 8  # of a first step, in which another is taken: its error is 8⁻⁴ of that of the whole
ROOM = 0.75  # of the coarsest step that the start allows: rates change along a run
MOST_EVALUATIONS = 4e7  # minutes, where one takes some microseconds


@dataclass(frozen=True)
class Way:
    """A method to compute the run with: its ladder, and how a run is made.

    Attributes:
        ladder: see there.
        run: from a request and a setting to a run.
        words: of a setting, for reports.
    """

    ladder: Ladder
    run: Callable[[float], Trajectory]
    words: Callable[[float], dict[str, Any]]


def fixed_step_way(
    name: str,
    order: int,
    evaluations: int,
    resolving: Callable[[Rates], float],
    start: Rates,
    request: Request,
    make: Callable[[float, Request], Trajectory],
    located: bool = False,
) -> Way:
    """A method of fixed steps.

    Args:
        name, order: of the method.
        evaluations: a step.
        resolving: the longest step [s] that resolves motions of such rates.
        start: the rates at the start.
        request: of the run.
        make: the run with a step [s].
        located: whether steps are split where strings go slack or taut.
    """
    steps = Steps.of(request, ROOM * HALF * resolving(start))

    def run(step: float) -> Trajectory:
        k = steps.divisions(step)
        made = make(steps.step(k), replace(request, output_interval=steps.recorded_each(k)))
        return _with_first_step(made, steps.step(k), request, make) if located else made

    ladder = Ladder(
        name=name,
        order=order,
        first=steps.unit,
        growth=1.0,
        first_cost=evaluations * steps.count(1),
        fit=lambda step: steps.step(steps.divisions(step)),
        floor=round_off(request),
        least=LEAST_STEP * request.duration,
        resolving=lambda run: resolving(rates_along(run, request)),
        located=located,
    )
    split = {"locate_slack": True} if located else {}
    return Way(ladder, run, lambda step: {"timestep": steps.step(steps.divisions(step)), **split})


def _with_first_step(run: Trajectory, step: float, request: Request, make: Callable[..., Trajectory]) -> Trajectory:
    """The run with what its first step is wrong by, where a string goes slack or taut before its second sample.

    Such a step ends at that instant. A run of half the step takes the very same part first where the instant is within
    its first step, too, and both are wrong alike, by what no difference of them shows. So it is taken in `PARTS` as
    well. What is wrong after it, ε in nodes and ε' in their velocities, is taken for ε + ε' T at the end.
    """
    if len(run.time) < 2 or not np.any((run.tensions[0] != 0) != (run.tensions[1] != 0)):
        return run
    short = replace(request, duration=step, output_interval=step, progress=False)
    try:
        whole, parts = make(step, short), make(step / PARTS, short)
    except TensegrityError:
        return run
    if whole.status is not Status.COMPLETED or parts.status is not Status.COMPLETED:
        return run
    moved, moving = (
        float(np.max(np.linalg.norm(a[-1] - b[-1], axis=-1)))
        for a, b in ((whole.nodes, parts.nodes), (whole.velocities, parts.velocities))
    )
    run.reports[FIRST_STEP] = moved + moving * (request.duration - step)
    cost = {
        name: run.cost[name] + whole.cost[name] + parts.cost[name] for name in ("wall_time", "steps", "evaluations")
    }
    return replace(run, cost=run.cost | cost)


def can_locate(structure: Structure) -> bool:
    """Whether `locate_slack` leaves RK4 its order wherever strings go slack or taut.

    A damper that may push stops at once where its string goes slack, and no stage of a step may look beyond.
    """
    return not bool(np.any((structure.damping > 0) & ~structure.clipped))


def round_off(request: Request) -> float:
    """[m], below which differences of runs are taken for round-off."""
    return ROUND_OFF * float(np.max(np.abs(request.scene.nodes0), initial=1e-300))


def find(accuracy: float, ways: Sequence[Way], request: Request) -> Trajectory:
    """The run that has the accuracy, or the best that could be made, with what it says about itself.

    Raises:
        OptionError: where the coarsest run that shows anything would take too many evaluations.
        TensegrityError: what every method's finest run raised, where none could be made.
    """
    tried: list[tuple[Way, Rung]] = []
    reason = ""
    found: Way | None = None
    while found is None:
        plans = [
            (way.ladder.spent + way.ladder.next()[1], number) for number, way in enumerate(ways) if not way.ladder.dead
        ]
        if not plans:
            break
        cost, number = min(plans)
        way = ways[number]
        spent = math.fsum(rung.evaluations for _, rung in tried)
        setting = way.ladder.next()[0]
        if way.ladder.rungs and setting >= way.ladder.rungs[-1].setting * (1 - 1e-12):
            way.ladder.dead = f"{way.ladder.name} can go no finer"
            continue
        if spent + cost - way.ladder.spent > MOST_EVALUATIONS:
            reason = (
                f"{accuracy:g} m would take more than the {MOST_EVALUATIONS:g} evaluations that are allowed; request "
                "less, or shorten the run"
            )
            break
        rung = _climb(way, setting)
        if way.ladder.strikes >= STRIKES:
            # What does not settle for a good method does not for a worse one, which would take long to find out.
            for other in ways:
                if other.ladder.rank < way.ladder.rank:
                    other.ladder.dead = other.ladder.dead or f"{way.ladder.name} did not settle"
        tried.append((way, rung))
        estimate = way.ladder.estimate
        if rung.run is None or estimate is None:
            continue
        # A run that stops for lack of a solution has no more to give, however fine; near a pole of the ODE, shorter
        # fixed steps may pass.
        ended = rung.run.status is Status.INFEASIBLE or (rung.run.status is Status.SINGULAR and not way.ladder.order)
        sound = estimate.settled or (way.ladder.resolved and ended)
        if sound and estimate.value <= accuracy:
            found = way
        elif way.ladder.exhausted:
            way.ladder.dead = f"{estimate.reason}, and finer steps would not lessen it"
    return _reported(accuracy, found or _best(ways, tried, request), tried, reason)


def _best(ways: Sequence[Way], tried: Sequence[tuple[Way, Rung]], request: Request) -> Way:
    """The way of the least estimate, where none is good enough."""
    made = [(way.ladder.estimate, way) for way in ways if way.ladder.good]
    known = [
        (not estimate.settled, estimate.value, number)
        for number, (estimate, _) in enumerate(made)
        if estimate is not None
    ]
    if made:
        return made[min(known)[2] if known else 0][1]
    failures = [rung.failure for _, rung in tried if rung.failure is not None]
    if failures:
        raise failures[-1]
    raise OptionError(
        f"accuracy: the fastest motion that is possible in {request.duration:g} s would take more than "
        f"{MOST_EVALUATIONS:g} evaluations to resolve; shorten the run, soften what is stiff, or choose integrator and "
        "step yourself"
    )


def _climb(way: Way, setting: float) -> Rung:
    """One run, kept by its ladder; what stops it is kept too."""
    try:
        run = way.run(setting)
    except TensegrityError as error:
        # A law that fails may do so because the step was too coarse; what is refused is refused at any step.
        if not isinstance(error, (DivergenceError, ControllerError)):
            way.ladder.dead = str(error)
        partial = getattr(error, "trajectory", None)
        rung = Rung(setting, None, partial.cost["evaluations"] if partial is not None else 0.0, error)
    else:
        rung = Rung(setting, run, run.cost["evaluations"])
    way.ladder.add(rung)
    return rung


def _reported(accuracy: float, found: Way, tried: Sequence[tuple[Way, Rung]], reason: str) -> Trajectory:
    """The finest run of the way that was found, with the report on its accuracy and the cost of all runs."""
    ladder = found.ladder
    last = ladder.good[-1]
    run, estimate = last.run, ladder.estimate
    assert run is not None
    value = math.nan if estimate is None else estimate.value
    settled = estimate is not None and estimate.settled
    met = settled and value <= accuracy
    why = "only one run could be made" if estimate is None else estimate.reason
    if not met:
        why = "; ".join(dict.fromkeys(part for part in (why, reason or ladder.dead) if part))
    total: dict[str, float] = {"runs": len(tried)}
    for name in ("wall_time", "steps", "evaluations"):
        total[name] = sum(_cost(rung).get(name, 0) for _, rung in tried)
    run.reports["accuracy"] = {
        "requested": accuracy,
        "error_estimate": value,
        "settled": settled,
        "met": met,
        "reason": why,
        "chosen": {"method": ladder.name, **found.words(last.setting)},
        "tried": [_row(way, rung) for way, rung in tried],
        "total_cost": total,
    }
    if not settled:
        run.reports["warnings"].append(
            f"the error is not known: {why}; the best estimate is {value:.2g} m, {accuracy:g} m were requested"
        )
    elif not met:
        run.reports["warnings"].append(f"the error is {value:.2g} m, {accuracy:g} m were requested: {why}")
    cost = {name: total.get(name, number) for name, number in run.cost.items()}
    provenance = run.provenance | {"engine": run.provenance["engine"] | {"accuracy": accuracy}}
    return replace(run, cost=cost, provenance=provenance, engine=f"{run.engine}, chosen for {accuracy:g} m")


def _row(way: Way, rung: Rung) -> dict[str, Any]:
    """What is reported of one run: its setting, its cost, its difference to the coarser run before it [m]."""
    good = way.ladder.good
    number = next((index for index, one in enumerate(good) if one is rung), 0)
    offset = len(good) - len(way.ladder.differences)
    return {
        "method": way.ladder.name,
        **way.words(rung.setting),
        "steps": _cost(rung).get("steps", 0),
        "evaluations": _cost(rung).get("evaluations", 0),
        "difference": way.ladder.differences[number - offset] if number >= offset and len(good) > 1 else None,
        "failure": "" if rung.failure is None else str(rung.failure),
    }


def _cost(rung: Rung) -> dict[str, float]:
    """Of a run; of what there was of it before it failed."""
    run = rung.run if rung.run is not None else getattr(rung.failure, "trajectory", None)
    return {} if run is None else dict(run.cost)
