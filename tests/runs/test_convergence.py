"""Error estimates on sequences of runs whose errors are formulas: known orders, kinks, noise, chance and chaos."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from analytic_runs import cone_run
from hypothesis import given, settings
from hypothesis import strategies as st

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.convergence import (
    Estimate,
    common_times,
    estimate_error,
    has_kinks,
    highest_order,
    judge,
    judge_tolerances,
    node_difference,
    observed_order,
)
from tensegrity_mj.runs.trajectory import Status, Trajectory

TIMES = np.linspace(0.0, 2.0, 21)
SHAPE = np.sin(1.7 * TIMES)  # of an error over time; its largest sample is used below
LARGEST = float(np.max(np.abs(SHAPE)))


def off_by(error: float, times: np.ndarray = TIMES) -> Trajectory:
    """The cone's motion, its tip wrong by an error that varies in time and is `error` at most."""
    run = cone_run(times)
    nodes = run.nodes.copy()
    nodes[:, 1, 2] += error * np.sin(1.7 * times) / LARGEST
    return replace(run, nodes=nodes)


def test_the_difference_is_the_largest_distance_at_common_times() -> None:
    a, b = off_by(0.0), off_by(3e-5)
    # Exact up to the rounding of coordinates below 1.2 m.
    assert node_difference(a, b) == pytest.approx(3e-5, abs=1e-15)
    finer = off_by(3e-5, np.linspace(0.0, 2.0, 81))
    assert node_difference(a, finer) == pytest.approx(3e-5, abs=1e-15)


def test_times_agree_within_round_off_only() -> None:
    first, second = common_times(np.array([0.0, 0.1 * 3, 1.0]), np.array([0.0, 0.25, 0.3, 1.0 + 1e-12]))
    assert first.tolist() == [0, 1, 2]
    assert second.tolist() == [0, 2, 3]
    first, _ = common_times(np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.5001, 1.0]))
    assert first.tolist() == [0, 2]


def passing(offset: float, speed: float, rest_length: float = 0.1) -> Trajectory:
    """A mass that flies past the anchor of its string at a distance [m], recorded each 0.1 s, at 0.25 m before it."""
    nodes = {"o": (0.0, 0.0, 0.0), "m": (-0.25, offset, 0.0)}
    string = tmj.String("s", ("o", "m"), 1e-6, 0.0, rest_length)
    mass = tmj.model.PointMass("m", 1.0)
    structure = tmj.Structure("passing", nodes, (), (string,), point_masses=(mass,), fixed_nodes=("o",))
    scene = tmj.Scene(structure, initial_velocities=[[0.0, 0.0, 0.0], [speed, 0.0, 0.0]])
    return tmj.simulate(scene, None, tmj.DAE(), duration=0.1, output_interval=0.1)


def test_a_string_that_is_slack_between_two_samples_has_a_kink() -> None:
    """It pulls at both; on the way from -0.25 to 0.25 m it is as short as the distance at which it passes."""
    assert np.all(passing(0.01, 5.0).tensions > 0)
    assert has_kinks(passing(0.01, 5.0))
    assert has_kinks(passing(0.0, 5.0))
    assert not has_kinks(passing(0.11, 5.0))  # it passes at more than its rest length
    assert not has_kinks(passing(0.01, 0.5))  # it has not come there yet


def test_runs_that_end_otherwise_are_infinitely_apart() -> None:
    run = off_by(0.0)
    assert node_difference(run, run.until(15)) == math.inf
    assert node_difference(run, replace(run, status=Status.DIVERGED)) == math.inf
    broken = replace(run, nodes=np.where(run.time[:, None, None] > 1, np.nan, run.nodes))
    assert node_difference(run, broken) == math.inf
    assert node_difference(run, run.until(0)) == math.inf


