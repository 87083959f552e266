"""Strings with mass in motion: engines agree, their ledgers close, and a rope reports itself as a whole."""

from __future__ import annotations

import re

import numpy as np
import pytest
from rope_scenes import mast, rope

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model import Break

FIXED = {
    "mujoco": lambda step: tmj.MuJoCo(timestep=step),
    "dae": lambda step: tmj.DAE(method=tmj.Method.RK4, timestep=step),
    "ode": lambda step: tmj.ODE(method=tmj.Method.RK4, timestep=step),
}


def runs(scene: tmj.Scene, engine: str) -> list[tmj.Trajectory]:
    return [
        tmj.simulate(scene, None, FIXED[engine](step), duration=0.5, output_interval=0.02) for step in (5e-4, 2.5e-4)
    ]


@pytest.mark.parametrize("engine", FIXED)
def test_engines_agree_at_the_order_of_the_method(engine: str) -> None:
    """Of order 4, but for half an order of the terms beyond; the reference's tolerance leaves some 1e-11 m."""
    scene = mast()
    exact = tmj.simulate(scene, None, tmj.DAE(rtol=1e-12, atol=1e-13), duration=0.5, output_interval=0.02)
    assert np.min(exact.tensions) > 0
    found = runs(scene, engine)
    errors = [tmj.compare(run, exact).max_node_error for run in found]
    ledger = [run.energy_residual for run in found]
    print(errors, ledger)
    assert errors[1] <= max(errors[0] / 2**3.5, 2e-11)
    assert errors[1] < 1e-8
    assert ledger[1] <= max(ledger[0] / 2**3.5, 2e-10)


@pytest.mark.parametrize("engine", FIXED)
def test_a_plucked_rope_swings_in_its_mode(engine: str) -> None:
    """x_i = A sin(π(i - ½)/n) cos(ω t) of its points, ω = (2n/L) √(T/μ) sin(π/2n), for an amplitude that is small.

    Stretch by the slope s adds k L s²/4 to T = 50 N, s² = (π A/L)²/2 in the mean: 3e-12 of the frequency for A = 1e-7
    m, and over 12 rad as much of the phase. RK4 errs by (ω h)⁴/120 of the phase, 1e-9 here.
    """
    n, A = 6, 1e-7
    scene = rope(n, tension=50.0)
    start = np.array(scene.nodes0)
    shape = np.sin(np.pi * (np.arange(n) + 0.5) / n)
    start[2:, 2] = A * shape
    run = tmj.simulate(scene.with_(initial_nodes=start), None, FIXED[engine](5e-4), duration=0.5, output_interval=0.01)
    omega = 2 * n / 2.0 * np.sqrt(50.0 / 0.2) * np.sin(np.pi / (2 * n))
    np.testing.assert_allclose(run.nodes[:, 2:, 2], A * np.cos(omega * run.time)[:, None] * shape, atol=1e-7 * A)


def test_a_rope_reports_itself_as_a_whole() -> None:
    """Where all its parts are taut, Σ φ_i (k/φ_i) (L_i - φ_i L0) = k (L - L0), and so for its damper."""
    scene = mast()
    run = tmj.simulate(scene, None, FIXED["dae"](5e-4), duration=0.2, output_interval=0.01)
    parts = np.linalg.norm(np.diff(run.nodes[:, [1, 5, 6, 7, 8, 2]], axis=1), axis=-1)
    length = parts.sum(axis=1)
    np.testing.assert_allclose(run.length("s1"), length, rtol=1e-14)
    np.testing.assert_allclose(run.rest_length("s1"), 0.95, rtol=1e-14)
    rate = scene.structure.string_rates(run.nodes, run.velocities)[:, 1:6].sum(axis=1)
    np.testing.assert_allclose(run.tension("s1"), 400.0 * (length - 0.95) + 0.5 * rate, rtol=1e-11)
    np.testing.assert_array_equal(run.tension("s1.3"), run.tensions[:, 3])
    np.testing.assert_array_equal(run.tension("s2"), run.tensions[:, 6])
    with pytest.raises(OptionError, match=re.escape("s1.6")):
        run.tension("s1.6")


def test_a_run_is_kept_with_its_ropes(tmp_path) -> None:  # type: ignore[no-untyped-def]
    run = tmj.simulate(mast(), None, FIXED["dae"](5e-4), duration=0.02, output_interval=0.01)
    again = tmj.Trajectory.load(run.save(tmp_path / "run.nc"))
    assert again.scene.structure == run.scene.structure
    np.testing.assert_array_equal(again.tension("s1"), run.tension("s1"))


@pytest.mark.parametrize("engine", FIXED)
def test_a_broken_rope_hangs_from_its_other_end(engine: str) -> None:
    scene = mast().with_(breaks=(Break("s1", 0.1),))
    run = tmj.simulate(scene, None, FIXED[engine](5e-4), duration=0.3, output_interval=0.01)
    assert run.tensions[9, 1] > 50.0
    assert not run.tensions[10:, 1].any()
    # Parts go slack and taut within steps: of each as much as ½ k (v h)², k = 1600 N/m, at 0.01 m a step of 5e-4 s.
    assert np.abs(np.diff(run.nodes, axis=0)).max() / 0.01 < 20.0
    assert run.energy_residual < 0.5 * 1600.0 * 0.01**2


def test_a_rope_without_segments_to_spare_is_a_light_string_and_a_mass() -> None:
    """Written by hand: a point mass in the middle, and strings of half the rest length and twice the stiffness."""
    scene = mast(segments=1)
    structure = scene.structure
    nodes = {name: structure.nodes[name] for name in structure.massless.nodes} | {"m": (0.55, 0.0, 0.6)}
    s0, _, s2 = structure.given.strings
    parts = (tmj.String("p", ("tip", "m"), 800.0, 1.0, 0.475), tmj.String("q", ("m", "a"), 800.0, 1.0, 0.475))
    mass = (tmj.PointMass("m", 0.2),)
    by_hand = tmj.Structure("mast", nodes, structure.rods, (s0, *parts, s2), structure.fixed_nodes, mass)
    one, other = (
        tmj.simulate(scene.with_(structure=of), None, FIXED["mujoco"](5e-4), duration=0.2)
        for of in (structure, by_hand)
    )
    np.testing.assert_allclose(one.nodes, other.nodes, atol=1e-13)
