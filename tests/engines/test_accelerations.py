"""`tmj.accelerations`: closed forms, the engines against each other, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.model import Break, Load, Motion

EPS = np.finfo(float).eps
ENGINES = ("mujoco", "dae", "ode")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_thrown_rod_falls_and_its_ends_turn_around_its_centre(engine: str) -> None:
    """g - omega² b / 2 at each end, of numbers below 10, in some ten operations each: 100 eps of their sum."""
    rod = tmj.Rod("rod", ("a", "b"), 1.3)
    scene = tmj.Scene(tmj.Structure("rod", {"a": (0.0, 0.0, 0.0), "b": (0.9, 0.0, 1.2)}, (rod,)), gravity=(0, 0, -9.81))
    b, spin = np.array([0.9, 0.0, 1.2]), np.array([0.0, 2.0, 0.0])
    velocities = [[1.0, 2.0, 3.0], np.array([1.0, 2.0, 3.0]) + np.cross(spin, b)]
    found = tmj.accelerations(scene, None, engine, velocities=velocities)
    expected = [[0, 0, -9.81] + 0.5 * 4.0 * b, [0, 0, -9.81] - 0.5 * 4.0 * b]
    np.testing.assert_allclose(found, expected, rtol=0, atol=100 * EPS * (9.81 + 4.0 * 1.5))


def oscillator(**more: Any) -> tmj.Scene:
    structure = tmj.Structure(
        "mass",
        {"top": (0.0, 0.0, 1.0), "p": (0.0, 0.0, 0.0), "side": (2.0, 0.0, 0.0)},
        point_masses=[tmj.PointMass("p", 0.7)],
        strings=[
            tmj.String("s", ("top", "p"), 300.0, 0.5, rest_length=0.9),
            tmj.String("t", ("side", "p"), 100.0, 0.0, rest_length=1.9),
        ],
        fixed_nodes=("top", "side"),
    )
    return tmj.Scene(structure, gravity=(0.0, 0.0, -9.81), **more)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_mass_on_strings_at_a_state_and_a_time(engine: str) -> None:
    """M a = M g + k s + c ds/dt + F cos(w t), the hook at d(t), the other string broken by then: some twenty operations
    of forces below 100 N on 0.7 kg."""
    t, F, w = 1.7, 5.0, 3.0
    scene = oscillator(
        motions=(Motion.in_line("top", 0.1, 0.8, (0, 0, 1)),),
        loads=(Load("p", (F, 0.0, 0.0), w),),
        breaks=(Break("t", 1.0),),
    )
    place, rate, change = scene.motions[0].at(t)
    nodes, velocities = scene.nodes0.copy(), np.zeros((3, 3))
    nodes[0, 2], velocities[0, 2], velocities[1, 2] = 1.0 + place[2], rate[2], 0.4
    found = tmj.accelerations(scene, None, engine, nodes=nodes, velocities=velocities, time=t)
    pull = 300.0 * (0.1 + place[2]) + 0.5 * (rate[2] - 0.4)
    expected = [F * np.cos(w * t) / 0.7, 0.0, pull / 0.7 - 9.81]
    np.testing.assert_allclose(found[1], expected, rtol=0, atol=100 * EPS * 100 / 0.7)
    # In MuJoCo what drives a support has 1e14 times the mass.
    np.testing.assert_allclose(found[0], change, rtol=0, atol=100 * EPS * np.abs(change).max() + 1e-14 * 100 / 0.7)
    # By default all is at the start of the scene, and rest lengths can be set.
    late = scene.with_(start_time=t, initial_nodes=nodes, initial_velocities=velocities)
    np.testing.assert_array_equal(tmj.accelerations(late, None, engine), found)
    longer = tmj.accelerations(late, None, engine, rest_lengths=[0.95, 1.9])
    np.testing.assert_allclose((found - longer)[1], [0, 0, 300 * 0.05 / 0.7], rtol=0, atol=200 * EPS * 100 / 0.7)


def test_engines_agree_under_a_law_and_wind() -> None:
    """At most 1e3 N on ends of 0.1 kg; matrices of joints and masses have condition numbers below 1e3 here."""
    scene = tmj.load_scene("prism").with_(resistance=tmj.Resistance(viscous=0.3, wind=(2.0, 1.0, 0.0)))
    one, *others = (tmj.accelerations(scene, "lyapunov", engine, time=0.3) for engine in ENGINES)
    assert one.shape == (6, 3)
    assert np.abs(one - tmj.accelerations(scene, None)).max() > 1e-3  # the law acts
    for other in others:
        np.testing.assert_allclose(other, one, rtol=0, atol=1e3 * 10 * EPS * 1e3 / 0.1)


def test_wrong_states_are_refused_by_name() -> None:
    scene = oscillator()
    with pytest.raises(SceneError, match="initial_nodes: fixed node 'top' is 1 m from its place"):
        tmj.accelerations(scene, nodes=scene.nodes0 + np.array([0.0, 0.0, 1.0]))
    with pytest.raises(SceneError, match=r"initial_velocities.*\(3, 3\)"):
        tmj.accelerations(scene, velocities=np.zeros((2, 3)))
    with pytest.raises(SceneError, match="start_time = -1"):
        tmj.accelerations(scene, time=-1)
    with pytest.raises(OptionError, match=r"rest_lengths.*\(2,\)"):
        tmj.accelerations(scene, rest_lengths=[1.0])
    with pytest.raises(OptionError, match="rest_lengths and controller: the law sets the rest lengths"):
        tmj.accelerations("prism", "lyapunov", rest_lengths=np.ones(12))
    with pytest.raises(OptionError, match="use a Scene"):
        tmj.accelerations(scene.structure)  # type: ignore[arg-type]


def test_a_run_says_what_an_evaluation_costs() -> None:
    run = tmj.simulate(oscillator(), None, timestep=1e-3, duration=0.01)
    assert run.seconds_per_evaluation == run.cost["wall_time"] / 40
    assert np.isnan(tmj.Trajectory.seconds_per_evaluation.fget(run.__class__(**{**vars(run), "cost": {}})))  # type: ignore[attr-defined]
