"""Tasks for learning: an episode is a run of `simulate`, many are one by one, draws keep bounds, errors are stated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from linked_scenes import random_tree

import tensegrity_mj as tmj
from tensegrity_mj.controllers import Replay
from tensegrity_mj.engines.mujoco.contact import bodies_of, spins
from tensegrity_mj.engines.mujoco.prepared import prepared, within
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.learning.tasks import Goal, RandomStart, Task, World, gait, measured_error, task_of
from tensegrity_mj.learning.tasks.definition import displace, node_states
from tensegrity_mj.learning.tasks.robots import TASKS
from tensegrity_mj.studies import Choice, Draw, Uniform

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


@pytest.mark.parametrize("action", ["length", "speed"])
def test_what_is_beyond_the_limits_of_an_action_is_taken_for_the_limit(action: str) -> None:
    """Winches are no faster, and strings neither shorter nor longer, than they may be."""
    task = task_of("PrismReach")
    signs = np.where(random_actions(task, 6) > 0, 1.0, -1.0)
    within, beyond = (played(World(task, action=action), scale * signs) for scale in (1, 5))
    np.testing.assert_array_equal([one.rest_lengths for one in within], [one.rest_lengths for one in beyond])
    moved = np.abs(np.diff([one.rest_lengths[0] for one in beyond], axis=0))
    assert moved.max() == pytest.approx(0.2 * 0.04, rel=1e-12)  # winches of 0.2 m/s, periods of 40 ms
    far = played(World(task, action="speed"), np.full((40, 6), -5.0))  # 40 · 8 mm: farther than to the shortest
    np.testing.assert_array_equal(far[-1].rest_lengths[0], task.low)


def test_a_string_that_broke_has_no_tension() -> None:
    """It breaks after two periods, stretched; the others pull on, and a robot that starts anew has it whole."""
    scene = tmj.load_scene("prism")
    scene = scene.with_(breaks=(tmj.model.Break("s1", 0.2),), contact=None, control=None)
    short = 0.8 * scene.structure.rest_lengths
    task = Task(scene, rising, short, short, ("tensions",))
    world = World(task)
    states = played(world, np.zeros((5, 12)))
    assert all(state.tensions[0, 0] > 0 for state in states[:2])
    for state in states[3:]:
        assert state.lengths[0, 0] > state.rest_lengths[0, 0]
        assert state.tensions[0, 0] == task.observe(state)["tensions"][0, 0] == 0
        assert state.tensions[0, 1:].max() > 0
    world.start(ONE, [np.random.default_rng(0)])
    assert world.step(ONE, np.zeros((1, 12))).observation[0, 0] > 0


def test_tensions_are_those_of_what_was_drawn_and_of_the_string_law() -> None:
    """T = k (L - L0) + c L' with the episode's own k and c, L' by the run's own nodes; a damper does not push.

    Roundings of some hundred N: 1e2 · 10 · 2.2e-16 N, and of L' of a m/s times c.
    """
    scene = tmj.load_scene("prism").with_(contact=None, control=None)
    strings = tuple(replace(one, damping=200.0, tension=None) for one in scene.structure.strings)
    structure = replace(scene.structure, strings=strings)
    lengths = structure.rest_lengths
    task = Task(scene.with_(structure=structure), rising, 0.95 * lengths, 1.05 * lengths, ("tensions",), period=0.01)
    world = World(task, draws=[Draw("structure.strings.stiffness", Uniform(200.0, 900.0))])
    states = played(world, np.where(random_actions(task, 12) > 0, 1.0, -1.0))
    stiffness = world.fleet.batch.models[0].actuator_gainprm[:, 0]
    assert not np.isclose(stiffness, scene.structure.stiffness).all()
    i, j = structure.string_nodes.T
    found = []
    for state in states[1:]:
        span, rate = (part[0, i] - part[0, j] for part in (state.nodes, state.velocities))
        stretch = state.lengths[0] - state.rest_lengths[0]
        pull = stiffness * stretch + 200.0 * np.sum(span * rate, axis=1) / state.lengths[0]
        found.append(np.where(stretch > 0, pull, 0.0))
        np.testing.assert_allclose(state.tensions[0], np.maximum(found[-1], 0.0), rtol=0, atol=1e-9)
    assert np.min(found) < 0 < np.max(found)


def test_noise_is_of_what_it_says_and_as_large() -> None:
    """Of the nodes that move alone; a standard deviation of n numbers has one of its own of 1/√(2n): five of these."""
    task = replace(task_of("PrismReach"), observed=("nodes", "velocities"), start=None, goal=None, terms=rising)
    moving, still = task.moving, [row for row in range(6) if row not in task.moving]
    for part, other in (("nodes", "velocities"), ("velocities", "nodes")):
        world = World(task, parameters={{"nodes": "noise.position", "velocities": "noise.velocity"}[part]: 0.01})
        world.start(ONE, [np.random.default_rng(1)])
        off = []
        for _ in range(30):
            seen = world.step(ONE, np.zeros((1, 6))).observation[0]
            true = world.state(ONE)
            # What is seen is of single precision: 6e-8 of at most a metre, or of some m/s.
            np.testing.assert_allclose(seen[world.slices[other]], np.ravel(getattr(true, other)), rtol=1e-6, atol=1e-7)
            off.append(seen[world.slices[part]].reshape(6, 3) - getattr(true, part)[0])
        noise = np.array(off)
        np.testing.assert_allclose(noise[:, still], 0, rtol=0, atol=1e-7)
        count = noise[:, moving].size
        assert abs(noise[:, moving].std() / 0.01 - 1) < 5 / np.sqrt(2 * count)
        assert abs(noise[:, moving].mean()) < 5 * 0.01 / np.sqrt(count)


def test_random_starts_are_as_near_as_they_say() -> None:
    """A free rod, whose degrees of freedom are a shift and a turn of its frame: ends within both, and some near them.

    The frame stands at an end or between: an end is at most a length from it, so that a turn of three angles below θ
    moves it by √3 θ ℓ at most. Of 40 starts the largest of three numbers is beyond half, but for 2^-120.
    """
    rod = tmj.Rod("rod", ("a", "b"), 1.0)
    string = tmj.String("s", ("a", "f"), 10.0)
    nodes = {"a": (0.0, 0.0, 1.0), "b": (0.0, 0.0, 2.0), "f": (0.0, 0.0, 3.0)}
    scene = tmj.Scene(tmj.Structure("free", nodes, (rod,), (string,), ("f",)))
    shift, speed = 0.01, 0.3
    task = Task(scene, rising, 0.5, 2.5, ("nodes",), start=RandomStart(displacement=shift, speed=speed))  # type: ignore[arg-type]
    world, generator = World(task), np.random.default_rng(0)
    moved, faster = [], []
    for _ in range(40):
        world.start(ONE, [generator])
        state = world.state(ONE)
        moved.append(state.nodes[0, :2] - scene.nodes0[:2])
        faster.append(state.velocities[0, :2])
    for found, most in ((moved, shift), (faster, speed)):
        largest = np.linalg.norm(found, axis=2).max()
        assert 0.5 * most < largest < (np.sqrt(3) + np.sqrt(3)) * most
    lengths = [np.linalg.norm(one[0] - one[1] - [0, 0, 1]) for one in moved]
    np.testing.assert_allclose(lengths, 1.0, rtol=0, atol=1e-12)  # a rod keeps its length


def test_rods_that_hang_on_others_start_without_spin_where_they_were_drawn() -> None:
    """Nodes and their velocities are those of the draw in joints, but for roundings: a sum of 3 x 3 products along a
    chain of R rods within 3 m, at 5 m/s and 5 rad/s at most: 16 R eps times these."""
    rods, speed = 6, 0.5
    scene = random_tree(np.random.default_rng(3), rods, planar=False)
    ready = within(prepared(scene, 1e-3, "rk4"))
    model, data = ready.model, ready.data
    bodies = bodies_of(scene.structure.rods, model)
    sites = [model.site(name).id for name in scene.structure.node_names]

    def axial() -> tuple[Any, Any, Any]:
        nodes, velocities = node_states(model, data, sites)
        ends = nodes[scene.structure.rod_nodes]
        axes = (ends[:, 1] - ends[:, 0]) / scene.structure.rod_lengths[:, None]
        return nodes, velocities, np.sum(data.cvel[bodies, :3] * axes, axis=1)

    mujoco.mj_resetData(model, data)
    drawn = np.random.default_rng(1).uniform(-1, 1, (2, model.nv))
    drawn[:, spins(scene.structure, model)] = 0.0
    mujoco.mj_integratePos(model, data.qpos, 0.1 * drawn[0], 1.0)
    data.qvel[:] = ready.velocities + speed * drawn[1]
    nodes, velocities, before = axial()
    assert np.abs(before).max() > 0.1 * speed  # rods turn with those on which they hang

    mujoco.mj_resetData(model, data)
    data.qvel[:] = ready.velocities
    displace(model, data, scene, RandomStart(0.1, speed), np.random.default_rng(1))
    found = axial()
    assert max(np.abs(nodes).max(), np.abs(velocities).max() / 5, np.abs(data.cvel[bodies, :3]).max() / 5) < 3
    bound = 16 * rods * np.finfo(float).eps * 5 * 3
    np.testing.assert_allclose(found[0], nodes, rtol=0, atol=bound)
    np.testing.assert_allclose(found[1], velocities, rtol=0, atol=bound)
    np.testing.assert_allclose(found[2], 0.0, rtol=0, atol=bound)


def test_starts_by_chance_tear_no_loop_open() -> None:
    for name, message in (("truss_arm", "rods close a loop at node 't1'"), ("ladder", "holds nodes")):
        scene = tmj.load_scene(name)
        task = Task(scene, rising, 0.5, 2.5, ("nodes",), start=RandomStart(seed=3))  # type: ignore[arg-type]
        for start in (RandomStart(displacement=0.01), RandomStart(speed=0.01)):
            with pytest.raises(OptionError, match=f"random starts: .*{message}"):
                replace(task, start=start)


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


@pytest.mark.parametrize("name", ["PrismReach", pytest.param("SpineReach", marks=pytest.mark.study)])
def test_the_stated_error_is_the_measured_one(name: str) -> None:
    """Two digits are stated. Round-off, 1e-16 of each step, is 1e-8 of these errors."""
    found, stated = measured_error(name), task_of(name).measured_error
    for key in ("largest", "mean", "after_1_s"):
        assert found[key] == pytest.approx(stated[key], rel=0.06)


@pytest.mark.study
def test_the_stated_error_of_the_gait_is_the_measured_one() -> None:
    """What is measured is 1e9 round-offs or more; the reference's own error is (1/16)⁴ of it where nothing lands."""
    task = task_of("SixBarRoll")
    found = measured_error(task, 2, actions=gait(task))
    assert found["largest"] == pytest.approx(task.measured_error["gait"], rel=0.06)


