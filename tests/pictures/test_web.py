"""Pages in 3-D: their data, read out of the HTML, are the run's; and in a browser, where there is one, they work."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_runs import cone_motion, cone_run, cone_scene, two_masses

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import MissingPackageError, OptionError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model.elements.terrain import Stairs
from tensegrity_mj.model.events import Break
from tensegrity_mj.model.members import Rod
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures import web
from tensegrity_mj.pictures.page import Section, write_report, write_sections
from tensegrity_mj.pictures.web import WebPage, make_web_page
from tensegrity_mj.runs.trajectory import Status, Trajectory

pytest.importorskip("plotly", reason="the extra 'web' is not installed")


def data_of(page: WebPage) -> dict[str, Any]:
    """The JSON that the page draws from, its packed numbers as arrays."""
    found = re.search(r'<script id="run" type="application/json">(.*?)</script>', page.text, re.DOTALL)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    for name in ("time", "nodes", "tensions", "rest", "target"):
        if data[name] is not None:
            data[name] = np.frombuffer(base64.b64decode(data[name]), "<f4").astype(float)
    return data


def test_positions_and_tensions_are_the_runs() -> None:
    run = cone_run()
    page = make_web_page(run)
    data = data_of(page)
    times = data["time"]
    # 2 s at 60 a second are fewer than 200 frames, in place of which each of 20 intervals between samples has four.
    assert len(times) == page.frames == 81
    assert page.interval == pytest.approx(2.0 / 80, rel=1e-12)
    # Single precision: half a unit of the 24th digit of values below 2, beside the interpolation's own 1.5e-6 m: for
    # samples 0.1 s apart 0.1⁴/384 of 1.5⁴ sin 0.6, see test_render.py.
    assert np.abs(data["nodes"].reshape(-1, 5, 3) - cone_motion(times)[0]).max() < 2**-24 + 0.1**4 / 384 * 1.5**4 * 0.57
    shown = data["tensions"].reshape(-1, 3)
    assert np.abs(shown[::4] - run.tensions).max() < 2**-24 * run.tensions.max()
    assert np.abs(data["rest"].reshape(-1, 3)[::4] - run.rest_lengths).max() < 2**-24 * run.rest_lengths.max()


def test_members_are_tied_to_the_nodes_of_the_structure() -> None:
    scene = cone_scene()
    data = data_of(make_web_page(scene))
    names = data["names"]
    assert [names["nodes"][row] for row in data["rods"][0][:2]] == ["o", "tip"]
    assert [[names["nodes"][row] for row in segment[:2]] for segment in data["strings"]] == [
        list(string.nodes) for string in scene.structure.strings
    ]
    assert [segment[2] for segment in data["strings"]] == [0, 1, 2]  # whose tension and rest length it has
    assert names["strings"] == ["s0", "s1", "s2"]
    assert data["supports"] == [[2, 2, 0.0], [3, 3, 0.0], [4, 4, 0.0], [0, 1, 0.0]]
    assert data["drawn"] == ["nodes", "rods", "strings", "supports", "target"]
    assert len(data["time"]) == 1


def test_the_target_and_masses_are_there_where_the_scene_has_them() -> None:
    data = data_of(make_web_page(cone_scene()))
    assert data["target"].reshape(-1, 5, 3)[0, 1] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
    masses = data_of(make_web_page(two_masses()))
    assert "masses" in masses["drawn"]
    assert {"rods", "target", "supports", "floor", "water"}.isdisjoint(masses["drawn"])


def test_axes_are_equal_and_see_all_of_the_run() -> None:
    run = cone_run()
    data = data_of(make_web_page(run))
    center, half = np.array(data["center"]), np.array(data["half"])
    points = np.concatenate([run.nodes.reshape(-1, 3), data["target"].reshape(-1, 3)])
    assert np.all(np.abs(points - center) < half)
    assert_seen(data, np.array(data["eye"]), web.ASPECT)


def assert_seen(data: dict[str, Any], eye: Array, aspect: float) -> None:
    """Check that a box's corners lie within the half angles of a view of that width over height.

    The eye is given in twice the largest half.
    """
    half, forward = np.array(data["half"]), -eye / np.linalg.norm(eye)
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * half / half.max() - eye
    ahead = corners @ forward
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    assert np.all(np.abs(corners @ right) < aspect * web.HALF_VIEW * ahead)
    assert np.all(np.abs(corners @ np.cross(right, forward)) < web.HALF_VIEW * ahead)


def test_a_run_that_travels_far_is_followed() -> None:
    run = cone_run()
    drift = 5.0 * run.time[:, None, None] * np.array([1.0, 0.0, 0.0])
    away = replace(run, nodes=run.nodes + drift, velocities=run.velocities + np.array([5.0, 0.0, 0.0]))
    near, far = data_of(make_web_page(run)), data_of(make_web_page(away))
    assert (near["follow"], far["follow"]) == (False, True)
    assert max(far["half"]) < 2.0 * max(near["half"])


def test_floor_and_water_are_drawn_where_they_are_near() -> None:
    drop = load_scene("prism_drop")
    data = data_of(make_web_page(drop))
    assert "floor" in data["drawn"]
    assert np.array(data["floor"]["points"])[:, 2] == pytest.approx(np.zeros(4), abs=1e-12)
    assert data["center"][2] - data["half"][2] < 0.0
    assert drop.contact is not None
    stairs = Stairs(rise=-0.07, tread=0.3)
    ground = data_of(make_web_page(drop.with_(contact=replace(drop.contact, terrain=stairs))))["floor"]
    points, faces = np.array(ground["points"]), np.array(ground["faces"])
    np.testing.assert_allclose(points[:, 2], stairs.height(points[:, :2]), rtol=0, atol=1e-12)
    assert len(np.unique(faces)) == len(points) > 100
    waves = load_scene("tower_waves")
    data = data_of(make_web_page(waves))
    assert "water" in data["drawn"]
    assert waves.water is not None
    assert [row[0] for row in data["sea"]] == [wave.amplitude for wave in waves.water.waves]
    deep = load_scene("shape_control")  # 7 m below the surface, and 1 m tall
    assert "water" not in data_of(make_web_page(deep))["drawn"]


def test_strings_that_hang_and_that_break_are_known() -> None:
    run = cone_run()
    assert "slack" not in data_of(make_web_page(run))["drawn"]
    lengths = run.scene.structure.string_lengths(run.nodes)
    loose = replace(run, rest_lengths=np.where(np.arange(3) == 1, 1.2 * lengths, run.rest_lengths))
    assert "slack" in data_of(make_web_page(loose))["drawn"]
    breaking = cone_run(scene=cone_scene().with_(breaks=(Break("s2", 0.5),)))
    assert data_of(make_web_page(breaking))["breaks"] == [None, None, 0.5]


def test_how_a_run_ended_stands_in_its_page() -> None:
    page = make_web_page(replace(cone_run(), status=Status.INFEASIBLE))
    assert '<span class="note">infeasible at t = 2 s</span>' in page.text
    with pytest.raises(OptionError, match="no sample"):
        make_web_page(cone_run().until(0))


def test_a_page_keeps_below_its_limit_by_taking_fewer_frames() -> None:
    # 300 rods, 600 nodes, for 100 s in 501 samples: 1801 numbers a frame, 9.6 kB packed, of which 3.1 MB hold 330.
    nodes = {f"n{k}": (float(k % 20), float(k // 20), float(k % 2)) for k in range(600)}
    rods = tuple(Rod(f"r{k}", (f"n{2 * k}", f"n{2 * k + 1}"), 1.0, 0.01) for k in range(300))
    scene = Scene(Structure("many", nodes, rods=rods), name="many")
    times = np.linspace(0.0, 100.0, 501)
    still = np.repeat(scene.nodes0[None], 501, axis=0)
    small = cone_run()
    empty = np.zeros((501, 0))
    arrays = {name: np.zeros(501) for name, value in vars(small).items() if getattr(value, "shape", None) == (21,)}
    run = Trajectory(
        scene,
        **arrays
        | {"time": times, "nodes": still, "velocities": np.zeros_like(still)}
        | dict.fromkeys(("force_densities", "rest_lengths", "tensions"), empty)
        | dict.fromkeys(("multipliers", "rod_force_densities"), np.zeros((501, 300))),
    )
    page = make_web_page(run)
    assert 300 < page.frames < 360
    assert 0.95 * web.MOST_BYTES < len(page.text.encode()) < web.MOST_BYTES
    assert f"{page.frames} frames, one each" in page.describe()


def test_pages_are_the_same_every_time_and_load_nothing(tmp_path: Path) -> None:
    one, other = make_web_page(cone_run()), make_web_page(cone_run())
    assert one.text == other.text
    own = one.text.replace(web.plotly_script(), "")
    assert "http" not in own.replace('http-equiv="Content-Security-Policy"', "")
    assert "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:" in own
    path = one.save(tmp_path / "cone.html")
    assert path.read_text(encoding="utf-8") == one.text
    with pytest.raises(OptionError, match=r"must end in \.html"):
        one.save(tmp_path / "cone.txt")
    assert [one.name for one in tmp_path.iterdir()] == ["cone.html"]


def test_names_from_a_file_stay_text() -> None:
    nodes = {"</script><script>alert(1)": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0)}
    rods = (Rod("<b>", tuple(nodes), 1.0, 0.02),)
    page = make_web_page(Scene(Structure("s", nodes, rods=rods), name="<i>\u202e$title"))
    assert "<title>&lt;i&gt;\\u202e$title</title>" in page.text
    assert page.text.count("</script>") == 3
    assert data_of(page)["names"]["rods"] == ["&lt;b&gt;"]


def test_without_plotly_the_error_has_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(MissingPackageError, match=r"python -m pip install \"plotly"):
        make_web_page(cone_scene())


def test_a_page_is_embedded_in_a_report_and_in_no_other_are_scripts(tmp_path: Path) -> None:
    plain = write_report(tmp_path / "plain.html", [cone_run()]).read_text(encoding="utf-8")
    assert "script-src" not in plain
    full = write_report(tmp_path / "full.html", [cone_run()], web=True).read_text(encoding="utf-8")
    assert "script-src 'unsafe-inline'\">" in full
    assert full.count("<iframe") == 1
    framed = write_sections(
        tmp_path / "s.html", "t", "", [Section("3-D", parts=[make_web_page(cone_scene()).framed(300)])]
    )
    assert "height:300px" in framed.read_text(encoding="utf-8")


# In a browser --------------------------------------------------------------------------------------------------------

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
BROWSER = os.environ.get("TENSEGRITY_MJ_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), None)
FLAGS = ("--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
DRIVER = """
(async () => {
  const wait = ms => new Promise(done => setTimeout(done, ms)), told = [];
  document.addEventListener("securitypolicyviolation", event => told.push("refused " + event.blockedURI));
  window.addEventListener("error", event => told.push("error " + event.message));
  while (document.body.dataset.ready !== "yes") await wait(50);
  told.push("at start " + get("clock").textContent);
  await seek(1.0);
  told.push("tip " + ["x", "y", "z"].map(k => traces.nodes[k][1].toFixed(5)).join(" "));
  told.push("eye " + ["x", "y", "z"].map(k => layout.scene.camera.eye[k]).join(" "));
  told.push("slider " + get("time").clientWidth / innerWidth);
  told.push("view " + innerWidth / (innerHeight - 100));
  told.push("tension " + traces.strings.customdata[0].toFixed(6));
  playing = true;
  step(1000);
  now = 1.0;
  step(1500);
  told.push("after half a second " + get("clock").textContent);
  play(false);
  document.body.dataset.told = told.join("\\n");
})();
"""


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason=f"none of {', '.join(BROWSERS)} is installed (or TENSEGRITY_MJ_BROWSER)")
@pytest.mark.parametrize("size", ["1200,800", "500,1000"])
def test_in_a_browser_it_seeks_and_plays_and_loads_nothing(tmp_path: Path, size: str) -> None:
    run = cone_run()
    path = tmp_path / "cone.html"
    path.write_text(make_web_page(run).text + f"<script>{DRIVER}</script>", encoding="utf-8")
    flags = (*FLAGS, f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={size}", "--virtual-time-budget=60000")
    answer = subprocess.run(
        [str(BROWSER), *flags, "--dump-dom", path.as_uri()], capture_output=True, text=True, timeout=300, check=False
    )
    found = re.search(r'<body data-ready="yes" data-told="([^"]*)"', answer.stdout)
    assert found, answer.stderr[-2000:]
    told = dict(line.partition(" ")[::2] for line in found[1].splitlines())
    assert told["at"] == "start 0.00 / 2.00 s"
    tip = cone_motion(np.array([1.0]))[0][0, 1]
    # 1 s lies on a frame, but for single precision: five decimals of it.
    assert np.array(told["tip"].split(), float) == pytest.approx(tip, abs=1.1e-5)
    assert float(told["tension"]) == pytest.approx(run.tensions[10, 0], abs=1.1e-6)
    # The corners of the box are seen; on a phone the slider has a line almost of its own.
    assert_seen(data_of(make_web_page(run)), np.array(told["eye"].split(), float), min(web.ASPECT, float(told["view"])))
    assert float(told["slider"]) > 0.6
    assert told["after"] == "half a second 1.50 / 2.00 s"
    assert {"refused", "error"}.isdisjoint(told)
