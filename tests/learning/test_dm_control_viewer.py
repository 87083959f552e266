"""dm_control's viewer runs a scene's environment, and the example runs as its text says."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.pictures.opengl import choose_backend

pytest.importorskip("tensegrity_mj.learning.dm_control", exc_type=tmj.errors.MissingPackageError)
from tensegrity_mj.learning.dm_control import RandomStart, environment, repair

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "dm_control_environment.py"
SETTLES_OPENGL = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")


def backend() -> str:
    try:
        return choose_backend()
    except tmj.errors.MissingLibraryError as error:
        pytest.skip(str(error))


def viewers_runtime() -> Any:
    """dm_control.viewer.runtime, where its windows' OpenGL is installed."""
    repair()
    try:
        from dm_control.viewer import runtime
    except (ImportError, AttributeError) as error:  # PyOpenGL's, when it finds no libGL
        pytest.skip(f"dm_control's viewer finds no OpenGL for windows (apt-get install libgl1): {error}")
    return runtime


def test_the_viewers_runtime_plays_pauses_and_restarts() -> None:
    runtime = viewers_runtime()
    env = environment(tmj.load_scene("prism"), time_limit=0.05, start=RandomStart(0.05, 0.0, 1))
    for policy in (None, lambda timestep: 0.5 * timestep.observation["string_lengths"]):
        player = runtime.Runtime(env, policy)
        errors: list[str] = []
        player.on_error += errors.append
        player.tick(0.0, paused=True)
        assert player.state is runtime.State.RUNNING
        for _ in range(10):
            player.tick(0.01, paused=False)
        assert player.state is runtime.State.STOPPED
        assert env.physics.time() == pytest.approx(0.05)
        player.restart()
        player.tick(0.0, paused=True)
        assert env.physics.time() == 0.0
        assert not errors


def test_the_viewer_shows_our_errors_instead_of_ending() -> None:
    runtime = viewers_runtime()
    env = environment(tmj.load_scene("prism"))
    player = runtime.Runtime(env, lambda timestep: np.full(12, np.nan))
    errors: list[str] = []
    player.on_error += errors.append
    player.tick(0.0, paused=True)
    player.tick(0.01, paused=False)
    assert player.state is runtime.State.STOPPED
    assert "string 's1' = nan" in errors[0]


WITHOUT_A_DISPLAY = """
import os
import tensegrity_mj as tmj
from tensegrity_mj.learning.dm_control import environment
env = environment(tmj.load_scene("prism"), time_limit=0.1)
env.reset()
assert env.physics.render(120, 160).std() > 5
assert "MUJOCO_GL" not in os.environ
import dm_control.viewer
assert tmj.pictures.render_frame(tmj.simulate(env.physics.scene, None, duration=0.01), 0.0).std() > 5
"""


def test_it_draws_without_a_display_and_leaves_our_pictures_theirs() -> None:
    """PyOpenGL speaks one kind of OpenGL in a process: a window system's, once chosen, would end the pictures."""
    backend()
    environ = {key: value for key, value in os.environ.items() if key not in SETTLES_OPENGL}
    child = subprocess.run([sys.executable, "-c", WITHOUT_A_DISPLAY], capture_output=True, text=True, env=environ)
    assert child.returncode == 0, child.stderr


# Everything of the application but the window itself: its renderer draws off-screen.
APPLICATION = """
import warnings
warnings.simplefilter("ignore")
from unittest import mock
import tensegrity_mj as tmj
from tensegrity_mj.learning.dm_control import environment, repair
repair()
from dm_control.viewer import application
env = environment(tmj.load_scene("prism"), time_limit=0.1)
requested = []
def policy(timestep):
    requested.append(timestep)
    return env.action_spec().minimum + 0.4
with mock.patch.object(application.gui, "RenderWindow"):
    app = application.Application(width=160, height=120)
    app._environment_loader, app._policy = (lambda: env), policy
    app._load_environment(zoom_to_scene=True)
    app._frame_timer.tick = lambda: 0.02
    app._tick()
    first = app._renderer.pixels.copy()
    app._pause_subject.toggle()
    for _ in range(8):
        app._tick()
    assert app._status._value["Error"] == "--", app._status._value
    assert len(requested) == 10 and app._runtime.state.name == "STOPPED", (len(requested), app._runtime.state)
    assert first.shape == (120, 160, 3) and first.std() > 5, (first.shape, first.std())
    assert (app._renderer.pixels != first).any()
    app._restart_runtime()
    app._tick()
    assert env.physics.time() < 0.05
print("shown")
"""


def test_the_viewers_application_loads_and_draws_the_environment() -> None:
    environ = {**os.environ, "MUJOCO_GL": backend()}
    child = subprocess.run([sys.executable, "-c", APPLICATION], capture_output=True, text=True, env=environ)
    assert child.returncode == 0, child.stderr
    assert "shown" in child.stdout


def example(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The example's run, from another folder, without a display."""
    environ = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, str(EXAMPLE), *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environ)


def table(text: str) -> dict[str, tuple[float, float]]:
    rows = [line.split() for line in text.splitlines()]
    return {row[0]: (float(row[1]), float(row[2])) for row in rows if row and row[0] in ("random", "law")}


@pytest.mark.parametrize("action", ["rest-length", "force-density"])
def test_the_example_shows_that_the_law_beats_chance(
    action: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), "--action", action, "--duration", "3"])

    def printed() -> dict[str, tuple[float, float]]:
        runpy.run_path(str(EXAMPLE), run_name="__main__")
        return table(capsys.readouterr().out)

    results = printed()
    assert results["law"][0] > results["random"][0]
    # V of the law falls as exp(-t): its distance from the target at 3 s is below that at the start, 0.24 m.
    assert results["law"][1] < 0.24
    assert results == printed()
    assert not list(tmp_path.iterdir())


def test_the_example_films(tmp_path: Path) -> None:
    backend()
    run = example("--scene", "pinned_rod", "--duration", "0.2", "--video", "rod.mp4", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "rod.mp4").stat().st_size > 1000


def test_the_example_says_what_is_missing(tmp_path: Path) -> None:
    if sys.platform == "linux":
        run = example("--view", cwd=tmp_path)
        assert run.returncode == 1
        assert run.stderr.splitlines()[-1].startswith("error: the viewer needs a display")
    run = example("--scene", "nowhere", cwd=tmp_path)
    assert run.returncode == 1
    assert "error: " in run.stderr
    assert "Traceback" not in run.stderr


def test_the_guide_runs_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "dm_control.md").read_text(), re.DOTALL)
    assert len(blocks) == 4
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        if "shimmy" not in block:
            exec(compile(block, "docs/dm_control.md", "exec"), names)


def test_the_guide_to_gymnasium_runs_as_printed() -> None:
    pytest.importorskip("shimmy", reason="the extra gym is not installed")
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "dm_control.md").read_text(), re.DOTALL)
    (block,) = [one for one in blocks if "shimmy" in one]
    names: dict[str, Any] = {}
    exec(compile(blocks[0] + block, "docs/dm_control.md", "exec"), names)
    # Its time limit ends it: no state of the scene does.
    assert names["truncated"]
    assert not names["terminated"]
    assert names["env"].action_space.shape == (len(names["scene"].structure.strings),)
    assert names["observation"].shape == names["env"].observation_space.shape