def test_the_gait_rolls_forward() -> None:
    task = task_of("SixBarRoll")
    actions = gait(task)
    assert np.abs(actions).max() <= 1 + 1e-12
    states = played(World(task), actions)
    assert 0.9 < (states[-1].nodes - states[0].nodes)[0, :, 0].mean() < 1.0


def test_the_stated_error_of_a_second_is_the_measured_one_and_actions_may_be_given() -> None:
    """Actions that are given as they would be drawn have the same error, to the bit."""
    task = task_of("SixBarRoll")
    short = measured_error(task, 3, 10)
    assert short["after_1_s"] == pytest.approx(task.measured_error["after_1_s"], rel=0.06)
    generator = np.random.default_rng(0)
    World(task).start(ONE, [generator])
    drawn = [generator.uniform(-1, 1, len(task.low)) for _ in range(3)]
    assert measured_error(task, 1, actions=drawn) == measured_error(task, 1, 3)


def prism_task(scene: str = "prism", **options: Any) -> Task:
    """A task of one's own: the top of a shipped scene is to rise; some of it may be wrong."""
    one = tmj.load_scene(scene)
    lengths = one.structure.rest_lengths
    given: dict[str, Any] = {"low": 0.8 * lengths, "high": 1.2 * lengths, "observed": ("nodes",), "steps": 5}
    return Task(one, rising, **(given | options))