def test_only_common_times_count_and_only_runs_of_one_structure() -> None:
    # Ends that agree within 1e-9 of the end are one end only where they are one time.
    a, b = off_by(0.0, np.array([0.5, 2.0])), off_by(0.0, np.array([0.7, 2.0]))
    assert node_difference(a, b) == 0.0
    other = tmj.Structure("one", {"m": (0.0, 0.0, 0.0)}, point_masses=(tmj.PointMass("m", 1.0),))
    still = tmj.simulate(tmj.Scene(other, duration=1.0), None, tmj.DAE(method=tmj.Method.RK4, timestep=0.5))
    with pytest.raises(OptionError, match="one structure"):
        node_difference(a, still)


@settings(derandomize=True, max_examples=200)
@given(
    order=st.sampled_from([1, 2, 4]),
    constant=st.floats(1e-6, 1.0),
    ratios=st.tuples(st.floats(1.4, 8.0), st.floats(1.4, 2.4)),
)
def test_a_pure_order_is_seen_and_the_error_is_bounded_by_the_safety_factor(
    order: int, constant: float, ratios: tuple[float, float]
) -> None:
    """e = C h^p: differences are C (h1^p - h2^p), so that the estimate is SAFETY = 1.25 times the error."""
    steps = [1.0, 1 / ratios[0], 1 / (ratios[0] * ratios[1])]
    errors = [constant * h**order for h in steps]
    differences = [errors[0] - errors[1], errors[1] - errors[2]]
    found = judge(differences, steps, order, floor=0.0)
    assert found.settled
    # The bisection finds p to (order + 1) 2^-50; the rest is round-off of differences, at most 1e-13 of them here.
    assert found.value == pytest.approx(1.25 * errors[2], rel=1e-9)
    assert observed_order(differences[0] / differences[1], *ratios, order) == pytest.approx(order, abs=1e-9)


def test_kinks_leave_no_more_than_an_order_of_2() -> None:
    """Differences that fall by 16: of order 4 the finer run is wrong by d / 15, with kinks by d / 3 perhaps.

    With kinks no more than a fall by 8 is believed, so that the 16 before leave 2.
    """
    smooth, kinked = (judge([16.0, 1.0], [4.0, 2.0, 1.0], 4, 0.0, highest) for highest in (None, 2))
    assert smooth.value == pytest.approx(1.25 / 15)
    assert kinked.value == pytest.approx(1.25 * 2 / 3)


def test_two_runs_are_trusted_for_an_order_of_1() -> None:
    assert judge([1.0], [2.0, 1.0], 4, 0.0).value == pytest.approx(1.0)
    assert judge([1.0], [2.0, 1.0], 1, 0.0).value == pytest.approx(1.25)


def test_a_chance_agreement_is_not_believed() -> None:
    """Differences of order 4 can fall by 16 for h / 2; one that falls by 30 is taken for what 16 leave."""
    found = judge([30.0, 1.0], [4.0, 2.0, 1.0], 4, 0.0)
    assert found.value == pytest.approx(1.25 * (30 / 16) / 15)


def test_what_falls_faster_than_the_method_can_says_nothing_of_its_order() -> None:
    found = judge([1e6, 1.0], [4.0, 2.0, 1.0], 4, 0.0)
    assert found.settled
    assert found.value == pytest.approx(1.25)
    # About kinks it is chance, and 1/16 of the difference before counts.
    assert judge([1e6, 1.0], [4.0, 2.0, 1.0], 4, 0.0, kinks=True).value == pytest.approx(1.25 * 1e6 / 16)


def test_about_kinks_no_order_above_1_counts() -> None:
    """Differences 4 and 0.5, an order of 3. A smooth run would be within 1.25 * 0.5 / 7."""
    steps = [4.0, 2.0, 1.0]
    assert not judge([4.0], steps[:2], 4, 0.0, kinks=True).settled
    assert judge([4.0, 0.5], steps, 4, 0.0).value == pytest.approx(1.25 * 0.5 / 7)
    assert judge([4.0, 0.5], steps, 4, 0.0, kinks=True).value == pytest.approx(1.25 * 0.5)
    # A lower one does: 0.8 / 0.5 is an order of log2 1.6.
    assert judge([0.8, 0.5], steps, 4, 0.0, kinks=True).value == pytest.approx(1.25 * 0.5 / 0.6)


