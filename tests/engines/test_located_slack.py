"""RK4 that splits its steps where strings go slack or taut: closed forms, orders, and what it leaves alone."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from caught_mass import GRAVITY, MASS, REST, STIFFNESS, bob, bob_at

import tensegrity_mj as tmj
from tensegrity_mj.engines import driving
from tensegrity_mj.engines.reference import adaptive as integration_adaptive
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.runs.convergence import has_kinks, node_difference

ENDS = (tmj.DAE, tmj.ODE)


def errors(make: Any, damping: float, steps: tuple[float, ...], locate: bool) -> list[float]:
    scene = bob(damping)
    found = []
    for step in steps:
        engine = make(method=tmj.Method.RK4, timestep=step, locate_slack=locate)
        run = tmj.simulate(scene, None, engine, output_interval=0.1)
        assert has_kinks(run)
        found.append(float(np.max(np.abs(run.nodes[:, 1, 0] - bob_at(run.time, damping)))))
    return found


@pytest.mark.parametrize("make", ENDS)
@pytest.mark.parametrize("damping", [0.0, 0.8])
def test_its_order_is_four_where_strings_go_slack(make: Any, damping: float) -> None:
    """A step is a fourth of the one before: the error falls by 4^4, of which the next term, a part ω h = 0.1, takes
    some; where the instants lie in the steps makes another factor of 2 at most."""
    coarse, fine = errors(make, damping, (0.02, 0.005), True)
    assert 4**4 / 4 < coarse / fine < 4**4 * 4
    # The plain method errs by c v h² / (12 m) a jump, by k v h³ / (24 m) and more a kink: this is far below both.
    plain = errors(make, damping, (0.005,), False)[0]
    assert fine < 0.02 * plain


@pytest.mark.parametrize("make", ENDS)
def test_the_energy_ledger_closes_over_slack_events(make: Any) -> None:
    """The work integrals are integrated beside the state, over the same parts of steps.

    The elastic part of a damped string's power has a kink where the string, which pulls no more, loses its stretch;
    nothing moves otherwise for it, and it is not looked for: a part of k v² h² / 12 = 1e-4 J at h = 5 ms and v = 1 m/s.
    """

    def residual(damping: float, step: float, locate: bool) -> float:
        engine = make(method=tmj.Method.RK4, timestep=step, locate_slack=locate)
        return tmj.simulate(bob(damping), None, engine).energy_residual

    coarse, fine = residual(0.0, 0.02, True), residual(0.0, 0.005, True)
    assert coarse / fine > 4**4 / 4  # or better: RK4's error in energy is of the fifth order
    assert fine < 0.02 * residual(0.0, 0.005, False)
    assert residual(0.8, 0.005, True) < 1e-4


@pytest.mark.parametrize(
    "fixed",
    [
        lambda locate: tmj.DAE(method=tmj.Method.RK4, timestep=0.3, locate_slack=locate),
        lambda locate: tmj.MuJoCo(0.3, locate_slack=locate),
    ],
    ids=["DAE", "MuJoCo"],
)
def test_a_pull_that_begins_and_ends_within_a_step_is_seen(fixed: Any) -> None:
    """The free flight goes 1 cm beyond the string's length, for 2 sqrt(2 0.01 m / g) = 0.16 s within a step of 0.3 s.

    Both ends of the step are slack; the plain method sees of the pull what happens to be at its middle.
    """
    top, rise, end = REST + 0.01, 0.4, 0.9  # m, s, s
    nodes = np.array([[0.0, 0.0, 0.0], [top - 0.5 * GRAVITY * rise**2, 0.0, 0.0]])
    velocities = np.array([[0.0, 0.0, 0.0], [GRAVITY * rise, 0.0, 0.0]])
    start = {"initial_nodes": nodes, "initial_velocities": velocities}
    scene = tmj.Scene(bob().structure, gravity=(-GRAVITY, 0.0, 0.0), duration=end, **start)

    def last(engine: Any) -> float:
        return float(tmj.simulate(scene, None, engine, output_interval=end).nodes[-1, 1, 0])

    true = last(tmj.DAE(rtol=1e-12, atol=1e-14))
    pulled = abs(nodes[1, 0] + GRAVITY * rise * end - 0.5 * GRAVITY * end**2 - true)
    assert pulled > 0.02
    plain, located = (abs(last(fixed(locate)) - true) for locate in (False, True))
    assert plain > pulled
    # Two parts of 0.08 s of a swing at sqrt(k/m) = 7.6 / s: (ω h)⁴ / 120 of the pull's effect is a thousandth, and the
    # instants are known from cubics over steps of ω h = 2.
    assert located < 0.1 * pulled


def test_an_error_controlled_step_does_not_miss_a_short_pull(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same flight, whose parabola one step of DOP853 follows exactly: it ends where no string ever pulled."""
    beyond, rise, end = 0.001, 0.4, 0.9  # m, s, s
    nodes = np.array([[0.0, 0.0, 0.0], [REST + beyond - 0.5 * GRAVITY * rise**2, 0.0, 0.0]])
    velocities = np.array([[0.0, 0.0, 0.0], [GRAVITY * rise, 0.0, 0.0]])
    start = {"initial_nodes": nodes, "initial_velocities": velocities}
    scene = tmj.Scene(bob().structure, gravity=(-GRAVITY, 0.0, 0.0), duration=end, **start)
    free = nodes[1, 0] + GRAVITY * rise * end - 0.5 * GRAVITY * end**2

    def off(tolerance: float) -> float:
        """[m], from where the free flight ends."""
        run = tmj.simulate(scene, None, tmj.DAE(rtol=tolerance, atol=1e-2 * tolerance), output_interval=end)
        return float(free - run.nodes[-1, 1, 0])

    # The mass is stretching the string for 2 t, by `beyond` less a parabola: a speed of k/m 4/3 beyond t, if the string
    # did not slow it; it does by k beyond / (m g) = 2 % of gravity.
    t = math.sqrt(2 * beyond / GRAVITY)
    moved = STIFFNESS / MASS * 4 / 3 * beyond * t * (end - rise)
    assert off(1e-6) == pytest.approx(moved, rel=0.05)
    assert off(1e-6) == pytest.approx(off(1e-12), rel=0.01)
    monkeypatch.setattr(integration_adaptive, "LEAST_SEARCHED", math.inf)  # no step is searched
    assert abs(off(1e-6)) < 0.01 * moved


