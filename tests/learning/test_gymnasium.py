"""Environments of Gymnasium: its own checks, seeds, vectors, endings, pictures, what they state."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from typing import Any

import numpy as np
import pytest
from pages import ROOT

pytest.importorskip("gymnasium")
import gymnasium
from gymnasium.utils.env_checker import check_env

import tensegrity_mj.learning.gymnasium
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.learning.gymnasium.environments import Viewer
from tensegrity_mj.learning.tasks import World, task_of
from tensegrity_mj.learning.tasks.robots import TASKS
from tensegrity_mj.studies import Draw, Uniform

IDS = [f"Tensegrity/{name}-v0" for name in TASKS]
MODES = ["NextStep", "SameStep", "Disabled"]


@pytest.fixture(autouse=True)
def no_warnings() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize("name", IDS)
def test_gymnasiums_own_check_finds_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a display, as here, the mode "human" says so and goes on."""
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)
    check_env(gymnasium.make(name).unwrapped)


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_four_hundred_random_steps_raise_no_warning(name: str) -> None:
    """In a vector of 4, and so 102 steps of each; what is seen stays within the space."""
    robots = gymnasium.make_vec(name, num_envs=4, vectorization_mode="vector_entry_point")
    robots.reset(seed=1)
    robots.action_space.seed(2)
    ended = 0
    for _ in range(102):
        seen, reward, terminated, truncated, _ = robots.step(robots.action_space.sample())
        assert robots.observation_space.contains(seen)
        assert np.isfinite(reward).all()
        assert not terminated.any()  # nothing diverges
        ended += int(truncated.sum())
    assert ended == 4  # a step of each 101 begins anew
    robots.close()


@pytest.mark.parametrize("name", IDS)
def test_a_seed_decides_an_episode(name: str) -> None:
    def episode(seed: int) -> list[Any]:
        env = gymnasium.make(name)
        env.action_space.seed(3)
        found = [env.reset(seed=seed)[0]]
        found += [env.step(env.action_space.sample())[0] for _ in range(5)]
        return [*found, env.reset()[0]]

    one, again, other = episode(1), episode(1), episode(2)
    np.testing.assert_array_equal(one, again)
    assert np.abs(one[0] - other[0]).max() > 1e-3
    assert np.abs(one[0] - one[-1]).max() > 1e-3  # the next episode has another start


@pytest.mark.parametrize("mode", MODES)
def test_a_vector_is_single_environments(mode: str) -> None:
    """To the bit, through ends of episodes, against Gymnasium's own vector of single environments."""
    options = {"max_episode_steps": 4, "draws": [Draw("structure.rods[*].mass", Uniform(0.8, 1.2), scaled=True)]}
    name = "Tensegrity/PrismReach-v0"
    robots = gymnasium.make_vec(name, 3, "vector_entry_point", autoreset_mode=mode, **options)
    kwargs = {"autoreset_mode": robots.metadata["autoreset_mode"]}
    singles = gymnasium.make_vec(name, 3, "sync", vector_kwargs=kwargs, **options)
    np.testing.assert_array_equal(robots.reset(seed=4)[0], singles.reset(seed=4)[0])
    generator = np.random.default_rng(0)
    for _ in range(12):
        actions = generator.uniform(-1, 1, (3, 6)).astype(np.float32)
        one, other = robots.step(actions), singles.step(actions)
        for mine, theirs in zip(one[:4], other[:4], strict=True):
            np.testing.assert_array_equal(mine, theirs)
        assert set(one[4]) >= set(other[4])  # nothing where all begin anew
        for key in ("distance", "_distance", "final_obs"):
            if key in other[4]:
                mine, theirs = one[4][key], other[4][key]
                which = one[4].get(f"_{key}", np.ones(3, bool))
                np.testing.assert_array_equal(np.stack(mine[which]), np.stack(theirs[which]))
        if mode == "Disabled" and one[3].any():
            mask = {"reset_mask": one[3]}
            mine, theirs = (env.reset(seed=9, options=dict(mask))[0] for env in (robots, singles))
            np.testing.assert_array_equal(mine[one[3]], theirs[one[3]])
    singles.close()
    robots.close()


def test_the_reward_is_the_sum_of_its_terms_and_slices_cover_the_observation() -> None:
    env = gymnasium.make("Tensegrity/SixBarRoll-v0")
    start, _ = env.reset(seed=1)
    seen, reward, _, _, info = env.step(np.zeros(24, np.float32))
    assert reward == info["forward"] + info["effort"]
    assert not info["diverged"]
    slices = env.unwrapped.observation_slices
    assert list(slices) == ["shape", "velocities", "rest_lengths", "tensions", "imu"]
    places = np.concatenate([np.arange(len(seen))[part] for part in slices.values()])
    np.testing.assert_array_equal(places, np.arange(len(seen)))
    state, task = env.unwrapped.world.state(), task_of("SixBarRoll")
    np.testing.assert_array_equal(seen[slices["tensions"]], state.tensions[0].astype(np.float32))
    np.testing.assert_array_equal(start[slices["rest_lengths"]], task.scene.structure.rest_lengths.astype(np.float32))


