"""`view`: a scene in the viewer's own loop under its law, a recorded run that is played, and pages for browsers.

No test opens a window: what MuJoCo's viewer is given is looked at in its place.
"""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from analytic_runs import cone_motion, cone_run

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.pictures import palette, viewer
from tensegrity_mj.pictures.motion import Motion
from tensegrity_mj.pictures.painter import SLACK_SEGMENTS, Painter, Sizes


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Stand-ins for MuJoCo's two viewers, which note what they were given."""
    import mujoco.viewer as real

    seen = SimpleNamespace(launched=[], frames=[], presses=[], most=3)

    def launch(model: Any, data: Any) -> None:
        start = data.qvel.copy()
        mujoco.mj_step(model, data, 100)
        mujoco.mj_kinematics(model, data)
        seen.launched.append((model, data, start))

    class Passive:
        def __init__(self, model: Any, data: Any, *, key_callback: Any, **more: Any) -> None:
            self.user_scn = mujoco.MjvScene(model, maxgeom=100)
            self.cam, self.keys, self.count = mujoco.MjvCamera(), list(seen.presses), 0
            self.press, self.lock = key_callback, contextlib.nullcontext
            self.close = lambda: None

        def is_running(self) -> bool:
            self.count += 1
            if self.keys:
                self.press(self.keys.pop(0))
            return self.count <= seen.most

        def set_texts(self, texts: Any) -> None:
            self.words = texts[0][2]

        def sync(self) -> None:
            geoms = [(geom.pos.copy(), geom.size.copy(), geom.rgba.copy()) for geom in self.user_scn.geoms]
            seen.frames.append((geoms[: self.user_scn.ngeom], self.words))

    monkeypatch.setattr(real, "launch", launch)
    monkeypatch.setattr(real, "launch_passive", Passive)
    monkeypatch.setattr(viewer, "require_display", lambda: None)
    return seen


def test_a_scene_is_stepped_under_its_law(windows: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "prism", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"status": "ok", "source": "prism", "shown": "live"}
    ((model, data, _),) = windows.launched
    scene = tmj.load_scene("prism")
    run = tmj.simulate(scene, tmj.controllers.from_scene(scene), duration=0.1)
    sites = [model.site(name).id for name in scene.structure.nodes]
    # The same compiled code, at times that MjData adds up where `simulate` multiplies.
    assert np.abs(data.site_xpos[sites] - run.nodes[-1]).max() < 1e-12


