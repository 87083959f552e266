"""A run with an accuracy instead of a step: which integrator, which step or tolerance, and how wrong the result is.

Several methods are tried side by side, each from coarse to fine (`ladder`). The next run is always that of the
method which will have cost least with it, counted in evaluations of the forces and never in measured time, so that the
same request gives the same run on every machine. Nothing but the end of this sequence depends on the accuracy: a looser
request makes a part of the runs of a tighter one, unless they are certified (below). The finest run is returned; its
error is estimated from its difference to coarser runs of the same method over the whole time.

Where another engine computes the same motion at a fraction of the cost, its runs are refined instead, and one run of
the engine itself is compared with the finest of them (`_certify`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tensegrity_mj.engines.accuracy.ladder import FIRST_STEP, HALF, STRIKES, Ladder, Rung
from tensegrity_mj.engines.accuracy.rates import Rates, rates_along
from tensegrity_mj.engines.driving import DEFAULT_INTERVAL
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.runs.convergence import LEAST_ORDER, ROUND_OFF, Estimate, node_difference, pieces_along
from tensegrity_mj.runs.trajectory import Status, Trajectory

COARSEST = 0.1  # s; steps are begun with here, where nothing requires less
FEWEST_STEPS = 20  # of the coarsest run
AS_ONE = 1e-9  # relative: what `whole_ratio` takes for a multiple
MOST_FINER = 16  # times, that steps are finer than they need be, so that they end at kinks of data
FINEST = 1e-6  # of the duration: times whose common divisor is less have none


@dataclass(frozen=True)
class Steps:
    """Steps unit / k, k = 1, 2, 4, 8, ...

    Attributes:
        unit: [s], the coarsest. A finer run records all times that a coarser one does, so that what is wrong for a
            moment only is compared too.
        count: of steps of that length in the run.
        interval: [s] between samples where the caller requested it, or None.
        aligned: whether they end at all kinks of data (`Request.kinks`).
    """

    unit: float
    count: int
    interval: float | None
    aligned: bool = True

    @classmethod
    def of(cls, request: Request, longest: float) -> Steps:
        """The steps of a request.

        Args:
            longest: [s], the coarsest step at most.

        Raises:
            OptionError: where duration, output interval, control period and breaks have no common divisor.
        """
        times = request.intervals
        base = common_divisor(list(times.values()), request.duration)
        if base is None:
            shown = ", ".join(f"{name} {value:.12g} s" for name, value in times.items())
            raise OptionError(f"accuracy: no step divides all of {shown}; use round numbers")
        most = min(COARSEST, request.duration / FEWEST_STEPS, longest)
        finer = common_divisor([base, *request.kinks], request.duration)
        aligned = finer is not None and (finer == base or finer >= most / MOST_FINER)
        base = finer if finer is not None and aligned else base
        unit = base / max(1, math.ceil(base / most * (1 - AS_ONE)))
        return cls(unit, round(request.duration / unit), request.output_interval, aligned)

    def fit(self, step: float) -> float:
        """The coarsest of them that is not coarser than this one [s]."""
        return self.unit / _power_of_two(self.unit / step)

    def recorded_each(self, step: float) -> float:
        """Time [s] between samples of its run: 0.005 to 0.01 s, a step at least, and multiples of unit hit."""
        if self.interval is not None:
            return self.interval
        if self.unit <= DEFAULT_INTERVAL:
            return self.unit * math.floor(DEFAULT_INTERVAL / self.unit * (1 + AS_ONE))
        k = _power_of_two(self.unit / step)
        return step * (k // min(k, _power_of_two(self.unit / DEFAULT_INTERVAL)))


def _power_of_two(least: float) -> int:
    """The smallest that is not less, round-off apart."""
    return 1 << max(0, math.ceil(math.log2(max(least * (1 - AS_ONE), 1.0))))


def common_divisor(times: list[float], duration: float) -> float | None:
    """The largest number of which all are multiples, by Euclid's algorithm; None if that is next to nothing."""
    divisor = times[0]
    for time in times[1:]:
        a, b = max(divisor, time), min(divisor, time)
        while b > AS_ONE * max(divisor, time):
            a, b = b, abs(a - round(a / b) * b)
        divisor = a
        if divisor < FINEST * duration:
            return None
    # Remainders gather round-off: the divisor of the first time is exact.
    return times[0] / round(times[0] / divisor)


LEAST_STEP = 1e-9  # of the duration
PARTS = 8  # of a first step, in which another is taken: its error is 8⁻⁴ of that of the whole
ROOM = 0.75  # of the coarsest step that the start allows: rates change along a run
MOST_EVALUATIONS = 4e7  # minutes, where one takes some microseconds


