"""A robot that is not shipped: ends of its episodes, seeds, checkers of Gymnasium and Stable-Baselines3, learning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium")
import gymnasium
from gymnasium.utils.env_checker import check_env
from stable_baselines import stand_in

import tensegrity_mj as tmj
from tensegrity_mj.errors import MissingPackageError, OptionError
from tensegrity_mj.learning.gymnasium import TensegrityEnv, TensegrityVectorEnv
from tensegrity_mj.learning.tasks import Goal, RandomStart, Task, World
from tensegrity_mj.studies import Draw, Uniform

STEPS = 5
NEAR = RandomStart(displacement=0.01, speed=0.02)


def leaning(task: Task, before: Any, after: Any) -> dict[str, Any]:
    """How far the top is along x [m]."""
    return {"lean": after.nodes[:, 1, 0]}


def mast(**options: Any) -> Task:
    """A rod on a ball joint, held by three guys: its top is to lean along x."""
    angles = 2 * np.pi * np.arange(3) / 3
    feet = {f"f{n}": (np.cos(angle), np.sin(angle), 0.0) for n, angle in enumerate(angles)}
    guys = tuple(tmj.String(f"s{n}", ("top", foot), 500.0, damping=5.0) for n, foot in enumerate(feet))
    rod = tmj.Rod("rod", ("base", "top"), 0.5, support=tmj.Support.pinned())
    structure = tmj.Structure(
        "mast", {"base": (0.0, 0.0, 0.0), "top": (0.0, 0.0, 1.0), **feet}, (rod,), guys, tuple(feet)
    )
    lengths = structure.rest_lengths
    seen = ("nodes", "velocities", "tensions")
    given = {"steps": STEPS, "engine": tmj.MuJoCo(5e-3)} | options
    return Task(tmj.Scene(structure), leaning, 0.7 * lengths, 1.1 * lengths, seen, **given)


def ends(env: Any, most: int = 3 * STEPS) -> list[int]:
    """The steps, of so many, after which an environment of one robot is truncated."""
    env.reset(seed=0)
    return [step for step in range(1, most + 1) if env.step(np.zeros(3, np.float32))[3]]


def test_an_episode_ends_after_the_tasks_steps_in_every_form() -> None:
    """A loop `while not done` ends; the single form goes on until it is reset, as Gymnasium's own do."""
    task = mast()
    assert ends(TensegrityEnv(task)) == list(range(STEPS, 3 * STEPS + 1))
    robots = TensegrityVectorEnv(2, task)
    robots.reset(seed=0)
    late = [robots.step(np.zeros((2, 3)))[3].tolist() for _ in range(2 * STEPS + 1)]
    # After the end a step begins the next episode.
    assert [step for step, one in enumerate(late, 1) if any(one)] == [STEPS, 2 * STEPS + 1]
    assert late[STEPS - 1] == [True, True]
    env = TensegrityEnv(task)
    for _ in range(2):  # a new episode has all its steps again
        env.reset()
        assert [env.step(np.zeros(3))[3] for _ in range(STEPS)] == [False] * (STEPS - 1) + [True]


def test_another_length_of_an_episode() -> None:
    task = mast()
    assert ends(TensegrityEnv(task, max_episode_steps=7), 7) == [7]
    assert ends(TensegrityEnv(task, max_episode_steps=-1)) == []
    for wrong in (0, -2, 2.5, "x", True, [3]):
        with pytest.raises(OptionError, match="max_episode_steps = "):
            TensegrityEnv(task, max_episode_steps=wrong)  # type: ignore[arg-type]


def test_gymnasiums_limit_is_the_one_that_counts_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """A shipped task by name, and a longer and shorter one than its own; a task of one's own by an id of one's own."""
    monkeypatch.setattr("tensegrity_mj.learning.tasks.robots._named", lambda name: mast())
    name = "Tensegrity/PrismReach-v0"
    assert ends(gymnasium.make(name, max_episode_steps=3), 3) == [3]
    assert ends(gymnasium.make(name, max_episode_steps=STEPS + 2), STEPS + 2) == [STEPS + 2]
    assert ends(gymnasium.make(name, max_episode_steps=-1)) == []
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    gymnasium.register("Own/Mast-v0", entry_point=TensegrityEnv, kwargs={"task": mast()})
    assert ends(gymnasium.make("Own/Mast-v0"), STEPS) == [STEPS]


def test_dm_control_has_the_same_length() -> None:
    pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)
    from tensegrity_mj.learning.dm_control import task_environment

    env = task_environment(mast())
    for _ in range(2):
        env.reset()
        steps = 1
        while not env.step(env.action_spec().minimum).last():
            steps += 1
        assert steps == STEPS


# Seeds -------------------------------------------------------------------------------------------------------


