"""Actuation modes, infeasible laws, laws of one's own, and what a run says about them."""

from __future__ import annotations

import dataclasses
import itertools
import tracemalloc

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj import simulation
from tensegrity_mj.controllers import Lyapunov, from_scene

ENGINES = [
    tmj.MuJoCo(2e-3),
    tmj.DAE(tmj.Method.RK4, timestep=2e-3),
    tmj.DAE(rtol=1e-10, atol=1e-12),
    tmj.ODE(tmj.Method.RK4, timestep=2e-3),
    tmj.ODE(rtol=1e-10, atol=1e-12),
]
NAMES = ["MuJoCo", "DAE RK4", "DAE DOP853", "ODE RK4", "ODE DOP853"]


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
def test_what_is_held_is_held(prism, engine):
    law = from_scene(prism)
    period, fine = 2e-2, 2e-3
    options = {"duration": 0.2, "output_interval": fine}
    held_u = tmj.simulate(prism, law, engine, actuation=tmj.Actuation.hold_force_density(period), **options)
    held_length = tmj.simulate(prism, law, engine, actuation=tmj.Actuation.hold_rest_length(period), **options)
    ratio = round(period / fine)
    for start in range(0, 100, ratio):
        inside = slice(start, start + ratio)
        u, L0 = held_u.force_densities[inside], held_length.rest_lengths[inside]
        # u comes back from L0 = L (1 - u/k): k/L units of round-off.
        assert np.abs(u - u[0]).max() < 1e-14
        assert np.array_equal(L0, np.broadcast_to(L0[0], L0.shape))
        assert np.ptp(held_u.rest_lengths[inside][1:], axis=0).max() > 0
        assert np.ptp(held_length.force_densities[inside][1:], axis=0).max() > 0
    jumps = np.abs(np.diff(held_length.rest_lengths, axis=0)).max(axis=1)
    assert np.all(jumps[ratio - 1 :: ratio] > 0)


@pytest.mark.parametrize("actuation", [tmj.Actuation.hold_force_density, tmj.Actuation.hold_rest_length])
def test_sampled_laws_mean_the_same_in_every_engine(prism, actuation):
    law = from_scene(prism)
    runs = [tmj.simulate(prism, law, e, duration=1.0, actuation=actuation(1e-2)) for e in ENGINES]
    for run in runs:
        # RK4 at 2 ms with k = 2 N/m, or a taut string going slack within a step: below 1e-7 m.
        assert tmj.compare(run, runs[2]).max_node_error < 1e-7
    # The held rest length reports how far it is from holding the force.
    for run in runs:
        assert run.reports["largest_holding_ratio"] > 0


def test_holding_a_rest_length_adds_viscosity_and_the_run_says_so(prism):
    """k H |ds/dt| / (u |s|): the same law held as rest length drifts off with k; held as force density it does not."""
    law = from_scene(prism)
    exact = tmj.simulate(prism, law, tmj.DAE(), duration=1.0)
    errors = {}
    for k in (2.0, 200.0):
        scene = prism.with_(structure=prism.structure.with_strings(stiffness=k, force_density=0.0))
        for hold in (tmj.Actuation.hold_force_density, tmj.Actuation.hold_rest_length):
            run = tmj.simulate(scene, law, tmj.MuJoCo(1e-3), duration=1.0, actuation=hold(1e-2))
            errors[k, hold.__name__] = tmj.compare(run, exact).max_node_error, run.reports["largest_holding_ratio"]
    print(errors)
    soft, stiff = errors[2.0, "hold_rest_length"], errors[200.0, "hold_rest_length"]
    assert stiff[0] > 5 * soft[0]
    assert stiff[1] > 5 * soft[1]
    assert errors[200.0, "hold_force_density"][0] == pytest.approx(errors[2.0, "hold_force_density"][0], rel=1e-6)


@pytest.mark.parametrize("norm", [1, float("inf")])
def test_discontinuous_laws_are_refused_continuously(prism, norm):
    with pytest.raises(tmj.errors.OptionError, match="sampled"):
        tmj.simulate(prism, from_scene(prism, norm=norm), tmj.MuJoCo(1e-3))


@pytest.mark.parametrize("engine", ENGINES[:2], ids=NAMES[:2])
def test_a_control_period_that_is_no_multiple_of_the_step_is_refused(prism, engine):
    with pytest.raises(tmj.errors.OptionError, match=r"control period.*0\.003 s.*multiple.*0\.002 s or 0\.004 s"):
        tmj.simulate(prism, from_scene(prism), engine, actuation=tmj.Actuation.hold_rest_length(3e-3))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"duration": -1.0}, "duration"),
        ({"duration": 1.0005}, "multiple"),
        ({"output_interval": 3e-3}, "multiple"),
        ({"output_interval": 1e9}, "longer"),
        ({"actuation": "continuous"}, "Actuation"),
        ({"on_infeasible": "stop"}, "OnInfeasible"),
        ({"engine": "mujoco"}, "MuJoCo"),
        ({"controller": 3}, "controller"),
        ({"scene": "prism"}, "load_scene"),
    ],
)
def test_bad_requests_are_refused(prism, options, words):
    arguments = {"scene": prism, "controller": None, "engine": tmj.MuJoCo(2e-3)} | options
    with pytest.raises(tmj.errors.OptionError, match=words):  # inside, where texts are none of these
        simulation.simulate(arguments.pop("scene"), arguments.pop("controller"), arguments.pop("engine"), **arguments)


