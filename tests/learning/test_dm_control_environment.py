"""A scene as a dm_control Environment: it moves as the engine does, repeats itself, and refuses what is no action."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj import Actuation, Command, Integrator
from tensegrity_mj.engines.mujoco.contact import spins
from tensegrity_mj.errors import ControllerError, DivergenceError, OptionError
from tensegrity_mj.model import StringLaw, strings
from tensegrity_mj.model.events import Break
from tensegrity_mj.model.scene import Scene

pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)
from absl.testing import absltest
from dm_env import StepType, test_utils

from tensegrity_mj.learning.dm_control import PhysicsDivergence, RandomStart, environment, physics

Array = NDArray[np.float64]

# The environment and the engine compute the same formulas in another order: about a hundred roundings a step of
# positions below 4 m, 2.2e-16 each in relation. Were all of one sign, 250 steps would add up to 250 · 100 · 4 · 2.2e-16
# = 2.2e-11 m. Any difference of the experiment (a stage, a damper, a load, a break) shows as 1e-6 m or more.
ROUND_OFF = 2.2e-11


def held(command: Command, period: float) -> Actuation:
    if command is Command.FORCE_DENSITY:
        return Actuation.hold_force_density(period)
    return Actuation.hold_rest_length(period)


def play(env: Any, actions: Any) -> list[Any]:
    """An episode's time steps; `actions` is a function of a time step."""
    timesteps = [env.reset()]
    while not timesteps[-1].last():
        timesteps.append(env.step(actions(timesteps[-1])))
    return timesteps


def observed(timesteps: list[Any], name: str) -> Array:
    return np.array([timestep.observation[name] for timestep in timesteps])


def law_actions(env: Any, scene: Scene, command: Command) -> Any:
    law, stiffness = tmj.controllers.from_scene(scene), scene.structure.stiffness

    def act(timestep: Any) -> Array:
        seen = timestep.observation
        u = np.asarray(law(env.physics.time(), seen["nodes"], seen["velocities"]))
        if command is Command.FORCE_DENSITY:
            return u
        return strings.rest_length(stiffness, seen["string_lengths"], u)

    return act


@pytest.mark.parametrize("command", Command)
@pytest.mark.parametrize("name", ["prism", "pinned_rod"])
def test_an_episode_under_the_thesis_law_is_the_engines_run(name: str, command: Command) -> None:
    scene = tmj.load_scene(name)
    env = environment(scene, command, control_timestep=0.01, timestep=5e-3, time_limit=1.0)
    episode = play(env, law_actions(env, scene, command))
    run = tmj.simulate(
        scene,
        tmj.controllers.from_scene(scene),
        tmj.MuJoCo(5e-3),
        duration=1.0,
        actuation=held(command, 0.01),
        output_interval=0.01,
    )
    assert len(episode) == 101
    for key, theirs in (("nodes", run.nodes), ("velocities", run.velocities)):
        assert np.max(np.abs(observed(episode, key) - theirs)) <= ROUND_OFF
    # Observed before the engine's next sample: what was held during the step that ended.
    lengths = scene.structure.string_lengths(run.nodes)
    if command is Command.REST_LENGTH:
        rest = run.rest_lengths[:-1]
    else:
        rest = lengths[1:] * (1 - run.force_densities[:-1] / scene.structure.stiffness)
    np.testing.assert_allclose(observed(episode[1:], "rest_lengths"), rest, rtol=0, atol=ROUND_OFF)
    tensions = strings.elastic_tension(scene.structure.stiffness, lengths[1:], rest)
    np.testing.assert_allclose(observed(episode[1:], "tensions"), tensions, rtol=0, atol=ROUND_OFF * 10)
    assert np.max(np.abs(run.nodes[-1] - run.nodes[0])) > 0.04
    # The other thing that could be held is another experiment.
    other = tmj.simulate(
        scene,
        tmj.controllers.from_scene(scene),
        tmj.MuJoCo(5e-3),
        duration=1.0,
        actuation=held(next(c for c in Command if c is not command), 0.01),
        output_interval=0.01,
    )
    assert np.max(np.abs(other.nodes - run.nodes)) > 1e6 * ROUND_OFF


