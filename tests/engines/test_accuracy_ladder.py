"""The runs of one method, climbed from coarse to fine, on runs whose errors are formulas."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from analytic_runs import cone_run

import tensegrity_mj as tmj
from tensegrity_mj.engines.accuracy.ladder import CERTIFIER, FAILURES, STRIKES, WEIGHTS, Ladder, Rung
from tensegrity_mj.engines.accuracy.search import APART, MOST_EVALUATIONS, find
from tensegrity_mj.runs.trajectory import Status, Trajectory

TIMES = np.linspace(0.0, 2.0, 21)
PLAIN = 80.0  # evaluations of a run with the first step


def no_run(setting: float) -> Trajectory:
    raise AssertionError("runs are given")


def ladder(**changes: Any) -> Ladder:
    return Ladder("rk4", no_run, 4, 0.1, 1.0, PLAIN, lambda step: step, floor=1e-14, least=1e-9, **changes)


def off_by(error: float, *, until: int | None = None) -> Trajectory:
    """The cone's motion, its tip wrong by an error; up to a sample where it stops, if one is given."""
    run = cone_run(TIMES)
    nodes = run.nodes.copy()
    nodes[:, 1, 2] += error
    run = replace(run, nodes=nodes)
    return run if until is None else replace(run.until(until), status=Status.SINGULAR, message="a pole")


def made(run: Trajectory, evaluations: float) -> Trajectory:
    cost = {"evaluations": evaluations, "wall_time": 0.0, "steps": 1}
    return replace(run, cost=cost, reports={"warnings": []}, provenance={"engine": {}})


def test_each_run_has_half_the_step_and_twice_the_cost_of_the_one_before() -> None:
    one = ladder()
    assert one.next() == (0.1, PLAIN)
    one.add(Rung(0.1, off_by(1e-3), 100.0))
    assert one.next() == pytest.approx((0.05, 200.0))
    one.add(Rung(0.05, None, 30.0, tmj.errors.DivergenceError("gone", 0.1, None)))  # a run that failed costs too
    assert one.next() == pytest.approx((0.025, 400.0))
    assert one.spent == 130.0


def test_an_evaluation_counts_by_what_it_costs() -> None:
    """A run by Radau of 100 evaluations, called from Python, is dearer than one of 2,000 compiled ones."""

    def climbing(name: str, evaluations: float) -> Ladder:
        def run(rtol: float) -> Trajectory:
            return made(off_by(rtol), evaluations)

        return Ladder(name, run, 0, 1e-3, 1 / 8, evaluations, lambda rtol: rtol, floor=1e-14, least=1e-13)

    request: Any = SimpleNamespace(duration=1.0)
    report = find(1e-2, [climbing("radau", 100.0), climbing("dop853", 2000.0)], request).reports["accuracy"]
    assert report["chosen"]["method"] == "dop853"
    assert report["tried"][0]["evaluations"] == 2000.0  # reports have plain numbers
    radau = climbing("radau", 100.0)
    radau.climb(1e-3)
    assert radau.spent == 100.0 * WEIGHTS["radau"]


def test_tolerances_fall_by_thirty() -> None:
    one = Ladder("dop853", no_run, 0, 1e-3, 1 / 8, PLAIN, lambda rtol: rtol, floor=1e-14, least=1e-13)
    one.add(Rung(1e-3, off_by(1e-3), 100.0))
    assert one.next() == pytest.approx((1e-3 / 30, 100 * 30 ** (1 / 8)))
    one.add(Rung(1e-3 / 30, off_by(1e-5), 150.0))
    assert one.estimate is not None
    assert one.estimate.settled  # whatever steps are: the method chooses them


def test_runs_whose_steps_are_too_long_are_no_evidence() -> None:
    """Two runs agree to 1e-9 m because both have lost a vibration that takes steps of 0.01 s."""
    one = ladder(resolving=lambda run: 0.01)
    one.add(Rung(0.1, off_by(1e-3), 1.0))
    # A run of 0.02 s can be half of a pair that is evidence: those between are not made.
    assert one.next()[0] == pytest.approx(0.02)
    one.add(Rung(0.05, off_by(1e-3 + 1e-9), 1.0))
    assert one.estimate is not None
    assert not one.estimate.settled
    assert "too long for the fastest motion" in one.estimate.reason
    for step, error in ((0.02, 1e-3), (0.01, 2e-4)):
        one.add(Rung(step, off_by(error), 1.0))
    assert one.estimate.settled
    # An order of 2 is what the last three would show; the first of them has none, and 8e-4 m is what is left.
    assert one.estimate.value == pytest.approx(8e-4, rel=1e-9)