@pytest.mark.parametrize("period", [None, 0.0, -1.0, float("nan")])
def test_bad_periods_are_refused(period):
    with pytest.raises(tmj.errors.OptionError, match="period"):
        tmj.Actuation.hold_rest_length(period)


def hopeless(prism):
    """A target that the prism's law loses: turned upside down, it commands strings to push."""
    law = from_scene(prism)
    lost = {"count": 0}

    class LosesItself:
        def __call__(self, time, nodes, velocities):
            if 0.3 <= time < 0.5:
                lost["count"] += 1
                raise tmj.errors.InfeasibleError("nothing admissible now")
            return law(time, nodes, velocities)

    return LosesItself()


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
@pytest.mark.parametrize("actuation", [tmj.Actuation.continuous(), tmj.Actuation.hold_force_density(1e-2)])
def test_an_infeasible_law_stops_the_run_with_a_clear_status(prism, engine, actuation):
    run = tmj.simulate(prism, hopeless(prism), engine, duration=1.0, actuation=actuation)
    assert run.status is tmj.Status.INFEASIBLE
    assert "0.3 s" in run.message
    assert "PASSIVE" in run.message
    assert run.time[-1] == pytest.approx(0.3, abs=2e-3)  # one step of the coarsest engine
    assert np.all(np.diff(run.time) > 0)
    assert np.all(np.isfinite(run.nodes))


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
@pytest.mark.parametrize("actuation", [tmj.Actuation.continuous(), tmj.Actuation.hold_force_density(1e-2)])
def test_the_passive_mode_holds_the_last_admissible_rest_lengths(prism, engine, actuation):
    run = tmj.simulate(
        prism, hopeless(prism), engine, duration=1.0, actuation=actuation, on_infeasible=tmj.OnInfeasible.PASSIVE
    )
    assert run.status is tmj.Status.COMPLETED
    passive = (run.time > 0.305) & (run.time < 0.495)
    assert np.ptp(run.rest_lengths[passive], axis=0).max() == 0
    active = run.time > 0.51
    assert np.ptp(run.rest_lengths[active], axis=0).max() > 0
    before = np.argmin(np.abs(run.time - 0.3)) - 1
    # The rest lengths move at less than 1 m/s, and one output interval lies between.
    assert np.abs(run.rest_lengths[before] - run.rest_lengths[passive][0]).max() < 1e-2


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
def test_the_lyapunov_law_itself_runs_out_of_solutions(engine):
    """A rod in the plane of its strings' anchors cannot be lifted out of it (§5.4)."""
    scene = tmj.load_scene("pinned_rod")
    flat = np.array(scene.nodes0)
    flat[1] = (0.0, -1.0, 0.0)
    start = scene.with_(initial_nodes=flat)
    target = np.array(scene.target.nodes[0])
    target[1] = (0.0, 0.0, 1.0)
    law = Lyapunov(scene.structure, target, decay_rate=0.15)
    run = tmj.simulate(start, law, engine, duration=2.0)
    assert run.status is tmj.Status.INFEASIBLE
    assert run.min_feasibility_margin <= 0
    assert "margin" in run.message


def test_a_plain_function_is_a_law(prism):
    def spring_back(time, nodes, velocities):
        return np.full(12, 0.05)

    runs = [tmj.simulate(prism, spring_back, engine, duration=0.5) for engine in ENGINES]
    for run in runs:
        assert run.force_densities == pytest.approx(np.full_like(run.force_densities, 0.05), rel=1e-13)
    assert tmj.compare(runs[0], runs[2]).max_node_error < 1e-9
    assert runs[0].provenance["controller"]["law"] == "spring_back"


def test_a_law_may_return_rest_lengths(prism):
    class Winch:
        command = tmj.Command.REST_LENGTH

        def __call__(self, time, nodes, velocities):
            return prism.structure.rest_lengths * (1 - 0.1 * min(time, 1.0))

    runs = [tmj.simulate(prism, Winch(), engine, duration=0.5) for engine in ENGINES]
    for run in runs:
        expected = prism.structure.rest_lengths * (1 - 0.1 * run.time[:, None])
        assert run.rest_lengths == pytest.approx(expected, rel=1e-14)
        assert run.winch_work[-1] > 0
    # Some strings stand at their rest length and go slack and taut: an event's error is O(h²) at 2 ms.
    assert tmj.compare(runs[0], runs[2]).max_node_error < 1e-6