def test_smooth_motion_is_bit_for_bit_the_plain_one() -> None:
    scene = tmj.load_scene("prism")
    law = tmj.controllers.from_scene(scene)
    for closed, actuation in (
        (None, tmj.Actuation.continuous()),
        (law, tmj.Actuation.continuous()),
        (law, tmj.Actuation.hold_force_density(0.02)),
    ):
        plain, located = (
            tmj.simulate(
                scene,
                closed,
                tmj.DAE(method=tmj.Method.RK4, timestep=0.005, locate_slack=locate),
                actuation=actuation,
                duration=0.2,
            )
            for locate in (False, True)
        )
        assert not has_kinks(plain)
        assert np.array_equal(plain.nodes, located.nodes)
        assert np.array_equal(plain.winch_work, located.winch_work)
        # Where dy/dt at the end of a step begins the next, one more each time that the compiled loop is called.
        assert plain.cost["evaluations"] <= located.cost["evaluations"] <= plain.cost["evaluations"] + 2


@pytest.mark.parametrize(
    "actuation",
    [tmj.Actuation.continuous(), tmj.Actuation.hold_rest_length(0.01)],
    ids=["law at every stage", "rest lengths held"],
)
def test_strings_that_a_law_lets_go(actuation: tmj.Actuation) -> None:
    """The plain method is wrong by a part of h² wherever u comes to zero; this has nothing but h⁴ to be wrong by.

    Sampled, strings that the law lets go at a sample pull away from it, or others do in the same step.
    """
    scene = tmj.load_scene("prism").with_(duration=2.0)
    law = tmj.controllers.from_scene(scene)
    errors = {}
    reference = tmj.simulate(scene, law, tmj.DAE(rtol=1e-12, atol=1e-14), actuation=actuation, output_interval=0.01)
    assert has_kinks(reference)
    for locate in (False, True):
        engine = tmj.DAE(method=tmj.Method.RK4, timestep=0.005, locate_slack=locate)
        run = tmj.simulate(scene, law, engine, actuation=actuation, output_interval=0.01)
        errors[locate] = node_difference(run, reference)
    assert errors[True] < 0.1 * errors[False]


