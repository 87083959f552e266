"""Replay: what one engine did, done to the other, open loop."""

from __future__ import annotations

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Replay, from_scene

TIGHT = tmj.DAE(rtol=1e-12, atol=1e-13)


def test_recorded_rest_lengths_of_a_winch_reproduce_the_run_in_the_other_engine(prism, tmp_path):
    actuation = tmj.Actuation.hold_rest_length(1e-2)
    run = tmj.simulate(prism, from_scene(prism), tmj.MuJoCo(1e-3), duration=4.0, actuation=actuation)
    law = Replay.of_run(tmj.Trajectory.load(run.save(tmp_path / "run.nc")))
    replayed = tmj.simulate(prism, law, TIGHT, duration=4.0, actuation=actuation)
    error = tmj.compare(run, replayed).max_node_error
    print(f"prism, 4 s, L0(t) held 10 ms, MuJoCo RK4 1 ms replayed in the DAE: {error:.1e} m")
    # MuJoCo's own truncation at 1 ms, with strings that go slack within a step.
    assert 0 < error <= 1e-8


def test_recorded_rest_lengths_of_a_continuous_run(prism):
    """L0(t) recorded each half millisecond, splined, and played to both engines: no law can hide a plant's error."""
    run = tmj.simulate(prism, from_scene(prism), tmj.MuJoCo(5e-4), duration=2.0, output_interval=5e-4)
    law = Replay.of_run(run)
    other = tmj.simulate(prism, law, TIGHT, duration=2.0, output_interval=5e-4)
    same = tmj.simulate(prism, law, tmj.MuJoCo(5e-4), duration=2.0, output_interval=5e-4)
    between, against_run = tmj.compare(same, other).max_node_error, tmj.compare(run, other).max_node_error
    print(f"prism, 2 s, L0(t) continuous: engines {between:.1e} m, against the recorded run {against_run:.1e} m")
    # Strings that do not pull sit at L0 = L, where the spline's wiggle makes them slack or taut: order 2 at 0.5 ms.
    assert between <= 1e-8
    assert against_run <= 1e-8


def test_recorded_force_densities(prism):
    actuation = tmj.Actuation.hold_force_density(1e-2)
    run = tmj.simulate(prism, from_scene(prism), TIGHT, duration=2.0, actuation=actuation)
    replayed = tmj.simulate(
        prism, Replay.of_run(run, tmj.Command.FORCE_DENSITY), tmj.MuJoCo(1e-3), duration=2.0, actuation=actuation
    )
    assert tmj.compare(run, replayed).max_node_error <= 1e-10  # smooth between samples: RK4's truncation


def test_a_held_replay_is_refused_continuously_and_one_that_was_recorded_too_coarsely(prism):
    actuation = tmj.Actuation.hold_rest_length(5e-3)
    coarse = tmj.simulate(prism, from_scene(prism), tmj.MuJoCo(5e-3), duration=0.1, actuation=actuation)
    with pytest.raises(tmj.errors.OptionError, match=r"output_interval = 0\.005"):
        Replay.of_run(coarse)
    options = {"duration": 0.1, "actuation": actuation, "output_interval": 5e-3}
    fine = tmj.simulate(prism, from_scene(prism), tmj.MuJoCo(5e-3), **options)
    with pytest.raises(tmj.errors.OptionError, match="sampled"):
        tmj.simulate(prism, Replay.of_run(fine), tmj.MuJoCo(5e-3), duration=0.1)


def test_the_compiled_replay_equals_its_python_call(prism):
    times = np.array([0.0, 0.1, 0.25, 0.4])
    values = np.random.default_rng(0).uniform(0.5, 1.0, (4, 12))
    for held, actuation in ((False, tmj.Actuation.continuous()), (True, tmj.Actuation.hold_rest_length(0.05))):
        law = Replay(times, values, held=held)
        run = tmj.simulate(prism, law, tmj.MuJoCo(1e-2), duration=0.5, actuation=actuation, output_interval=0.05)
        expected = np.array([law(t, None, None) for t in run.time])
        assert run.rest_lengths == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize(
    ("times", "values", "words"),
    [
        ([0.0, 0.0], np.ones((2, 12)), "increase"),
        ([0.0], np.ones((1, 12)), "T >= 2"),
        ([0.0, 1.0], np.ones((3, 12)), "shape"),
        ([0.0, 1.0], np.full((2, 12), np.nan), "nan"),
        ([0.0, np.inf], np.ones((2, 12)), "finite"),
    ],
)
def test_bad_recordings_are_refused(times, values, words):
    with pytest.raises(tmj.errors.OptionError, match=words):
        Replay(times, values)


def test_a_replay_for_another_structure_is_refused(prism):
    with pytest.raises(tmj.errors.OptionError, match="values for 3 strings"):
        tmj.simulate(prism, Replay([0.0, 1.0], np.ones((2, 3))), tmj.MuJoCo(1e-2))


def test_a_recording_is_replayed_as_it_was_made(prism):
    actuation = tmj.Actuation.hold_force_density(1e-2)
    options = {"duration": 0.2, "actuation": actuation}
    run = tmj.simulate(prism, from_scene(prism), tmj.MuJoCo(1e-2), **options)
    with pytest.raises(tmj.errors.OptionError, match=r"Command\.FORCE_DENSITY"):
        Replay.of_run(run)
    law = Replay.of_run(run, tmj.Command.FORCE_DENSITY)
    with pytest.raises(tmj.errors.OptionError, match=r"0\.01 s"):
        tmj.simulate(prism, law, tmj.MuJoCo(1e-2), duration=0.2, actuation=tmj.Actuation.hold_force_density(2e-2))
    longer = tmj.simulate(prism, law, tmj.MuJoCo(1e-2), duration=0.4, actuation=actuation)
    assert any("recording ends at 0.2 s" in warning for warning in longer.reports["warnings"])


def test_a_splined_recording_reports_its_own_error():
    times = np.linspace(0, 1, 41)
    law = Replay(times, np.sin(10 * times)[:, None] + 2)
    fine = np.linspace(0, 1, 4001)
    error = max(abs(law(t, None, None)[0] - np.sin(10 * t) - 2) for t in fine)
    # A spline through every second sample errs 16 times as much: an upper estimate, and not a wild one.
    assert error <= law.interpolation_error() <= 100 * error