def rising(task: Task, before: Any, after: Any) -> dict[str, Any]:
    return {"height": after.nodes[:, :, 2].max(axis=1)}


NAN, INF = float("nan"), float("inf")
WRONG: list[tuple[dict[str, Any], str]] = [
    ({"scene": "prism"}, "task: scene = 'prism'; use a Scene, or load_scene"),
    ({"terms": None}, "task: terms = None; it must be a function (task, before, after)"),
    ({"low": None}, "task: low"),
    ({"low": "short"}, "task: low = 'short'; it must be an array of numbers, (M,)"),
    ({"low": NAN}, "task: low = nan; every number must be finite"),
    ({"low": [0.1] * 11 + [NAN]}, "task: low[11] = nan; every number must be finite"),
    ({"high": INF}, "task: high = inf; every number must be finite"),
    ({"low": [0.1]}, "task: low = array([0.1]) of shape (1,); it must be a number or an array of shape (12,) [m]"),
    ({"low": [[0.1, 0.2]]}, "task: low = array([[0.1, 0.2]]) of shape (1, 2)"),
    ({"low": 0.5, "high": 0.4}, "task: string 's1': low = 0.5, high = 0.4 m; allowed: 0 <= low <= high"),
    ({"low": -0.1}, "task: string 's1': low = -0.1"),
    ({"observed": ("node",)}, "task: observed: there is no part of an observation 'node' (did you mean 'nodes'?)"),
    ({"observed": "nodes"}, "task: observed = 'nodes'; it must be a sequence"),
    ({"observed": ()}, "task: observed = (); name at least one of nodes, shape"),
    ({"observed": (3,)}, "task: observed[0] = 3"),
    ({"observed": ("nodes", "nodes")}, "task: observed = ('nodes', 'nodes'); name each once"),
    ({"observed": ("goal",)}, "task: observed has 'goal': give the task a goal, or leave it out"),
    ({"of": "pulley", "observed": ("target",)}, "observed has 'target': scene 'pulley' has none"),
    ({"of": "massive_string", "observed": ("imu",)}, "observed has 'imu': scene 'massive_string' has neither rods"),
    ({"action": "torque"}, "task: action = 'torque'"),
    ({"period": 0}, "task: period = 0; it must be > 0 s"),
    ({"period": NAN}, "task: period = nan"),
    ({"period": "long"}, "task: period = 'long'"),
    ({"period": 3e-4}, "control period over the time step: 0.0003 s is no multiple of 0.001 s"),
    ({"period": 1e9}, "control period = 1e+09 s: 1000000000000 steps of 0.001 s; at most 1000000 are made in one"),
    ({"period": 1e90}, "control period over the time step: 1e+90 s over 0.001 s are more steps than can be counted"),
    ({"steps": 0}, "task: steps = 0; it must be an integer from 1 to"),
    ({"steps": -1}, "task: steps = -1"),
    ({"steps": "x"}, "task: steps = 'x'"),
    ({"steps": 10**400}, "task: steps = 1000"),
    ({"engine": "mujoco"}, "task: engine = 'mujoco'; use MuJoCo("),
    ({"engine": tmj.DAE()}, "task: engine = DAE("),
    ({"start": 0.01}, "task: start = 0.01; use RandomStart(displacement, speed, seed), or None"),
    ({"goal": ("s1", 0.1)}, "task: goal = ('s1', 0.1); use Goal(nodes, reach), or None"),
    ({"goal": Goal(("top",), (0, 0, 0))}, "task: goal: there is no node 'top'"),
    ({"goal": Goal((), (0, 0, 0))}, "task: goal: nodes = (); name at least one node"),
    ({"measured_error": 1e-3}, "task: measured_error = 0.001; it must be a mapping"),
]