def test_runs_that_stop_early_do_not_end_the_search() -> None:
    """Coarse steps stop at a pole that finer ones pass. Their differences fall all the same, by 2^4."""
    one = ladder()
    for number in range(STRIKES + 2):
        one.add(Rung(0.1 / 2**number, off_by(1e-2 / 16**number, until=12), 1.0))
        assert number == 0 or not one.estimate.settled  # type: ignore[union-attr]
    assert not one.dead
    one.add(Rung(1e-3, off_by(1e-10), 1.0))
    assert not one.dead
    # Where they do not fall, it ends.
    two = ladder()
    for number in range(STRIKES + 2):
        two.add(Rung(0.1 / 2**number, off_by(1e-2 * (-1) ** number, until=12), 1.0))
    assert "does not fall" in two.dead


def test_failures_in_a_row_end_a_ladder_and_one_run_between_them_does_not() -> None:
    one, two = ladder(), ladder()
    for number in range(FAILURES):
        assert not one.dead
        failed = Rung(0.1 / 2**number, None, 1.0, tmj.errors.DivergenceError("gone astray", 0.1, None))
        one.add(failed)
        two.add(Rung(failed.setting, off_by(1e-3), 1.0) if number == 1 else failed)
    assert one.dead == f"{FAILURES} runs in a row failed, the last: gone astray"
    assert not two.dead


def test_a_request_that_is_not_met_is_warned_of_with_what_is_known() -> None:
    """Errors that fall with the step, as Euler's, and some that change their sign from run to run instead."""

    def warned(accuracy: float, errors: Callable[[float], float]) -> list[str]:
        def run(step: float) -> Trajectory:
            return made(off_by(errors(step)), 1 / step)

        one = Ladder("euler", run, 1, 0.1, 1.0, 10.0, lambda step: step, floor=1e-14, least=1e-4)
        return find(accuracy, [one], SimpleNamespace(duration=1.0)).reports["warnings"]  # type: ignore[arg-type]

    assert warned(1e-2, lambda step: step) == []
    (settled,) = warned(1e-8, lambda step: step)
    assert re.match(
        r"the error is 0\.000\d+ m, 1e-08 m were requested: runs differ by .*; euler can go no finer", settled
    )
    (unknown,) = warned(1e-8, lambda step: 0.5 * (-1) ** round(np.log2(0.1 / step)))
    assert unknown.startswith("the error is not known: ")
    assert "does not fall" in unknown
    assert unknown.endswith(" m, 1e-08 m were requested")


def test_a_tighter_request_makes_the_runs_of_a_looser_one_and_more() -> None:
    """Two methods, errors C h^p; whatever is requested, the sequence of runs is one, and requests only end it."""

    def climbing(name: str, order: int, cost: float, scale: float) -> Ladder:
        def run(step: float) -> Trajectory:
            return made(off_by(scale * step**order), cost / step)

        return Ladder(name, run, order, 0.1, 1.0, 10 * cost, lambda step: step, floor=1e-14, least=1e-9)

    request: Any = SimpleNamespace(duration=1.0)
    sequences = []
    for accuracy in (1e-2, 1e-3, 1e-5, 1e-7, 1e-9):
        found = find(accuracy, [climbing("rk4", 4, 4.0, 10.0), climbing("euler", 1, 1.0, 0.1)], request)
        report = found.reports["accuracy"]
        assert report["met"]
        sequences.append([(one["method"], one["timestep"]) for one in report["tried"]])
    for shorter, longer in itertools.pairwise(sequences):
        assert longer[: len(shorter)] == shorter
    assert len(sequences[0]) < len(sequences[-1])
    # None is tried at more than what all have cost: with k methods a run costs at most k times the best of them.
    assert {name for name, _ in sequences[-1]} == {"rk4", "euler"}


