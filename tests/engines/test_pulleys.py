"""Strings through more than two nodes: closed forms, and motions that two engines share with a third means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pulley_scenes import G, atwood, ringed, slung, threaded

import tensegrity_mj as tmj

FIXED = {
    "mujoco": lambda step: tmj.MuJoCo(timestep=step),
    "dae": lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step),
    "ode": lambda step: tmj.ODE(method=tmj.Method.RK4, timestep=step),
}


@pytest.mark.third_means(
    "strings.measure_segments",
    "strings.tighten_strings over pulleys",
    "strings.add_string_forces over pulleys",
    by="the acceleration of Atwood's machine",
)
@pytest.mark.parametrize("engine", FIXED)
def test_atwoods_machine_accelerates_as_its_closed_form_says(engine: str) -> None:
    """With the tension 2 m M g / (m + M) at the start, the string keeps its length and both masses a constant
    acceleration g (M - m) / (m + M), which RK4 integrates exactly: what is left is round-off of 1000 steps.
    """
    run = tmj.simulate(atwood(), None, FIXED[engine](1e-3), duration=0.5, output_interval=0.05)
    fall = 0.5 * G * (1.5 - 1.0) / 2.5 * run.time**2
    np.testing.assert_allclose(run.nodes[:, 0, 2], -1.0 + fall, atol=1e-12)
    np.testing.assert_allclose(run.nodes[:, 3, 2], -0.8 - fall, atol=1e-12)
    np.testing.assert_allclose(run.tensions[:, 0], 2 * 1.0 * 1.5 / 2.5 * G, atol=1e-9)


@pytest.mark.third_means(
    "strings.measure_segments", "strings.add_string_forces over pulleys", by="the elastic mode of Atwood's machine"
)
@pytest.mark.parametrize("engine", FIXED)
def test_its_elastic_mode_is_an_oscillator(engine: str) -> None:
    """ë = -k (1/m + 1/M) e of the stretch e beyond that of the steady motion: e = e0 cos(ω t).

    RK4's local error of it is (ω h)⁵/120 of the amplitude 5 mm: over n steps n times that, at z = 40.8 · 1e-3.
    """
    run = tmj.simulate(atwood(stretch=5e-3), None, FIXED[engine](1e-3), duration=0.5, output_interval=0.01)
    omega = math.sqrt(1000.0 * (1 / 1.0 + 1 / 1.5))
    tension = 2 * 1.0 * 1.5 / 2.5 * G + 1000.0 * 5e-3 * np.cos(omega * run.time)
    error = 500 * (omega * 1e-3) ** 5 / 120 * 5e-3
    np.testing.assert_allclose(run.tensions[:, 0], tension, atol=1000.0 * error * 1.1)


@pytest.mark.third_means(
    "strings.measure_segments", "strings.tighten_strings over pulleys", by="what the damper of Atwood's machine takes"
)
@pytest.mark.parametrize("engine", [*FIXED, "dae, adaptive"])
def test_its_damper_takes_what_the_closed_form_says(engine: str) -> None:
    """ë + c/μ ė + k/μ e = 0: e = e0 e^(-δ t) (cos νt + δ/ν sin νt); the loss is ∫ c ė² dt, by quadrature of that."""
    c, mu, k, e0 = 12.0, 1.0 * 1.5 / 2.5, 1000.0, 4e-3
    step = 5e-4
    chosen = tmj.DAE(rtol=1e-11, atol=1e-13) if engine not in FIXED else FIXED[engine](step)
    run = tmj.simulate(atwood(stretch=e0, damping=c), None, chosen, duration=0.5, output_interval=0.05)
    delta = c / (2 * mu)
    nu = math.sqrt(k / mu - delta**2)
    t = np.linspace(0.0, 0.5, 200001)
    rate = -e0 * np.exp(-delta * t) * (delta**2 / nu + nu) * np.sin(nu * t)
    lost = np.concatenate([[0.0], np.cumsum(0.5 * c * (rate[1:] ** 2 + rate[:-1] ** 2) * np.diff(t))])
    at = np.searchsorted(t, run.time - 1e-9)
    # RK4: 1000 steps of (ω h)⁵/120 relative, ω = 40.8; the trapezoids: (2 ν dt)²/12 relative; both below 1e-7.
    np.testing.assert_allclose(run.dissipation, lost[at], atol=1e-7 * lost[-1])
    assert run.energy_residual < 1e-6 * lost[-1]


@pytest.mark.parametrize("scene", [ringed, threaded], ids=["class 1", "class k"])
def test_engines_agree_at_the_order_of_the_method(scene) -> None:  # type: ignore[no-untyped-def]
    exact = tmj.simulate(scene(), None, tmj.DAE(rtol=1e-12, atol=1e-13), duration=0.4, output_interval=0.02)
    for name, engine in FIXED.items():
        if name == "ode" and scene is threaded:
            continue
        errors = [
            tmj.compare(
                tmj.simulate(scene(), None, engine(step), duration=0.4, output_interval=0.02), exact
            ).max_node_error
            for step in (1e-3, 5e-4)
        ]
        print(name, errors)
        # Of order 4, but for half an order of the terms beyond; the reference's tolerance leaves some 1e-11 m.
        assert errors[1] <= max(errors[0] / 2**3.5, 2e-11)
        assert errors[1] < 1e-8


def test_a_ring_is_three_strings_as_long_as_the_prism_is_symmetric() -> None:
    """The same forces, so the same motion: both runs round, and add up what they round over 400 steps."""
    one = tmj.simulate(ringed(turning=False), None, tmj.MuJoCo(1e-3), duration=0.4, output_interval=0.02)
    three = tmj.simulate(ringed(rings=False, turning=False), None, tmj.MuJoCo(1e-3), duration=0.4, output_interval=0.02)
    np.testing.assert_allclose(one.nodes, three.nodes, atol=1e-12)
    np.testing.assert_allclose(one.tensions[:, 3], three.tensions[:, 3], atol=1e-9)
    assert np.ptp(one.nodes[:, 0, 0]) > 1e-3  # it does move


def test_a_string_that_falls_slack_pulls_again_as_located() -> None:
    """A mass that is thrown up from its sling flies free, and falls back into it: events are located in all engines."""
    scene = slung()
    up = np.zeros((3, 3))
    up[1] = (0.1, 0.0, 1.5)
    scene = scene.with_(initial_velocities=up)
    runs = [
        tmj.simulate(scene, None, engine, duration=1.0, output_interval=0.02)
        for engine in (
            tmj.DAE(rtol=1e-11, atol=1e-13),
            tmj.MuJoCo(1e-3, locate_slack=True),
            tmj.DAE(method=tmj.Method.RK4, timestep=1e-3, locate_slack=True),
        )
    ]
    assert (runs[0].tensions == 0).any()
    assert (runs[0].tensions > 0).any()
    for run in runs[1:]:
        # Between events RK4 errs by n (ω h)⁵/120 of 0.1 m, ω = 60 /s of the stiffest motion; an event adds h² ε.
        assert tmj.compare(run, runs[0]).max_node_error < 1000 * (60 * 1e-3) ** 5 / 120 * 0.1


def test_it_costs_what_its_segments_cost() -> None:
    """Arrays of the compiled code are as long as the segments are many: no string is padded to the longest path."""
    from tensegrity_mj.dynamics.native.law import native_law
    from tensegrity_mj.dynamics.native.plant import Plant
    from tensegrity_mj.model.actuation import Actuation, OnInfeasible

    scene = ringed()
    plant = Plant(scene, native_law(None, scene.structure), Actuation.continuous(), OnInfeasible.STOP)
    assert plant["segments"].shape == (3 + 3 + 3, 2)
    assert plant["ranges"].tolist() == [[0, 1], [1, 2], [2, 3], [3, 6], [6, 9]]