@pytest.mark.parametrize("before", [1.0, 0.3, 1.3])
def test_differences_that_do_not_fall_do_not_settle(before: float) -> None:
    found = judge([before, 1.0], [4.0, 2.0, 1.0], 4, 0.0)
    assert not found.settled
    assert "does not fall" in found.reason
    assert found.value >= max(before, 1.0)


def test_below_the_floor_differences_need_not_fall() -> None:
    found = judge([1e-13, 3e-13], [4.0, 2.0, 1.0], 4, 1e-12)
    assert found.settled
    assert found.value >= 3e-13


def test_runs_that_end_differently_do_not_settle() -> None:
    assert judge([1.0, math.inf], [4.0, 2.0, 1.0], 4, 0.0) == Estimate(
        math.inf, False, "the two finest runs end differently"
    )
    assert not judge_tolerances([math.inf], 0.0).settled


def test_tolerances_are_judged_by_the_last_difference() -> None:
    assert judge_tolerances([1e-5, 1e-7], 0.0).value == pytest.approx(1e-7)
    assert not judge_tolerances([1e-7, 1e-7], 0.0).settled
    assert judge_tolerances([1e-14], 1e-12).settled
    # Runs that took the same steps do not differ, and may be as wrong as the finer tolerance allows.
    assert judge_tolerances([0.0], 1e-12, 3e-5).value == 3e-5
    assert judge_tolerances([1e-9], 1e-12, 3e-5).value == 3e-5


def test_trajectories_of_known_errors() -> None:
    """Steps 4, 2, 1 ms with errors 256 e, 16 e, e: d = 240 e and 15 e, and the estimate is 1.25 e."""
    e = 1e-7
    found = estimate_error([off_by(256 * e), off_by(16 * e), off_by(e)], [4e-3, 2e-3, 1e-3], 4)
    # Coordinates are rounded to 1e-16 m, differences of 15 e = 1.5e-6 m so to 1e-10 of themselves; through p to 1e-8.
    assert found.value == pytest.approx(1.25 * e, rel=1e-7)
    with pytest.raises(OptionError, match="falling steps"):
        estimate_error([off_by(e), off_by(0.0)], [1e-3, 2e-3], 4)


def test_sensitive_motion_does_not_settle() -> None:
    """Errors of the motion's own size, whatever the step: what a chaotic motion leaves of an initial difference."""
    rng = np.random.default_rng(3)
    exact = cone_run(TIMES)
    believed = 0
    for _ in range(200):
        runs = [replace(exact, nodes=exact.nodes + 0.3 * rng.normal(size=exact.nodes.shape)) for _ in range(3)]
        found = estimate_error(runs, [4e-3, 2e-3, 1e-3], 4)
        # The largest of 21 x 5 distances, 0.3 √6 m in size: a maximum is 1.4 times another once in 100 or less.
        believed += found.settled
        assert found.value > 0.01
    assert believed <= 0.05 * 200


def test_a_string_that_goes_slack_makes_kinks() -> None:
    run = cone_run()
    assert not has_kinks(run)
    slack, none = run.force_densities.copy(), run.tensions.copy()
    slack[5:8, 1] = none[5:8, 1] = 0.0
    slackened = replace(run, force_densities=slack, tensions=none)
    assert has_kinks(slackened)
    assert (highest_order(run, 4), highest_order(slackened, 4), highest_order(slackened, 1)) == (4, 2, 1)
    damped = run.scene.structure.with_strings(damping=[0.0, 0.1, 0.0])
    assert highest_order(replace(slackened, scene=run.scene.with_(structure=damped)), 4) == 1
    others = run.scene.structure.with_strings(damping=[0.1, 0.0, 0.1])
    assert highest_order(replace(slackened, scene=run.scene.with_(structure=others)), 4) == 2
    # A damper that would push takes the tension, not u; it falls to zero without a jump.
    eased = replace(run, tensions=none, scene=run.scene.with_(structure=damped))
    assert (has_kinks(eased), highest_order(eased, 4)) == (True, 2)
    slack[:, 1] = none[:, 1] = 0.0  # slack always: no kink
    assert not has_kinks(replace(run, force_densities=slack, tensions=none))