def test_what_would_take_too_many_evaluations_is_refused_or_reported() -> None:
    def climbing(per_step: float, error: float) -> Ladder:
        def run(step: float) -> Trajectory:
            return made(off_by(error * step), per_step / step)

        return Ladder("euler", run, 1, 0.1, 1.0, 10 * per_step, lambda step: step, floor=1e-14, least=1e-9)

    request: Any = SimpleNamespace(duration=1.0)
    with pytest.raises(tmj.errors.OptionError, match="shorten the run"):
        find(1e-3, [climbing(MOST_EVALUATIONS, 1.0)], request)
    found = find(1e-8, [climbing(MOST_EVALUATIONS / 100, 1.0)], request)
    assert not found.reports["accuracy"]["met"]
    assert "evaluations that are allowed" in found.reports["accuracy"]["reason"]
    assert found.reports["accuracy"]["total_cost"]["evaluations"] <= MOST_EVALUATIONS


def test_a_reference_is_refined_until_three_runs_agree_and_one_run_is_compared_with_the_last() -> None:
    """The reference's errors are 10 h^4. Its runs of 0.1 and 0.05 s differ by 9.4e-4 m, and 5.9e-5 m follow.

    A method wrong by 20 h^4 is 2e-3 m off at 0.1 s and 1.2e-4 m at 0.05 s; one wrong by 3e-4 m however it steps never
    comes nearer, though its own runs agree.
    """

    def climbing(name: str, error: Callable[[float], float], per_step: float = 4.0) -> Ladder:
        def run(step: float) -> Trajectory:
            return made(off_by(error(step)), per_step / step)

        return Ladder(name, run, 4, 0.1, 1.0, 10 * per_step, lambda step: step, floor=1e-14, least=1e-6)

    def judged(accuracy: float, error: Callable[[float], float], **changes: Any) -> dict[str, Any]:
        reference = climbing(CERTIFIER, changes.pop("reference", lambda step: 10 * step**4))
        request: Any = SimpleNamespace(duration=1.0)
        return dict(find(accuracy, [climbing("rk4", error)], request, reference, **changes).reports["accuracy"])

    def steps(report: dict[str, Any], name: str) -> list[float]:
        return [one["timestep"] for one in report["tried"] if one["method"] == name]

    report = judged(2.5e-3, lambda step: 20 * step**4)
    assert report["met"]
    assert steps(report, CERTIFIER) == [0.1, 0.05, 0.025]
    assert steps(report, "rk4") == [0.1]
    # 2e-3 m less those of the finest reference, and a fifteenth of its last difference times the safety of 1.25.
    finest = 10 * 0.025**4
    assert report["error_estimate"] == pytest.approx(2e-3 - finest + 1.25 * finest, rel=1e-6)

    # A request of which the reference is sure at 0.1 s, and the run of 0.1 s is beyond: half the step, once more.
    report = judged(1.9e-3, lambda step: 20 * step**4)
    assert report["met"]
    assert steps(report, "rk4") == [0.1, 0.05]

    report = judged(1e-4, lambda step: 3e-4)
    assert not report["met"]
    assert report["reason"].startswith("refuted")
    assert report["error_estimate"] == pytest.approx(3e-4, rel=0.01)
    assert len(steps(report, "rk4")) == 1 + APART

    # A cheaper method that is beyond a loose request costs one run more, and saves the dearer one where it is within.
    for wrong, expected in ((2e-3, ["discrete"]), (2e-2, ["discrete", "rk4"])):
        cheap = climbing("discrete", lambda step, by=wrong: by, 1.0)  # type: ignore[misc]
        report = judged(1e-2, lambda step: 0.0, reference=lambda step: 1e-3 * step**4, cheap=cheap)
        assert report["met"]
        assert [one["method"] for one in report["tried"] if one["method"] != CERTIFIER] == expected
        assert report["chosen"]["method"] == expected[-1]

    # A reference whose differences do not fall tells nothing; the method's own do.
    report = judged(1e-4, lambda step: step**4, reference=lambda step: (-1) ** round(np.log2(0.1 / step)))
    assert report["met"]
    assert len(steps(report, CERTIFIER)) == STRIKES + 2
    assert "an order" in report["reason"]


def test_rates_are_looked_at_where_they_count() -> None:
    """The first run of a method that is certified is judged by its distance from the reference, and by no rates."""
    looked: list[Trajectory] = []

    def resolving(run: Trajectory) -> float:
        looked.append(run)
        return 0.05

    one = ladder(resolving=resolving)
    one.add(Rung(0.1, off_by(0.0), PLAIN))
    assert not looked
    assert not one.resolved
    assert one.longest == 0.05
    assert len(looked) == 1