def rough_scene(seed: int, loads: int) -> Scene:
    """Dampers, slack strings, a string that breaks, gravity, an initial motion, and both string laws."""
    rng = np.random.default_rng([11, seed])
    law = (StringLaw.CLIPPED, StringLaw.UNCLIPPED)[seed % 2]
    structure = random_structure(rng, rods=2, point_masses=seed % 2, damping=(0.5, 2.0), law=law)
    scene = random_scene(rng, structure, displaced=0.2, moving=0.5, gravity=True, loads=loads)
    return scene.with_(breaks=(Break("s1", 0.1),))


def random_commands(scene: Scene, command: Command, seed: int, count: int) -> Array:
    rng, structure = np.random.default_rng([12, seed]), scene.structure
    shape = (count, len(structure.strings))
    if command is Command.FORCE_DENSITY:
        return np.maximum(0.0, rng.uniform(-0.3, 1, shape)) * structure.stiffness * 0.4
    return structure.rest_lengths * rng.uniform(0.7, 1.3, shape)


def both(
    scene: Scene, command: Command, seed: int, integrator: Integrator, timestep: float = 2e-3
) -> tuple[list[Any], Any, Array]:
    """An episode of 0.5 s under random commands, the engine's run of the same, and the commands."""
    commands = random_commands(scene, command, seed, 26)

    class Recorded:
        def __init__(self) -> None:
            self.command = command

        def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
            return commands[round(time / 0.02)]

    env = environment(
        scene,
        command,
        control_timestep=0.02,
        timestep=timestep,
        integrator=integrator,
        time_limit=0.5,
        reward=lambda *_: 0.0,
        bounds=(0.0, 1e3),
    )
    queue = iter(commands)
    episode = play(env, lambda _: next(queue))
    run = tmj.simulate(
        scene,
        Recorded(),
        tmj.MuJoCo(timestep, integrator),
        duration=0.5,
        actuation=held(command, 0.02),
        output_interval=0.02,
    )
    return episode, run, commands


EXACT = [(i, c) for i in Integrator for c in Command if (i, c) not in {(Integrator.RK4, Command.REST_LENGTH)}]
EXACT.remove((Integrator.DISCRETE, Command.FORCE_DENSITY))


@pytest.mark.parametrize(("integrator", "command"), EXACT)
@pytest.mark.parametrize("seed", range(2))
def test_dampers_slack_strings_breaks_and_loads_are_the_engines(
    integrator: Integrator, command: Command, seed: int
) -> None:
    scene = rough_scene(seed, loads=0 if integrator is Integrator.RK4 else 2)
    episode, run, _ = both(scene, command, seed, integrator)
    assert np.max(np.abs(observed(episode, "nodes") - run.nodes)) <= ROUND_OFF
    assert 0.1 < np.mean(run.tensions == 0) < 0.9
    # Tensions follow from the observed state by the string law: T of 50 N/m and 2 N s/m, rates with 100 roundings more.
    last, structure = episode[-1].observation, scene.structure
    rates = structure.string_rates(last["nodes"], last["velocities"])
    law = strings.tension(
        structure.stiffness,
        structure.damping,
        last["string_lengths"],
        rates,
        last["rest_lengths"],
        structure.string_law,
    )
    law[[string.name == "s1" for string in structure.strings]] = 0.0
    np.testing.assert_allclose(last["tensions"], law, rtol=0, atol=1e-11)


@pytest.mark.parametrize("what", ["damped strings", "loads"])
def test_what_is_renewed_once_a_step_converges_to_the_engine(what: str) -> None:
    # RK4 with held rest lengths: a damped string's slackness is looked at once a step, where the engine looks at
    # each stage, an error of the first order in h; loads are held at their value in the middle of a step, an error of
    # the second order. Three halvings make it 8 and 64 times less; half of that is asked, for events fall by chance.
    errors = []
    for timestep in (4e-3, 5e-4):
        scene = rough_scene(0, loads=0)
        if what == "loads":
            scene = random_scene(
                np.random.default_rng(5), scene.structure.with_strings(damping=0.0), moving=0.5, loads=2
            )
        episode, run, _ = both(scene, Command.REST_LENGTH, 0, Integrator.RK4, timestep)
        errors.append(np.max(np.abs(observed(episode, "nodes") - run.nodes)))
    assert 1e-8 < errors[1] < errors[0] / (4 if what == "damped strings" else 32)