def test_rest_lengths_below_zero_are_reported(prism):
    scene = prism.with_(structure=prism.structure.with_strings(stiffness=0.05, force_density=0.0))
    runs = [tmj.simulate(scene, from_scene(scene), engine, duration=1.0) for engine in ENGINES]
    for run in runs:
        report = run.reports["nonpositive_rest_lengths"]
        assert report["samples"] > 0
        assert report["first_time"] == run.time[np.argmax((run.rest_lengths <= 0).any(axis=1))]
        assert set(report["strings"]) <= {s.name for s in prism.structure.strings}
    # u >= k is exact all the same.
    assert tmj.compare(runs[0], runs[2]).max_node_error < 1e-7


def test_a_period_without_a_law_is_refused(prism):
    with pytest.raises(tmj.errors.OptionError, match="without a law"):
        tmj.simulate(prism, None, tmj.MuJoCo(2e-3), actuation=tmj.Actuation.hold_rest_length(1e-2))


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
def test_margin_and_v_are_those_of_the_recorded_state_while_passive(engine):
    """In the passive mode the law is not obeyed, but its margin and V are still reported for each recorded state."""
    # One string pulls a rod towards its target, and cannot push it back once it is too fast.
    structure = tmj.Structure(
        "one string",
        nodes={"a": (0, 0, 0), "b": (1, 0, 0), "c": (0, 1, 0)},
        rods=(tmj.Rod("r", ("a", "b"), 1.0, support=tmj.Support.pinned()),),
        strings=(tmj.String("s", ("b", "c"), 5.0),),
        fixed_nodes=("c",),
    )
    target = np.array([[0, 0, 0], [np.cos(0.8), np.sin(0.8), 0], [0, 1, 0]])
    law = Lyapunov(structure, target, decay_rate=0.5)
    start = tmj.Scene(structure, initial_velocities=[[0, 0, 0], [0, 0.5, 0], [0, 0, 0]])
    run = tmj.simulate(start, law, engine, duration=3.0, on_infeasible=tmj.OnInfeasible.PASSIVE)
    truth = np.array([law.evaluate(*row)[1:] for row in zip(run.time, run.nodes, run.velocities, strict=True)])
    assert np.any(truth[:, 0] <= 0), "the law must lose its solution here, or the test is empty"
    # The same function of the same state, up to round-off in the nodes.
    assert run.lyapunov == pytest.approx(truth[:, 1], rel=1e-9)
    assert run.feasibility_margin == pytest.approx(truth[:, 0], rel=1e-6)


def test_what_does_not_fit_together_is_warned_of(prism):
    heavy = prism.with_(gravity=(0.0, 0.0, -0.01))
    run = tmj.simulate(heavy, Lyapunov(prism.structure, prism.target), tmj.DAE(), duration=0.2)
    assert any("gravity" in warning for warning in run.reports["warnings"])
    coarse = tmj.simulate(prism, from_scene(prism), tmj.MuJoCo(0.02, tmj.Integrator.EULER), duration=2.0)
    assert any("energy balance" in warning for warning in coarse.reports["warnings"])
    fine = tmj.simulate(prism, from_scene(prism), tmj.MuJoCo(1e-3), duration=2.0)
    assert fine.reports["warnings"] == []


def test_a_run_too_long_to_record_is_refused_before_memory_is_requested(prism):
    for engine, duration in itertools.product(ENGINES, (1e6, 1e12)):  # of the first, the times alone would fit: 0.8 GB
        tracemalloc.start()
        with pytest.raises(tmj.errors.OptionError, match=r"GiB|counted"):
            tmj.simulate(prism, None, engine, duration=duration)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 0.1e9


def test_descriptions_that_no_file_can_hold_are_refused_before_the_run(prism):
    class Shapeless:
        def __call__(self, time, nodes, velocities):
            return np.zeros(12)

        def describe(self):
            return {"gain": np.eye(2)}

    with pytest.raises(tmj.errors.OptionError, match="plain values"):
        tmj.simulate(prism, Shapeless(), tmj.MuJoCo(2e-3), duration=0.1)


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
@pytest.mark.parametrize("python_law", [False, True])
def test_an_interrupt_is_neither_lost_nor_misread(prism, engine, python_law):
    """SIGINT at some moment of a run raises KeyboardInterrupt, also within a Python law."""
    import os
    import signal
    import threading

    law = from_scene(prism)
    controller = (lambda t, n, v: law(t, n, v)) if python_law else law
    if isinstance(engine, tmj.DAE | tmj.ODE):  # a run whose steps shrink without end, from 12 s on, is not given up
        engine = dataclasses.replace(engine, max_steps=10**12)
    timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            tmj.simulate(prism, controller, engine, duration=20000.0, output_interval=10.0)
    finally:
        timer.cancel()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    # The next run is undisturbed.
    assert tmj.simulate(prism, law, engine, duration=0.1).status is tmj.Status.COMPLETED
