"""Tasks for learning: an episode is a run of `simulate`, many are one by one, draws keep bounds, errors are stated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Replay
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.studies import Choice, Draw, Uniform
from tensegrity_mj.studies.tasks import Task, World, gait, measured_error, task_of
from tensegrity_mj.studies.tasks.robots import TASKS

ONE = np.zeros(1, np.int64)


def played(world: World, actions: Any, seed: int = 0) -> list[Any]:
    """The states of an episode of the first robot."""
    world.start(ONE, [np.random.default_rng(seed)])
    states = [world.state(ONE)]
    for action in actions:
        world.step(ONE, action[None])
        states.append(world.state(ONE))
    return states


def random_actions(task: Task, steps: int, seed: int = 5) -> Any:
    return np.random.default_rng(seed).uniform(-1, 1, (steps, len(task.low)))


@pytest.mark.parametrize("name", TASKS)
def test_an_episode_is_the_run_of_held_rest_lengths_to_the_bit(name: str) -> None:
    """The run starts where the task's own scene does: the same qpos, and so the same bits; velocities are equal to the
    roundings of their cross products, of at most 10 m/s: 10 · 4 · 2.2e-16 = 9e-15 m/s."""
    task = replace(task_of(name), start=None)
    actions = random_actions(task, 20)
    world = World(task)
    states = played(world, actions)
    lengths = task.low + 0.5 * (actions + 1) * (task.high - task.low)
    times = np.arange(21) * task.period
    run = tmj.simulate(
        task.scene,
        Replay(times, [*lengths, lengths[-1]], held=True, period=task.period),
        task.engine,
        duration=float(times[-1]),
        actuation=tmj.Actuation.hold_rest_length(task.period),
        output_interval=task.period,
    )
    np.testing.assert_array_equal([state.nodes[0] for state in states], run.nodes)
    np.testing.assert_allclose([state.velocities[0] for state in states], run.velocities, rtol=0, atol=1e-14)
    # A row has the rest lengths from its time on, a state those until then.
    np.testing.assert_allclose([state.rest_lengths[0] for state in states[1:]], run.rest_lengths[:-1], rtol=0, atol=0)
    # T = k (L - L0) + c L' where taut, from the run's own nodes: roundings of 1 kN at most, 1e3 · 10 · 2.2e-16 N.
    structure = task.scene.structure
    i, j = np.array([[structure.node_index[node] for node in one.nodes] for one in structure.strings]).T
    span, rate = run.nodes[1:, i] - run.nodes[1:, j], run.velocities[1:, i] - run.velocities[1:, j]
    L = np.linalg.norm(span, axis=2)
    stretch = L - run.rest_lengths[:-1]
    pull = np.maximum(0, structure.stiffness * stretch + structure.damping * np.sum(span * rate, axis=2) / L)
    tensions = np.array([state.tensions[0] for state in states[1:]])
    np.testing.assert_allclose(tensions, np.where(stretch > 0, pull, 0), rtol=0, atol=2e-12)


def test_many_robots_are_one_by_one_whoever_starts_when() -> None:
    """Robot 2 starts anew while the others go on; each does what it would do alone."""
    draws = [
        Draw("structure.rods[*].mass", Uniform(0.8, 1.2), scaled=True),
        Draw("scene.contact.friction", Uniform(0.4, 0.8)),
        Draw("delay", Choice([0, 1, 2])),
        Draw("noise.position", Uniform(0.0, 0.01)),
        Draw("noise.velocity", Uniform(0.0, 0.01)),
    ]
    world, ids = World("SixBarRoll", 3, draws=draws, threads=2), np.arange(3)
    actions = np.random.default_rng(1).uniform(-1, 1, (8, 3, 24))
    generators = [np.random.default_rng(7 + i) for i in ids]
    seen = [world.start(ids, generators)]
    for step in range(8):
        if step == 4:
            fresh = world.start(ids[2:], generators[2:])
        seen.append(world.step(ids, actions[step]).observation)
    for number in ids:
        alone, generator = World("SixBarRoll", 1, draws=draws), np.random.default_rng(7 + number)
        np.testing.assert_array_equal(alone.start(ONE, [generator])[0], seen[0][number])
        for step in range(8):
            if step == 4 and number == 2:
                np.testing.assert_array_equal(alone.start(ONE, [generator]), fresh)
            out = alone.step(ONE, actions[step, number][None])
            np.testing.assert_array_equal(out.observation[0], seen[step + 1][number])


def test_draws_keep_their_bounds_and_reach_the_model() -> None:
    draws = [
        Draw("structure.strings.stiffness", Uniform(900.0, 1100.0)),
        Draw("structure.rods[*].mass", Uniform(0.5, 1.5), scaled=True),
        Draw("delay", Choice([0, 2])),
    ]
    world = World("SixBarRoll", 1, draws=draws, parameters={"scene.contact.friction": 0.9, "noise.position": 1e-3})
    found = [world.variations.draw(np.random.default_rng(seed)) for seed in range(40)]
    stiffness = np.array([one.scene.structure.stiffness for one in found])
    masses = np.array([[rod.mass for rod in one.scene.structure.rods] for one in found])
    assert np.all((stiffness >= 900) & (stiffness <= 1100))
    assert np.ptp(stiffness[:, 0]) > 100
    assert np.all((masses >= 0.1) & (masses <= 0.3))
    assert np.all(np.ptp(masses, axis=1) > 0)
    assert {one.delay for one in found} == {0, 2}
    assert {one.position_noise for one in found} == {1e-3}
    world.start(ONE, [np.random.default_rng(3)])
    model, scene = world.fleet.batch.models[0], world.variations.draw(np.random.default_rng(3)).scene
    assert scene.contact is not None
    assert scene.contact.friction == 0.9
    assert model.body_mass.sum() == pytest.approx(sum(rod.mass for rod in scene.structure.rods), rel=1e-12)
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], scene.structure.stiffness)


def test_a_delay_holds_commands_back_and_speeds_add_up() -> None:
    task = task_of("PrismReach")
    actions = random_actions(task, 6)
    now, late = (World(task, parameters={"delay": delay}) for delay in (0, 2))
    lengths = [np.array([state.rest_lengths[0] for state in played(world, actions)]) for world in (now, late)]
    designed = task.scene.structure.rest_lengths
    np.testing.assert_array_equal(lengths[1][:3], [designed] * 3)  # the first command comes after two periods
    assert np.abs(lengths[1][3:] - designed).max() > 0
    # Winches of 0.2 m/s, for 6 periods of 40 ms: 8 mm each; the limits are farther away. Roundings of 0.3 m.
    speeds = played(World(task, action="speed"), np.full((6, len(task.low)), 0.5))
    np.testing.assert_allclose(speeds[-1].rest_lengths[0] - designed, 6 * 0.5 * 0.2 * 0.04, rtol=0, atol=1e-15)


def test_limits_of_winches_are_kept() -> None:
    task = task_of("SixBarRoll")
    states = played(World(task), np.where(random_actions(task, 10) > 0, 1.0, -1.0))
    moved = np.abs(np.diff([state.rest_lengths[0] for state in states], axis=0))
    assert moved.max() == pytest.approx(0.3 * 0.1, rel=1e-12)


def test_the_sensors_feel_gravity_at_rest_and_turn_with_the_rod() -> None:
    """At rest a - g is g upwards; the mean acceleration is the difference of velocities that are known."""
    task = replace(task_of("PrismReach"), start=None)
    world = World(task)
    before, after = played(world, np.zeros((1, 6)))
    imu = {"imu": task.observe(before)["imu"], "moved": task.observe(after)["imu"]}
    assert imu["imu"].shape == (1, 3, 9)
    np.testing.assert_array_equal(imu["imu"][0, :, 6:], [[0.0, 0.0, 9.81]] * 3)
    pairs = task.scene.structure.rod_nodes
    middle = after.velocities[0][pairs].mean(axis=1) / task.period  # it began at rest
    np.testing.assert_allclose(imu["moved"][0, :, 6:] - [0, 0, 9.81], middle, rtol=0, atol=1e-12)
    along, turning = imu["moved"][0, :, :3], imu["moved"][0, :, 3:6]
    rate = after.velocities[0][pairs[:, 1]] - after.velocities[0][pairs[:, 0]]
    np.testing.assert_allclose(np.cross(turning, along) * 0.5, rate, rtol=0, atol=1e-12)  # rods of 0.5 m


@pytest.mark.parametrize("name", ["PrismReach", "SpineReach"])
def test_the_stated_error_is_the_measured_one(name: str) -> None:
    """Two digits are stated. Round-off, 1e-16 of each step, is 1e-8 of these errors."""
    found, stated = measured_error(name), task_of(name).measured_error
    for key in ("largest", "mean", "after_1_s"):
        assert found[key] == pytest.approx(stated[key], rel=0.06)


def test_the_stated_error_of_the_gait_is_the_measured_one_and_it_rolls_forward() -> None:
    """What is measured is 1e9 round-offs or more; the reference's own error is (1/16)⁴ of it where nothing lands."""
    task = task_of("SixBarRoll")
    actions = gait(task)
    assert np.abs(actions).max() <= 1 + 1e-12
    found = measured_error(task, 2, actions=actions)
    assert found["largest"] == pytest.approx(task.measured_error["gait"], rel=0.06)
    states = played(World(task), actions)
    assert 0.9 < (states[-1].nodes - states[0].nodes)[0, :, 0].mean() < 1.0
    short = measured_error(task, 3, 10)
    assert short["after_1_s"] == pytest.approx(task.measured_error["after_1_s"], rel=0.06)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "SixBarRol"}, "task: .*SixBarRoll"),
        ({"task": 3}, "task = 3; use a Task"),
        ({"action": "torque"}, "action: .*length"),
        ({"count": 0}, "number of robots"),
        ({"draws": [3]}, "draws holds 3"),
        ({"draws": [Draw("law.gain", Uniform(0, 1))]}, "parameter 'law.gain': .*structure"),
        ({"draws": [Draw("engine.timestep", Uniform(0, 1))]}, "parameter 'engine.timestep'"),
        ({"parameters": {"delay": 0.5}}, "delay = 0.5; it must be a whole number"),
        ({"parameters": {"noise.position": -1.0}}, "noise.position = -1; it must be a number >= 0"),
        ({"parameters": {"delay": 1}, "draws": [Draw("delay", Choice([1]))]}, "delay: it is given twice"),
        ({"parameters": {"structure.rods.weight": 1.0}}, "structure.rods.weight: .*mass"),
        ({"parameters": {"engine.timestep": 3e-3}}, "control period over the time step"),
        ({"parameters": {"structure.strings.winch_speed": None}, "action": "speed"}, "winch_speed"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        World(**({"task": "SixBarRoll"} | options))


def test_a_draw_that_makes_another_layout_is_refused_and_actions_are_checked() -> None:
    world = World("PrismReach")
    world.start(ONE, [np.random.default_rng(0)])
    with pytest.raises(ControllerError, match="it must be 6 finite numbers, one for each of the strings top1"):
        world.step(ONE, np.zeros((1, 5)))
    with pytest.raises(ControllerError, match="finite"):
        world.step(ONE, np.full((1, 6), np.nan))
    with pytest.raises(OptionError, match="built otherwise"):
        world.fleet.start(0, tmj.load_scene("prism"))


def test_a_robot_that_diverges_ends_its_episode_and_may_start_again() -> None:
    world = World("PrismReach", parameters={"engine.timestep": 0.04})
    world.start(ONE, [np.random.default_rng(0)])
    for _ in range(50):
        out = world.step(ONE, np.ones((1, 6)))
        if out.diverged[0]:
            break
    assert out.diverged[0]
    assert out.reward[0] == 0
    assert np.isfinite(out.observation).all()
    assert np.isfinite(world.start(ONE, [np.random.default_rng(0)])).all()
    assert np.abs(world.state().nodes).max() < 1