def test_what_an_environment_states() -> None:
    for name in TASKS:
        for env in (gymnasium.make(f"Tensegrity/{name}-v0"), gymnasium.make_vec(f"Tensegrity/{name}-v0", 2)):
            assert env.metadata["measured_error"] == dict(task_of(name).measured_error)
            assert env.metadata["render_modes"] == ["human", "rgb_array"]
            assert env.metadata["render_fps"] == round(1 / task_of(name).period)
            assert env.spec is not None
            assert env.spec.max_episode_steps == task_of(name).steps


def test_pictures_follow_the_robot(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)
    env = gymnasium.make("Tensegrity/PrismReach-v0", render_mode="rgb_array")
    env.reset(seed=1)
    first = env.render()
    assert first.shape == (480, 640, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(first, env.render())
    for _ in range(5):
        env.step(np.ones(6, np.float32))
    assert np.abs(env.render().astype(int) - first).max() > 50
    env.close()
    env.close()
    robots = gymnasium.make_vec("Tensegrity/PrismReach-v0", 2, "vector_entry_point", render_mode="rgb_array")
    robots.reset(seed=1)
    np.testing.assert_array_equal(robots.render()[0], first)
    robots.close()
    shown = gymnasium.make("Tensegrity/PrismReach-v0", render_mode="human")
    shown.reset()
    shown.step(np.ones(6, np.float32))
    if sys.platform == "linux":
        assert capsys.readouterr().err.count("no display") == 1
    shown.close()


@pytest.mark.parametrize("name", TASKS)
def test_the_page_states_the_shipped_tasks(name: str) -> None:
    text = (ROOT / "docs" / "gymnasium.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    start = next(row for row in rows if row[-1].startswith("`SpineReach-v0`"))
    column = start.index(f"`{name}-v0`") - len(start)
    cells = {row[0]: row[column].replace("within the same", row[1]) for row in rows if len(row) == len(start) + 1}
    task = task_of(name)
    structure = task.scene.structure
    assert task.start is not None
    reach = [] if task.goal is None else [1e3 * part for part in task.goal.reach]
    for row, numbers in {
        "task": reach,
        "actions": [len(structure.strings)],
        "rest lengths, as parts of those designed": [
            *(task.low / structure.rest_lengths),
            *(task.high / structure.rest_lengths),
        ],
        "winch speed": structure.limits("winch_speed"),
        "observation": [World(task).size],
        "control period, episode": [task.period, task.steps],
        "engine": [4, 1e3 * task.engine.timestep],  # type: ignore[attr-defined]
        "start": [1e3 * x for x in (task.start.displacement, task.start.displacement, task.start.speed)],
    }.items():
        stated = [float(one) for one in re.findall(r"\.?\d[\d.]*", cells[row].partition(", 10 mm above")[0])]
        each = (
            sorted({float(f"{number:.12g}") for number in numbers}) if "lengths" in row or "winch" in row else numbers
        )
        np.testing.assert_allclose(stated, each, rtol=1e-12, err_msg=row)


def test_a_picture_has_the_rods_of_its_robot_where_they_are() -> None:
    robots = gymnasium.make_vec("Tensegrity/PrismReach-v0", 2, "vector_entry_point", render_mode="rgb_array")
    robots.reset(seed=1)
    robots.step(np.stack([np.ones(robots.single_action_space.shape), -np.ones(robots.single_action_space.shape)]))
    world = robots.unwrapped.world  # type: ignore[attr-defined]
    viewer = Viewer(world)
    for number, nodes in enumerate(world.state().nodes):
        viewer.pixels(number)
        drawn = np.array([geom.pos for geom in viewer._scene.geoms[: viewer._scene.ngeom]])
        middles = nodes[world.task.scene.structure.rod_nodes].mean(axis=1)
        # Places less than 1 m from the origin, which a picture has in single precision, to 6e-8 m in each direction.
        assert np.linalg.norm(middles[:, None] - drawn, axis=2).min(axis=1).max() < 1e-7 * np.sqrt(3)
    viewer.close()
    viewer.close()
    robots.close()


def test_wrong_options_are_refused() -> None:
    name = IDS[1]
    with pytest.raises(OptionError, match=r"render_mode: .*rgb_array"):
        tensegrity_mj.learning.gymnasium.TensegrityEnv("PrismReach", render_mode="rgb")
    with pytest.raises(OptionError, match=r"autoreset_mode: .*NextStep"):
        gymnasium.make_vec(name, 2, "vector_entry_point", autoreset_mode="next")
    with pytest.raises(OptionError, match=r"action: .*length"):
        gymnasium.make(name, action="force")
    with pytest.raises(ValueError, match="3 of them for 2 robots"):
        gymnasium.make_vec(name, 2, "vector_entry_point").reset(seed=[1, 2, 3])
    env = tensegrity_mj.learning.gymnasium.TensegrityEnv("PrismReach")
    env.reset()
    with pytest.raises(ControllerError, match="6 finite numbers"):
        env.step(np.zeros(5))


def test_the_page_runs_as_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "gymnasium.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) == 6
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, "docs/gymnasium.md", "exec"), names)
    assert names["robots"].reset(seed=1)[0].shape == (4, 30)


def test_an_id_with_its_module_needs_no_import_before() -> None:
    code = (
        "import gymnasium, sys\n"
        "env = gymnasium.make('tensegrity_mj.learning.gymnasium:Tensegrity/PrismReach-v0')\n"
        "assert env.reset(seed=0)[0].shape == env.observation_space.shape\n"
        "assert 'dm_control' not in sys.modules\n"
    )
    child = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