@pytest.mark.parametrize("command", Command)
def test_limits_of_strings_and_winches_are_kept_as_engines_keep_them(command: Command) -> None:
    scene = rough_scene(0, 0)
    structure = scene.structure
    k, lengths = structure.stiffness, structure.string_lengths(structure.positions)
    limited = tuple(
        replace(string, max_force_density=0.2 * k[m], min_rest_length=0.9 * lengths[m], winch_speed=5 * lengths[m])
        for m, string in enumerate(structure.strings)
    )
    scene = scene.with_(structure=replace(structure, strings=limited))
    episode, run, commands = both(scene, command, 0, Integrator.EULER)
    assert np.max(np.abs(observed(episode, "nodes") - run.nodes)) <= ROUND_OFF
    if command is Command.REST_LENGTH:
        np.testing.assert_allclose(observed(episode[1:], "rest_lengths"), run.rest_lengths[:-1], rtol=0, atol=ROUND_OFF)
        moves = np.abs(np.diff(run.rest_lengths, axis=0)) / (5 * lengths * 0.02)
        assert moves.max() == pytest.approx(1.0, rel=1e-9)
        assert np.any(run.rest_lengths[:-1] > commands[:-1] + 0.01)
    else:
        assert np.any(commands > 0.21 * k)
        env = environment(scene, command, reward=lambda *_: 0.0)
        np.testing.assert_array_equal(env.action_spec().maximum, 0.2 * k)


def test_loads_may_be_a_function_of_time() -> None:
    plain = random_scene(np.random.default_rng(5), rough_scene(0, 0).structure, loads=2)
    as_function = plain.with_(loads=plain.nodal_forces)
    runs = [both(scene, Command.REST_LENGTH, 0, Integrator.EULER)[0] for scene in (plain, as_function)]
    assert np.max(np.abs(observed(runs[0], "nodes") - observed(runs[1], "nodes"))) <= ROUND_OFF
    late = plain.with_(loads=lambda time: np.zeros((5 if time < 5e-3 else 1, 3)))
    env = environment(late, reward=lambda *_: 0.0)
    env.reset()
    with pytest.raises(OptionError, match=r"loads: .* near t = 0.0055 s.* shape \(1, 3\)"):
        env.step(env.action_spec().minimum)


@pytest.mark.parametrize("command", Command)
def test_episodes_repeat_and_environments_do_not_disturb_each_other(command: Command) -> None:
    scene = tmj.load_scene("prism")

    def make(seed: int) -> Any:
        return environment(scene, command, time_limit=0.2, start=RandomStart(0.1, 0.2, seed))

    def actions(seed: int, env: Any) -> Any:
        rng, spec = np.random.default_rng(seed), env.action_spec()
        return lambda _: rng.uniform(spec.minimum, spec.maximum)

    first, second = make(1), make(1)
    alone = [observed(play(first, actions(7, first)), "nodes") for _ in range(2)]
    assert not np.array_equal(alone[0][0], alone[1][0])  # each episode starts elsewhere
    # The same again, step by step between those of another environment and runs of the engine.
    other = make(2)
    rng, spec = np.random.default_rng(7), second.action_spec()
    seen = [second.reset().observation["nodes"]]
    other.reset()
    for number in range(20):
        seen.append(second.step(rng.uniform(spec.minimum, spec.maximum)).observation["nodes"])
        other.step(spec.maximum)
        if number == 10:
            tmj.simulate(scene, None, tmj.MuJoCo(1e-3), duration=0.01)
    np.testing.assert_array_equal(np.array(seen), alone[0])
    again = [observed(play(second, actions(7, second)), "nodes")]
    np.testing.assert_array_equal(again[0], alone[1])
    assert not np.array_equal(make(2).reset().observation["nodes"], alone[0][0])