@pytest.mark.parametrize(("options", "message"), WRONG, ids=range(len(WRONG)))
def test_a_task_that_fits_nothing_names_what_is_wrong(options: dict[str, Any], message: str) -> None:
    options = dict(options)
    task = prism_task(options.pop("of", "prism"))
    with pytest.raises(OptionError) as caught:
        replace(task, **options)
    assert message in str(caught.value)


def test_a_task_without_strings_and_a_goal_that_is_none_are_refused() -> None:
    scene = tmj.load_scene("pinned_rod")
    bare = scene.with_(structure=replace(scene.structure, strings=()), control=None)
    with pytest.raises(OptionError, match="task: scene 'pinned_rod' has no strings: there is nothing to act with"):
        Task(bare, rising, 0.1, 0.2, ("nodes",))  # type: ignore[arg-type]
    for reach in (3, (0, 0), (0, 0, -1), (NAN, 0, 0), "box", None):
        with pytest.raises(OptionError, match=r"Goal: reach"):
            Goal(("a",), reach)  # type: ignore[arg-type]
    for nodes in (3, "a", (3,), None):
        with pytest.raises(OptionError, match=r"Goal: nodes"):
            Goal(nodes, (0, 0, 0))  # type: ignore[arg-type]


def test_one_number_stands_for_all_limits_and_a_string_may_be_left_as_it_is() -> None:
    """What holds for all strings needs no array; where low is high, an action changes nothing."""
    task = prism_task(low=0.4, high=0.6)
    assert (task.low.tolist(), task.high.tolist()) == ([0.4] * 12, [0.6] * 12)
    assert task.commanded(np.zeros((1, 12))).tolist() == [[0.5] * 12]
    still = prism_task(low=0.5, high=[0.5, *[0.6] * 11])
    assert still.commanded(np.ones((1, 12)))[0, :2].tolist() == [0.5, 0.6]


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        (None, "task: terms returned None; it must be a mapping of names to numbers (n,)"),
        (1.0, "task: terms returned 1.0"),
        ({3: 1.0}, "task: terms returned {3: 1.0}"),
        ({"h": None}, "task: term 'h' of the reward = None"),
        ({"h": NAN}, "task: term 'h' of the reward = nan; every number must be finite"),
        ({"g": 1.0, "h": np.full(2, INF)}, "task: term 'h' of the reward[0] = inf; every number must be finite"),
        ({"h": np.zeros(7)}, "task: term 'h' of the reward = array([0., 0., 0., 0., 0., 0., 0.]) of shape (7,)"),
        ({"h": "high"}, "task: term 'h' of the reward = 'high'"),
        ({"h": 1j}, "task: term 'h' of the reward = 1j"),
    ],
)
def test_a_reward_that_is_none_is_refused(terms: Any, message: str) -> None:
    world = World(replace(prism_task(), terms=lambda task, before, after: terms), 2)
    ids = np.arange(2)
    world.start(ids, [np.random.default_rng(0)] * 2)
    with pytest.raises(OptionError) as caught:
        world.step(ids, np.zeros((2, 12)))
    assert message in str(caught.value)


def test_a_reward_may_be_one_number_for_all_and_have_no_terms() -> None:
    ids, generators = np.arange(2), [np.random.default_rng(0)] * 2
    for terms, reward in (({"h": 2, "g": np.array([1.0, 3.0])}, [3.0, 5.0]), ({}, [0.0, 0.0])):
        world = World(replace(prism_task(), terms=lambda task, before, after, terms=terms: terms), 2)
        world.start(ids, generators)
        assert world.step(ids, np.zeros((2, 12))).reward.tolist() == reward


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
        ({"parameters": 3}, "parameters = 3; it must be a mapping of paths to values"),
        ({"draws": None}, "draws = None; it must be a sequence"),
        ({"draws": 3}, "draws = 3; it must be a sequence"),
        ({"threads": -1}, "threads = -1"),
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