def start_of(task: Task, seed: int, **options: Any) -> Any:
    return TensegrityEnv(task, **options).reset(seed=seed)[0]


@pytest.mark.parametrize(
    ("drawn", "task", "options"),
    [
        (["start"], {"start": NEAR}, {}),
        (["goal"], {"goal": Goal(("top",), (0.1, 0.0, 0.0)), "observed": ("goal",)}, {}),
        (["noise.position"], {}, {"draws": [Draw("noise.position", Uniform(0.01, 0.02))]}),
        ([], {}, {}),
        ([], {"start": RandomStart(), "goal": Goal(("top",), (0.0, 0.0, 0.0))}, {}),
    ],
    ids=["start", "goal", "draws", "nothing", "nothing of anything"],
)
def test_seeds_give_different_episodes_where_something_is_drawn(
    drawn: list[str], task: dict[str, Any], options: dict[str, Any]
) -> None:
    own = replace(mast(), **task)
    env = TensegrityEnv(own, **options)
    assert env.metadata["drawn"] == env.world.drawn == drawn
    starts = [start_of(own, seed, **options) for seed in (0, 1, 2, 0)]
    np.testing.assert_array_equal(starts[0], starts[3])
    distinct = len({start.tobytes() for start in starts})
    assert distinct == (3 if drawn else 1)
    first, later = env.reset(seed=0)[0], env.reset()[0]
    assert (np.abs(first - later).max() > 0) == bool(drawn)


def test_all_episodes_of_a_seed_are_the_same_from_run_to_run() -> None:
    """Not the first alone: a vector goes on with each robot's own generator, as the single form does."""

    def starts(seed: int) -> Any:
        robots = TensegrityVectorEnv(2, mast(start=NEAR), autoreset_mode="SameStep")
        seen = [robots.reset(seed=seed)[0], robots.reset()[0]]
        return np.array(seen + [robots.step(np.zeros((2, 3)))[0] for _ in range(2 * STEPS)])

    one, again, other = starts(3), starts(3), starts(4)
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max(axis=(1, 2)).min() > 0
    np.testing.assert_array_equal(one[:, 1], other[:, 0])  # robot i has the seed + i
    env = TensegrityEnv(mast(start=NEAR))
    np.testing.assert_array_equal([env.reset(seed=3)[0], env.reset()[0]], one[:2, 0])


# Checkers and learning -----------------------------------------------------------------------------------------