def test_random_starts_keep_rods_and_supports() -> None:
    scene = tmj.load_scene("prism")
    structure = scene.structure
    env = environment(scene, start=RandomStart(0.3, 0.5, 3))
    for _ in range(5):
        seen = env.reset().observation
        nodes, velocities = seen["nodes"], seen["velocities"]
        ends = structure.rod_nodes
        span, rate = (x[ends[:, 1]] - x[ends[:, 0]] for x in (nodes, velocities))
        # A few roundings of lengths of 1 m and of speeds below 1 m/s.
        np.testing.assert_allclose(np.linalg.norm(span, axis=1), structure.rod_lengths, rtol=0, atol=1e-14)
        np.testing.assert_allclose(np.sum(span * rate, axis=1), 0, atol=1e-14)
        for rod, (i, j) in zip(structure.rods, ends, strict=True):
            rows, sigma = rod.support.constraint_rows, rod.support.sigma
            r = (1 - sigma) * (nodes - scene.nodes0)[i] + sigma * (nodes - scene.nodes0)[j]
            np.testing.assert_allclose(rows @ r, 0, atol=1e-14)
        assert 0.01 < np.abs(nodes - scene.nodes0).max() < 1
        assert 0.01 < np.abs(velocities).max() < 2
    axial = spins(structure, env.physics.model.ptr)
    assert len(axial) == len(structure.rods)
    assert not env.physics.data.qvel[axial].any()


def test_a_scene_that_starts_in_motion_starts_so_and_the_first_tensions_are_the_designed_ones() -> None:
    rng = np.random.default_rng(2)
    scene = random_scene(rng, random_structure(rng, rods=3, own_planes=0.3), displaced=0.1, moving=0.5)
    structure = scene.structure
    for command in Command:
        seen = environment(scene, command, reward=lambda *_: 0.0).reset().observation
        # Some ten roundings of at most 4 m, 4 m/s, and 50 N/m times as much.
        np.testing.assert_allclose(seen["nodes"], scene.nodes0, rtol=0, atol=1e-14)
        np.testing.assert_allclose(seen["velocities"], scene.velocities0, rtol=0, atol=1e-14)
        lengths = structure.string_lengths(scene.nodes0)
        expected = strings.elastic_tension(structure.stiffness, lengths, structure.rest_lengths)
        np.testing.assert_allclose(seen["tensions"], expected, rtol=0, atol=1e-12)
        assert expected.max() > 1


def test_specs() -> None:
    scene = tmj.load_scene("prism")
    structure = scene.structure
    force, rest = (environment(scene, command) for command in (Command.FORCE_DENSITY, Command.REST_LENGTH))
    for env in (force, rest):
        spec = env.action_spec()
        assert spec.shape == (12,)
        assert spec.dtype == np.float64
        assert spec.name.split("\t") == [string.name for string in structure.strings]
        np.testing.assert_array_equal(spec.minimum, np.zeros(12))
        observation = env.observation_spec()
        assert {name: one.shape for name, one in observation.items()} == {
            "nodes": (6, 3),
            "velocities": (6, 3),
            "string_lengths": (12,),
            "rest_lengths": (12,),
            "tensions": (12,),
            "target": (6, 3),
        }
        assert env.control_timestep() == pytest.approx(0.01)
    np.testing.assert_array_equal(force.action_spec().maximum, structure.stiffness)
    assert np.all(rest.action_spec().maximum >= 2 * structure.rest_lengths)
    assert "target" not in environment(tmj.load_scene("tbar"), reward=lambda *_: 0.0).observation_spec()


def test_the_default_reward_is_minus_the_mean_distance_of_moving_nodes() -> None:
    scene = tmj.load_scene("pinned_rod")
    env = environment(scene, Command.FORCE_DENSITY, time_limit=0.05)
    first, *rest = play(env, lambda _: np.full(3, 0.1))
    assert first.reward is None
    assert scene.target is not None
    for timestep in rest:
        gaps = np.linalg.norm(timestep.observation["nodes"] - scene.target.nodes[0], axis=1)
        assert timestep.reward == pytest.approx(-(gaps[0] + gaps[1]) / 2, rel=1e-14)  # O and n1; n2 to n4 are fixed