def test_a_scene_without_a_law_falls_and_starts_with_its_velocities(windows: SimpleNamespace) -> None:
    for name in ("prism_drop", "tbar"):
        assert main(["view", name]) == 0
        model, data, start = windows.launched.pop()
        scene = tmj.load_scene(name)
        assert start.any() == bool(np.any(scene.velocities0))
        run = tmj.simulate(scene, duration=0.1)
        sites = [model.site(node).id for node in scene.structure.nodes]
        assert np.abs(data.site_xpos[sites] - run.nodes[-1]).max() < 1e-12


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("cross --duration 0.05", "it has a duration or a speed"),
        ("short.toml --thickness", "--thickness belongs to a run that is played"),
        ("short.toml", "the law keeps something between its calls"),
        ("prism --actuation hold-rest-length --control-period 0.01 --duration 0.05", "--actuation hold-rest-length"),
    ],
)
def test_what_cannot_run_in_the_viewer_is_simulated_first(
    words: str,
    reason: str,
    windows: SimpleNamespace,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    tmj.save_scene(tmj.load_scene("cross").with_(duration=0.05, name="short"), "short.toml")
    assert main(["view", *words.split()]) == 0
    assert f"simulated first, then played: {reason}" in capsys.readouterr().err
    assert not windows.launched
    assert len(windows.frames) == windows.most


def test_a_recorded_run_is_played(windows: SimpleNamespace, tmp_path: Path) -> None:
    run = cone_run()
    run.save(tmp_path / "cone.nc")
    assert main(["view", str(tmp_path / "cone.nc"), "--speed", "0.5"]) == 0
    geoms, words = windows.frames[-1]
    assert words.endswith("of 2 s, 0.5 x")
    assert len(geoms) == 9  # a rod, three strings, the pinned point and three fixed nodes, and the target's rod
    shown = float(words.split()[0])
    nodes = cone_motion(np.array([shown]))[0][0]
    # Middle of the rod: the time is shown to half a millisecond, in which the tip moves by 1.5 sin 0.6 of it; MuJoCo's
    # own lists are single precision.
    assert np.abs(geoms[0][0] - 0.5 * (nodes[0] + nodes[1])).max() < 0.5e-3 * 1.5 * 0.57 + 1e-6
    assert geoms[0][1][0] >= 0.02  # the rod's radius


def test_what_is_played_looks_as_in_films(windows: SimpleNamespace, tmp_path: Path) -> None:
    # Slack strings hang in pieces as long as the string together; --thickness draws strings that pull more thicker, by
    # the root of their tension.
    run = cone_run()
    slack = np.array([3.0, 0.0, 0.0])  # m; only the first string's rest length is longer than it
    replace(run, rest_lengths=np.broadcast_to(slack, run.rest_lengths.shape)).save(tmp_path / "slack.nc")
    replace(run, tensions=np.broadcast_to([0.0, 1.0, 4.0], run.tensions.shape)).save(tmp_path / "pulled.nc")
    assert main(["view", str(tmp_path / "slack.nc")]) == 0
    arc = [2.0 * size[2] for _, size, rgba in windows.frames[0][0] if np.allclose(rgba[:3], palette.SLACK)]
    assert len(arc) == SLACK_SEGMENTS
    # Chords of the twelve pieces of a parabola are shorter than its arc by less than 1 %.
    assert 0.99 * 3.0 < sum(arc) < 3.0
    windows.frames.clear()
    assert main(["view", str(tmp_path / "pulled.nc"), "--thickness"]) == 0
    radii = [size[0] for _, size, _ in windows.frames[0][0][1:4]]
    assert radii[1] / radii[0] == pytest.approx((0.33 + 2.67 * 0.5) / 0.33, rel=1e-5)
    assert radii[2] / radii[0] == pytest.approx(3.0 / 0.33, rel=1e-5)


def test_a_window_without_room_shows_what_it_can() -> None:
    motion, model = Motion.of(cone_run()), mujoco.MjModel.from_xml_string("<mujoco/>")
    painter = Painter(model, scene=mujoco.MjvScene(model, maxgeom=3))
    painter.structure(motion, motion.pose(0.0), Sizes.of(motion.structure, 1.0), palette.TensionScale(1.0))
    assert painter.finish().ngeom == 3  # of a rod and three strings


def test_keys_pause_step_and_change_the_speed(windows: SimpleNamespace, tmp_path: Path) -> None:
    player = viewer.Player(1.0, 3.0)
    assert player.go_on(0.5) == 1.5
    player.press(32)
    assert player.go_on(0.5) == 1.5
    player.press(262)
    player.press(262)
    player.press(263)
    assert player.go_on(0.5) == pytest.approx(1.5 + 2.0 / viewer.STEPS, abs=1e-12)
    player.press(32)
    player.press(61)
    assert player.caption.endswith("of 3 s, 2 x")
    player.press(45)
    player.press(259)
    assert player.go_on(0.25) == 1.25
    assert player.go_on(2.0) == 3.0  # the end, where it stays for a moment
    assert player.go_on(1.0) == 1.0  # and begins again
    player.press(76)
    assert [player.go_on(9.0), player.go_on(9.0)] == [3.0, 3.0]
    assert player.caption.endswith("once")
    windows.presses = [32, 262]
    cone_run().save(tmp_path / "cone.nc")
    assert main(["view", str(tmp_path / "cone.nc")]) == 0
    assert windows.frames[-1][1].endswith("of 2 s, paused")


def test_without_a_display_it_says_what_to_do_instead(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    for words in ("view prism", "run prism --view"):
        assert main(words.split()) == 5
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert "needs a display" in err
        assert "`tensegrity-mj view ... --web` writes a page" in err


def test_pages_of_a_scene_of_a_run_and_beside_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("plotly", reason="the extra 'web' is not installed")
    monkeypatch.chdir(tmp_path)
    cone_run().save("cone.nc")
    for words, frames in {
        "view prism --web --still": 1,
        "view prism --web moving.html --duration 0.2": 81,
        "view cone.nc --web": 81,
        "run prism --duration 0.2 --web beside.html": None,
        "render cone.nc --out rendered.html": 81,
    }.items():
        assert main([*words.split(), "--json"]) == 0
        answer = json.loads(capsys.readouterr().out)
        assert answer.get("frames") == frames
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "beside.html", "cone.html", "cone.nc", "moving.html", "prism.html", "rendered.html",
    ]  # fmt: skip
    assert main(["view", "cone.nc", "--web"]) == 0
    assert capsys.readouterr().out.startswith("cone.html: 81 frames, one each 0.025 s, 4.")


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        ("view", "view: SCENE|FILE.nc: missing; see tensegrity-mj view --help"),
        ("view prism --web p.png", "--web p.png: the name must end in .html or .htm"),
        ("view a.nc --web", "a.nc: no such file"),
        ("view a.nc --norm 1 --web", "--norm needs a scene, and a.nc is a recorded run"),
        ("view a.nc --duration 1", "--duration needs a scene, and a.nc is a recorded run"),
        ("render a.nc b.nc --out p.html", "--out p.html: a page in 3-D shows one run, not 2; name one, or a film"),
        ("render a.nc --out p.html --fps 9", "--fps belongs to a film, and --out names a page"),
        ("view prism --still", "--still needs --web; the window's key for a pause is the space bar"),
        ("render a.nc --out p.html --thickness", "--thickness belongs to a film, and --out names a page"),
        ("run prism --thickness", "--thickness needs --video FILE.mp4"),
        ("run prism --view --fps 20", "--fps needs --video FILE.mp4"),
        ("view prism --web --thickness", "--thickness belongs to the window; a page has a choice of its own"),
        ("view prism --web --speed 2", "--speed belongs to the window; a page has a choice of its own"),
        ("view prism --speed 0", "view: --speed: 0: it must be > 0"),
        ("view prism --law none --norm 1", "--norm needs a control law, and --law none was given"),
    ],
)
def test_what_it_refuses(
    words: str, answer: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    assert capsys.readouterr().err == f"tensegrity-mj: {answer}\n"
    assert not list(tmp_path.iterdir())