def test_gymnasiums_checker_finds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    gymnasium.register("Own/Mast-v0", entry_point=TensegrityEnv, kwargs={"task": mast(start=NEAR)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make("Own/Mast-v0").unwrapped)
        check_env(TensegrityEnv(mast()), skip_render_check=True)  # which takes an environment with an id


def test_a_simple_learner_improves() -> None:
    """Random search for three constant actions, of the reward of an episode; 8 robots try at once.

    The top stands upright by design, and the guy along x pulls it over: towards the action -1 of that guy the reward
    grows. Of 8 · 6 changes drawn in a box, each accepted where it is better, none can make it worse.
    """
    robots = TensegrityVectorEnv(8, mast(), autoreset_mode="Disabled")
    generator, best, top = np.random.default_rng(0), np.full(3, 0.5), -np.inf
    scores = []
    for _ in range(6):
        tried = np.clip(best + generator.uniform(-0.5, 0.5, (8, 3)), -1, 1)
        tried[0] = best
        robots.reset(seed=0)
        total = np.sum([robots.step(tried)[1] for _ in range(STEPS)], axis=0)
        assert total[0] == top or not scores  # what was best is as good again
        scores.append(float(total.max()))
        best, top = tried[int(total.argmax())], total.max()
    assert np.all(np.diff(scores) >= 0)
    assert scores[-1] > max(0.0, scores[0])
    assert best[0] < 0 < min(best[1:])  # it pulls the guy along x, and pays out the others


@pytest.fixture
def adapter(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The adapter, to a library that may be missing."""
    with stand_in(monkeypatch) as found:
        yield found


def test_stable_baselines_gets_what_gymnasium_has(adapter: Any) -> None:
    def made() -> TensegrityVectorEnv:
        return TensegrityVectorEnv(3, mast(start=NEAR), autoreset_mode="SameStep")

    robots, same = adapter(made()), made()
    assert robots.observation_space == same.single_observation_space
    assert robots.action_space == same.single_action_space
    robots.seed(4)
    np.testing.assert_array_equal(robots.reset(), same.reset(seed=4)[0])
    np.testing.assert_array_equal(robots.reset(), same.reset()[0])  # seeds count once
    actions = np.random.default_rng(0).uniform(-1, 1, (2 * STEPS, 3, 3)).astype(np.float32)
    for step, action in enumerate(actions, 1):
        robots.step_async(action)
        seen, reward, done, infos = robots.step_wait()
        expected, rewards, _, _, info = same.step(action)
        np.testing.assert_array_equal(seen, expected)
        np.testing.assert_array_equal(reward, rewards.astype(np.float32))
        assert reward.dtype == np.float32
        assert done.tolist() == [step % STEPS == 0] * 3
        for number, one in enumerate(infos):
            assert one["lean"] == info["lean"][number]
            assert ("terminal_observation" in one) == bool(done[number])
            if done[number]:
                assert one["TimeLimit.truncated"] is True
                np.testing.assert_array_equal(one["terminal_observation"], info["final_obs"][number])
                assert np.abs(one["terminal_observation"] - seen[number]).max() > 0
    assert robots.get_attr("num_envs", [0, 2]) == [3, 3]
    assert robots.env_method("render", indices=0) == [None]
    assert robots.env_is_wrapped(gymnasium.Wrapper) == [False] * 3
    robots.set_attr("note", 3)
    assert robots.get_attr("note", 1) == [3]
    with pytest.raises(AttributeError):
        robots.get_attr("nothing")
    robots.close()


def test_a_robot_that_diverged_is_not_truncated_for_stable_baselines(adapter: Any) -> None:
    """A step far beyond the stable one; also where it diverges in the last step of an episode."""

    def last(most: int) -> tuple[int, float, dict[str, Any]]:
        options = {"parameters": {"engine.timestep": 0.04}, "max_episode_steps": most}
        robots = adapter(TensegrityVectorEnv(1, "PrismReach", autoreset_mode="SameStep", **options))
        robots.seed(0)
        robots.reset()
        for step in range(1, most + 1):
            robots.step_async(np.ones((1, 6)))
            _, reward, done, infos = robots.step_wait()
            if done[0]:
                return step, reward[0], infos[0]
        raise AssertionError

    steps, reward, info = last(50)
    for found in (info, last(steps)[2]):
        assert found["diverged"]
        assert found["TimeLimit.truncated"] is False
    assert reward == 0
    assert last(steps - 1)[2]["TimeLimit.truncated"] is True


def test_what_stable_baselines_cannot_take_is_refused(adapter: Any) -> None:
    for wrong in (TensegrityVectorEnv(2, mast()), TensegrityEnv(mast()), None, "PrismReach", 3):
        with pytest.raises(OptionError, match=r"robots: .*give a TensegrityVectorEnv with autoreset_mode='SameStep'"):
            adapter(wrong)


def test_without_stable_baselines_the_name_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "tensegrity_mj.learning.gymnasium.stable_baselines", raising=False)
    with pytest.raises(MissingPackageError, match="python -m pip install stable-baselines3"):
        tmj_gymnasium().StableBaselinesVecEnv  # noqa: B018


def tmj_gymnasium() -> Any:
    import tensegrity_mj.learning.gymnasium as room

    vars(room).pop("StableBaselinesVecEnv", None)
    return room


def test_the_checker_of_stable_baselines_finds_nothing() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(TensegrityEnv(mast(start=NEAR)))


@pytest.mark.study
def test_ppo_learns_to_lean() -> None:
    """A minute of it: the policy that was learned leans farther than the one before, by more than seeds differ.

    An episode's reward is a sum of STEPS positions of the top; starts differ by 10 mm, and so the mean of 16 episodes
    by STEPS · 0.01 at most.
    """
    ppo = pytest.importorskip("stable_baselines3").PPO
    pytest.importorskip("torch").set_num_threads(1)  # the robots have threads of their own
    from tensegrity_mj.learning.gymnasium import StableBaselinesVecEnv

    def score(model: Any) -> float:
        robots = TensegrityVectorEnv(16, mast(start=NEAR), autoreset_mode="Disabled")
        seen, total = robots.reset(seed=100)[0], np.zeros(16)
        for _ in range(STEPS):
            seen, reward, *_ = robots.step(model.predict(seen, deterministic=True)[0])
            total += reward
        return float(total.mean())

    robots = StableBaselinesVecEnv(TensegrityVectorEnv(16, mast(start=NEAR), autoreset_mode="SameStep"))
    model = ppo("MlpPolicy", robots, n_steps=2 * STEPS, batch_size=40, learning_rate=1e-3, seed=0, device="cpu")
    before = score(model)
    model.learn(8000)
    assert score(model) > before + STEPS * 0.01


def test_force_densities_are_for_dm_control() -> None:
    """As rest lengths they would be metres."""
    task = replace(mast(), action=tmj.Command.FORCE_DENSITY)
    for make in (World, TensegrityEnv):
        with pytest.raises(OptionError, match=r"action = .*FORCE_DENSITY.*dm_control"):
            make(task)