def test_a_path_is_followed_by_the_observed_target() -> None:
    scene = tmj.load_scene("pinned_rod")
    assert scene.target is not None
    ends = np.array([scene.nodes0, scene.target.nodes[0]])
    env = environment(scene.with_(target=tmj.Target.path((0.0, 0.2), ends)), time_limit=0.2)
    episode = play(env, lambda _: scene.structure.rest_lengths)
    targets = observed(episode, "target")
    np.testing.assert_allclose(targets[[0, -1]], ends, rtol=0, atol=1e-12)
    assert np.all(np.linalg.norm(np.diff(targets[:, 1], axis=0), axis=1) > 0)


def test_rewards_and_ends_of_ones_own() -> None:
    scene = tmj.load_scene("prism")
    calls: list[tuple[Scene, Array, Array, Array]] = []

    def reward(scene: Scene, nodes: Array, velocities: Array, u: Array) -> float:
        calls.append((scene, nodes, velocities, u))
        return float(np.sum(u))

    def end(scene: Scene, nodes: Array, velocities: Array, u: Array) -> float | None:
        return 0.25 if len(calls) == 3 else None

    env = environment(scene, Command.FORCE_DENSITY, reward=reward, termination=end)
    episode = play(env, lambda _: np.full(12, 0.1))
    assert [timestep.reward for timestep in episode[1:]] == pytest.approx([1.2] * 3, rel=1e-12)
    assert [timestep.discount for timestep in episode] == [None, 1.0, 1.0, 0.25]
    assert episode[-1].step_type is StepType.LAST
    np.testing.assert_array_equal(calls[-1][1], episode[-1].observation["nodes"])
    np.testing.assert_array_equal(calls[-1][2], episode[-1].observation["velocities"])
    # The time limit says that the world goes on.
    timed = play(environment(scene, time_limit=0.3), lambda _: scene.structure.rest_lengths)
    assert len(timed) == 31
    assert timed[-1].discount == 1.0
    for bad in (float("nan"), None, "much"):
        env = environment(scene, reward=lambda *_, bad=bad: bad)
        env.reset()
        with pytest.raises(OptionError, match=r"reward: it returned .* at t = 0.01 s"):
            env.step(scene.structure.rest_lengths)
    for bad in (float("nan"), 1.5, "soon"):
        env = environment(scene, termination=lambda *_, bad=bad: bad)
        env.reset()
        with pytest.raises(OptionError, match=r"termination: it returned .*0 to 1"):
            env.step(scene.structure.rest_lengths)