def test_breaks_are_kept() -> None:
    """A string that breaks while it pulls does not pull again, at whatever length: the mass falls freely."""
    scene = bob().with_(breaks=(tmj.model.Break("string", 0.5),))
    engine = tmj.DAE(method=tmj.Method.RK4, timestep=0.02, locate_slack=True)
    run = tmj.simulate(scene, None, engine, output_interval=0.02)
    after = run.time >= 0.5
    assert np.any(run.tensions[~after] > 0)
    assert not np.any(run.tensions[after])
    speeds = run.velocities[after, 1, 0]
    # RK4 has a constant acceleration exactly; 75 steps round at some m/s.
    assert np.allclose(np.diff(speeds), GRAVITY * 0.02, atol=1e-13)


def test_the_accuracy_uses_it_and_reports_so() -> None:
    scene = bob(0.8)
    run = tmj.simulate(scene, None, tmj.DAE(accuracy=1e-6))
    chosen = run.reports["accuracy"]["chosen"]
    assert chosen["method"] == "rk4"
    assert chosen["locate_slack"] is True
    assert np.max(np.abs(run.nodes[:, 1, 0] - bob_at(run.time, 0.8))) <= 1e-6
    again = tmj.DAE(method=tmj.Method.RK4, timestep=chosen["timestep"], locate_slack=True)
    same = tmj.simulate(scene, None, again, output_interval=float(run.time[1]))
    assert np.array_equal(same.nodes, run.nodes)
    assert "slack located" in str(again)


@pytest.mark.parametrize("accuracy", [1e-4, 1e-7])
def test_where_a_damper_may_push_a_request_is_met_with_steps_that_are_split(accuracy: float) -> None:
    """Judged by DOP853, which locates nothing: its error control takes short steps over each jump."""
    pushing = bob(0.8, string_law=StringLaw.UNCLIPPED)
    for engine in (tmj.DAE(accuracy=accuracy), tmj.MuJoCo(accuracy=accuracy)):
        run = tmj.simulate(pushing, None, engine)
        report = run.reports["accuracy"]
        assert report["met"]
        assert report["chosen"]["locate_slack"] is True
        tight = tmj.DAE(rtol=1e-11, atol=1e-13)
        truth = tmj.simulate(pushing, None, tight, output_interval=float(run.time[1]))
        assert has_kinks(truth)
        assert node_difference(run, truth) <= accuracy


def test_it_belongs_to_rk4() -> None:
    for make in ENDS:
        with pytest.raises(tmj.errors.OptionError, match="locate_slack = True with DOP853"):
            make(locate_slack=True)
        with pytest.raises(tmj.errors.OptionError, match="locate_slack = 'yes'"):
            make(method=tmj.Method.RK4, timestep=1e-3, locate_slack="yes")


def test_evaluations_do_not_depend_on_the_pieces_that_steps_are_taken_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces end where so much time has passed: what is known at the end of one is known to the next."""
    options = tmj.DAE(method=tmj.Method.RK4, timestep=2e-3, locate_slack=True)
    scene = tmj.load_scene("prism").with_(gravity=(0.0, 0.0, -9.81))
    whole = tmj.simulate(scene, None, options, duration=0.5)

    def sevens(count: int) -> Iterator[tuple[int, int]]:
        return ((first, min(7, count - first)) for first in range(0, count, 7))

    monkeypatch.setattr(driving, "chunks", sevens)
    pieces = tmj.simulate(scene, None, options, duration=0.5)
    np.testing.assert_array_equal(whole.nodes, pieces.nodes)
    assert whole.cost["evaluations"] == pieces.cost["evaluations"]