def fixed_steps(
    name: str,
    order: int,
    evaluations: int,
    resolving: Callable[[Rates], float],
    start: Rates,
    request: Request,
    make: Callable[[float, Request], Trajectory],
    located: bool = False,
) -> Ladder:
    """The ladder of a method of fixed steps.

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
        made = make(step, replace(request, output_interval=steps.recorded_each(step)))
        return _with_first_step(made, step, request, make) if located else made

    return Ladder(
        name=name,
        run=run,
        order=order,
        first=steps.unit,
        growth=1.0,
        first_cost=evaluations * steps.count,
        fit=steps.fit,
        floor=round_off(request),
        least=LEAST_STEP * request.duration,
        resolving=lambda run: resolving(rates_along(run, request)),
        located=located,
        aligned=steps.aligned,
    )


def _with_first_step(run: Trajectory, step: float, request: Request, make: Callable[..., Trajectory]) -> Trajectory:
    """The run with what its first step is wrong by, where a string goes slack or taut, or passes a corner, before its
    second sample.

    Such a step ends at that instant. A run of half the step takes the very same part first where the instant is within
    its first step, too, and both are wrong alike, by what no difference of them shows. So it is taken in `PARTS` as
    well. What is wrong after it, ε in nodes and ε' in their velocities, is taken for ε + ε' T at the end.
    """
    pulls, pieces = run.tensions[:2] != 0, pieces_along(run)[:2]
    if len(run.time) < 2 or not np.any((pulls[0] != pulls[1]) | (pieces[0] != pieces[1])):
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


def round_off(request: Request) -> float:
    """Distance [m] below which differences of runs are taken for round-off."""
    return ROUND_OFF * float(np.max(np.abs(request.scene.nodes0), initial=1e-300))


def find(
    accuracy: float,
    ladders: Sequence[Ladder],
    request: Request,
    reference: Ladder | None = None,
    cheap: Ladder | None = None,
) -> Trajectory:
    """The run that has the accuracy, or the best that could be made, with what it says about itself.

    Args:
        accuracy: [m].
        ladders: of the methods.
        request: of the run.
        reference: of another engine, with the steps of the first of them, whose run it is to certify (`_certify`).
        cheap: of a method with the same steps that costs less, and may do where the request leaves much to spare.

    Raises:
        OptionError: where the coarsest run that shows anything would take too many evaluations.
        TensegrityError: what every method's finest run raised, where none could be made.
    """
    tried: list[tuple[Ladder, Rung]] = []
    if reference is not None and (judged := _certify(accuracy, reference, ladders[0], cheap, tried)) is not None:
        return _reported(accuracy, *judged, tried, judged[1].reason)
    reason = ""
    found: Ladder | None = None
    while found is None:
        plans = [(one.spent + one.next()[1], number) for number, one in enumerate(ladders) if not one.dead]
        if not plans:
            break
        cost, number = min(plans)
        ladder = ladders[number]
        spent = math.fsum(rung.evaluations for _, rung in tried)
        setting = ladder.next()[0]
        if ladder.rungs and setting >= ladder.rungs[-1].setting * (1 - 1e-12):
            ladder.dead = f"{ladder.name} can go no finer"
            continue
        if spent + cost - ladder.spent > MOST_EVALUATIONS:
            reason = (
                f"{accuracy:g} m would take more than the {MOST_EVALUATIONS:g} evaluations that are allowed; request "
                "less, or shorten the run"
            )
            break
        rung = ladder.climb(setting)
        if ladder.strikes >= STRIKES:
            # What does not settle for a good method does not for a worse one, which would take long to find out.
            for other in ladders:
                if other.rank < ladder.rank:
                    other.dead = other.dead or f"{ladder.name} did not settle"
        tried.append((ladder, rung))
        estimate = ladder.estimate
        if rung.run is None or estimate is None:
            continue
        # A run that stops for lack of a solution has no more to give, however fine; near a pole of the ODE, shorter
        # fixed steps may pass.
        ended = rung.run.status is Status.INFEASIBLE or (rung.run.status is Status.SINGULAR and not ladder.order)
        sound = estimate.settled or (ladder.resolved and ended)
        if sound and estimate.value <= accuracy:
            found = ladder
        elif ladder.exhausted:
            ladder.dead = f"{estimate.reason}, and finer steps would not lessen it"
    found = found or _best(ladders, tried, request)
    return _reported(accuracy, found, found.estimate, tried, reason or found.dead)


PART = 0.5  # of a request, that differences of the reference may be
SPARE = 1e-3  # the same, where a cheaper method is tried
APART = 2  # times in a row that a distance from the reference does not fall, until it is what the engines differ by


def _certify(
    accuracy: float, reference: Ladder, ladder: Ladder, cheap: Ladder | None, tried: list[tuple[Ladder, Rung]]
) -> tuple[Ladder, Estimate] | None:
    """Refine the reference until three runs, of steps h, h / 2 and h / 4, differ by `PART` of the request at most, and
    compare one run of step h with the last of them; with half the step, where they are too far apart.

    The steps h do not exceed twice those that resolve the motion along the reference's runs.

    Args:
        accuracy: [m].
        reference: by another engine.
        ladder, cheap: of the methods to be certified, with the same steps; the second is tried once, where the first
            would be much better than was requested.
        tried: what was run, added to.

    Returns:
        One of them, and the estimate of its finest run's error: within the request, or beyond it where the two engines
        stay apart. None where the reference cannot tell: its runs stop early, do not settle, or take too long.
    """
    last, apart = math.inf, 0
    while not reference.dead and not ladder.dead:
        setting, cost = reference.next()
        if reference.spent + cost + ladder.spent > MOST_EVALUATIONS:
            break
        run = reference.climb(setting).run
        tried.append((reference, reference.rungs[-1]))
        if run is None:
            continue
        sound, recent = reference.estimate, reference.differences[-2:]
        if run.status is not Status.COMPLETED or (reference.exhausted and max(recent) > PART * accuracy):
            break
        if len(recent) < 2 or sound is None or max(sound.value, max(recent) / PART) > accuracy:
            continue
        step = reference.good[-3].setting
        if step > HALF * reference.longest * (1 + AS_ONE):
            continue
        first = cheap if cheap is not None and not cheap.rungs and max(recent) <= SPARE * accuracy else None
        for one in (ladder,) if first is None else (first, ladder):
            made = one.climb(step).run
            tried.append((one, one.rungs[-1]))
            away = math.inf if made is None else node_difference(made, run)
            found = Estimate(
                away + sound.value,
                math.isfinite(away),
                f"it is {away:.2g} m from the finest run of {reference.name}, whose last three differ by "
                f"{recent[0]:.2g} m and {recent[1]:.2g} m",
            )
            if found.value <= accuracy:
                return one, replace(found, reason=f"certified by {reference.name}: {found.reason}")
        if made is None:
            continue
        apart = 0 if away <= PART * accuracy or away < last * 2**-LEAST_ORDER else apart + 1
        last = away
        if apart == APART:
            words = f"refuted by {reference.name}: {found.reason}, and finer steps come no nearer"
            return ladder, replace(found, reason=words)
    return None


def _best(ladders: Sequence[Ladder], tried: Sequence[tuple[Ladder, Rung]], request: Request) -> Ladder:
    """The ladder of the least estimate, where none is good enough."""
    made = [(one.estimate, one) for one in ladders if one.good]
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


def _reported(
    accuracy: float, ladder: Ladder, estimate: Estimate | None, tried: Sequence[tuple[Ladder, Rung]], reason: str
) -> Trajectory:
    """The finest run of the ladder that was found, with the report on its accuracy and the cost of all runs."""
    last = ladder.good[-1]
    run = last.run
    assert run is not None
    value = math.nan if estimate is None else estimate.value
    settled = estimate is not None and estimate.settled
    met = settled and value <= accuracy
    why = "only one run could be made" if estimate is None else estimate.reason
    if not met:
        why = "; ".join(dict.fromkeys(part for part in (why, reason) if part))
    total: dict[str, float] = {"runs": len(tried)}
    for name in ("wall_time", "steps", "evaluations"):
        total[name] = sum(rung.cost.get(name, 0) for _, rung in tried)
    run.reports["accuracy"] = {
        "requested": accuracy,
        "error_estimate": value,
        "settled": settled,
        "met": met,
        "reason": why,
        "chosen": {"method": ladder.name, **ladder.words(last.setting)},
        "tried": [_row(*one) for one in tried],
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


def _row(ladder: Ladder, rung: Rung) -> dict[str, Any]:
    """Report of one run: its setting, its cost, its difference from the coarser run before it [m]."""
    good = ladder.good
    number = next((index for index, one in enumerate(good) if one is rung), 0)
    offset = len(good) - len(ladder.differences)
    return {
        "method": ladder.name,
        **ladder.words(rung.setting),
        "steps": rung.cost.get("steps", 0),
        "evaluations": rung.cost.get("evaluations", 0),
        "difference": ladder.differences[number - offset] if number >= offset and len(good) > 1 else None,
        "failure": "" if rung.failure is None else str(rung.failure),
    }