def test_what_is_no_action_is_refused() -> None:
    scene = tmj.load_scene("prism")
    env = environment(scene, Command.FORCE_DENSITY)
    good = np.full(12, 0.1)
    bad = good.copy()
    bad[4] = np.nan
    for action, message in (
        (good[:11], r"shape \(11,\).*\(12,\)"),
        (bad, r"string 's5' = nan.*finite"),
        ("strong", "12 real numbers"),
        (good * 1j, "12 real numbers"),
        (good - 0.2, r"string 's1' = -0.1; it must be within 0 and 2"),
        (good + 1.95, r"string 's1' = 2.05; it must be within 0 and 2.*other bounds"),
    ):
        env.reset()
        with pytest.raises(ControllerError, match=message):
            env.step(action)
    env.reset()
    single = np.full(12, np.float32(2.0) * (1 + np.float32(1.2e-7)))  # one rounding above the bound
    assert np.all(single > 2.0)
    env.step(single)
    np.testing.assert_array_equal(env.physics.force_densities(), np.full(12, 2.0))
    # Nothing that was refused has left a trace.
    np.testing.assert_array_equal(env.reset().observation["nodes"], environment(scene).reset().observation["nodes"])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"action": "rest lengths"}, "action = .*Command.REST_LENGTH"),
        ({"control_timestep": 0.0105, "timestep": 1e-3}, "control_timestep over timestep.*0.01 s or 0.011 s"),
        ({"timestep": -1e-3}, "timestep"),
        ({"time_limit": 0.015}, "time_limit over control_timestep"),
        ({"integrator": "rk5"}, "integrator.*mean 'rk4'"),
        ({"bounds": (0.5, 0.2)}, "bounds of string 's1' = 0.5 to 0.2"),
        ({"bounds": (-1.0, 0.2)}, "bounds of string 's1' = -1 to 0.2"),
        ({"bounds": (np.zeros(3), 1.0)}, r"bounds.*\(12,\)"),
        ({"bounds": 2.0}, "pair"),
        ({"reward": 1.0}, "reward = 1.0.*function"),
        ({"termination": True}, "termination = True.*function"),
        ({"start": 3}, "start = 3; use RandomStart"),
        ({"scene": tmj.load_scene("prism").with_(breaks=(Break("s4", 0.0105),))}, "break of string 's4'"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        environment(**{"scene": tmj.load_scene("prism"), **options})


def test_bad_scenes_and_starts_are_refused() -> None:
    with pytest.raises(OptionError, match="use a Scene"):
        environment("prism")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"'tbar' has no target.*reward="):
        environment(tmj.load_scene("tbar"))
    lonely = tmj.Structure("lonely", {"a": (0, 0, 0), "b": (1, 0, 0)}, rods=(tmj.Rod("rod", ("a", "b"), 1.0),))
    with pytest.raises(OptionError, match="no strings"):
        environment(Scene(lonely), reward=lambda *_: 0.0)
    for options, message in (
        ({"displacement": -0.1}, "displacement = -0.1"),
        ({"speed": np.inf}, "speed = inf"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 0.5}, "seed = 0.5"),
    ):
        with pytest.raises(OptionError, match=message):
            RandomStart(**options)


def test_divergence_is_ours_and_dm_controls_and_a_reset_mends_it() -> None:
    from dm_control.rl.control import PhysicsError

    # 2000 N/m on a transverse inertia of 1/12 kg m² swings at over 100 rad/s: h = 0.1 s is far past the limit.
    scene = tmj.load_scene("prism")
    stiff = scene.with_(structure=scene.structure.with_strings(stiffness=2000.0))
    env = environment(stiff, control_timestep=0.1, timestep=0.1)
    start = env.reset().observation["nodes"]

    def go_on() -> None:
        for _ in range(100):
            env.step(env.action_spec().minimum)

    with pytest.raises(PhysicsDivergence, match=r"diverged by t = .*reduce the time step \(h = 0.1 s\)") as caught:
        go_on()
    assert isinstance(caught.value, DivergenceError)
    assert isinstance(caught.value, PhysicsError)
    assert 0 < caught.value.time <= 10
    np.testing.assert_array_equal(env.reset().observation["nodes"], start)
    assert np.all(np.isfinite(env.step(stiff.structure.rest_lengths).observation["nodes"]))


def test_copies_of_the_physics_go_on_alike() -> None:
    scene = rough_scene(0, 2)
    model = physics(scene, 2e-3, command=Command.FORCE_DENSITY)
    model.set_command(random_commands(scene, Command.FORCE_DENSITY, 0, 1)[0])
    model.step(20)
    twins = [model.copy(), pickle.loads(pickle.dumps(model))]
    model.step(30)
    for twin in twins:
        twin.step(30)
        np.testing.assert_array_equal(twin.nodes(), model.nodes())
        np.testing.assert_array_equal(twin.tensions(), model.tensions())


class TestDmEnvContract(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """The contract of dm_env, checked by its own tests, the end of an episode included."""

    def make_object_under_test(self) -> Any:
        return environment(tmj.load_scene("prism"), Command.FORCE_DENSITY, time_limit=0.1)


class TestDmEnvContractOfRestLengths(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """The same with the other action and a random start."""

    def make_object_under_test(self) -> Any:
        return environment(tmj.load_scene("pinned_rod"), time_limit=0.1, start=RandomStart(0.1, 0.1, 4))
