"""The runs of one method, climbed from coarse to fine, on runs whose errors are formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_runs import cone_run

from tensegrity_mj.convergence import count_kinks, has_kinks
from tensegrity_mj.engines.accuracy_ladder import STRIKES, Ladder, Rung
from tensegrity_mj.trajectory import Status, Trajectory

TIMES = np.linspace(0.0, 2.0, 21)
PLAIN = 80.0  # work of a run with the first step, where nothing is located


def ladder(located: bool = False) -> Ladder:
    return Ladder("rk4", 4, 0.1, 1.0, lambda: PLAIN, lambda step: step, floor=1e-14, least=1e-9, located=located)


def off_by(error: float, *, until: int | None = None) -> Trajectory:
    """The cone's motion, its tip wrong by an error; up to a sample where it stops, if one is given."""
    run = cone_run(TIMES)
    nodes = run.nodes.copy()
    nodes[:, 1, 2] += error
    run = replace(run, nodes=nodes)
    return run if until is None else replace(run.until(until), status=Status.SINGULAR, message="a pole")


def test_what_is_found_once_is_not_multiplied_by_finer_steps() -> None:
    """250 units for the instants at any step: half the step costs 80 more, not 330."""
    one = ladder(located=True)
    one.add(Rung(0.1, off_by(1e-3), PLAIN + 250.0))
    assert one.work(0.05) == pytest.approx(2 * PLAIN + 250.0)
    other = ladder()
    other.add(Rung(0.1, off_by(1e-3), PLAIN + 250.0))
    assert other.work(0.05) == pytest.approx(2 * (PLAIN + 250.0))


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


def test_kinks_are_counted_by_the_times_between_which_they_are() -> None:
    run = cone_run(TIMES)
    tensions = np.ones_like(run.tensions)
    assert count_kinks(replace(run, tensions=tensions)) == 0
    tensions[5:9, 0] = 0.0  # slack from the 5th sample, taut from the 9th
    tensions[9:, 1] = 0.0  # another, at the same time
    kinked = replace(run, tensions=tensions)
    assert has_kinks(kinked)
    assert count_kinks(kinked) == 2
