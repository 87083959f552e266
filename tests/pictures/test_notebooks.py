"""What notebooks show: of runs five lines and a plot, of scenes a picture, of files of pictures these themselves."""

from __future__ import annotations

import base64
import pickle
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import MissingLibraryError
from tensegrity_mj.pictures import opengl, plots, video
from tensegrity_mj.pictures.video import ShownFile


def test_a_run_is_five_lines(prism_run: tmj.Trajectory) -> None:
    lines = repr(prism_run).splitlines()
    assert lines[:4] == [
        "run of  prism: 6 nodes, 3 rods, 12 strings",
        f"engine  {prism_run.engine}",
        "time    0 to 0.1 s, 11 samples",
        "status  completed",
    ]
    assert lines[4:] == [f"errors  energy off by {prism_run.energy_residual:.2g} J"]
    reports = prism_run.reports | {"warnings": ["its step is too long\x1b[2J", "another"]}
    message = "no admissible solution at t = 0.1 s " * 20
    ended = replace(prism_run, reports=reports, status=tmj.Status.INFEASIBLE, message=message)
    lines = repr(ended).splitlines()
    assert len(lines) == 5
    assert lines[3].startswith("status  infeasible: no admissible solution at t = 0.1 s")
    assert lines[4].endswith(r"J; 2 warnings: its step is too long\x1b[2J")
    assert max(map(len, lines)) <= 108
    assert len(repr(prism_run.until(0)).splitlines()) == 5


def test_a_runs_page_is_a_table_and_a_plot(prism_run: tmj.Trajectory) -> None:
    page = ElementTree.fromstring(f"<div>{prism_run._repr_html_().rstrip('>')}/></div>")
    assert [cell.text for cell in page.iter("th")] == ["run of", "engine", "time", "status", "errors"]
    (plot,) = page.iter("img")
    kind, _, data = plot.get("src", "").partition(",")
    assert kind == "data:image/png;base64"
    assert base64.b64decode(data) == plots.png_of(prism_run)
    calm = replace(prism_run, tensions=0 * prism_run.tensions)
    assert plots.png_of(calm) != plots.png_of(prism_run)  # heights


def test_names_of_a_scene_stay_text_in_a_page(prism_run: tmj.Trajectory) -> None:
    named = replace(prism_run, scene=prism_run.scene.with_(name="<script>alert(1)</script>"))
    assert "<script>" not in named._repr_html_()


def test_without_strings_heights_are_shown_and_without_samples_a_table_alone() -> None:
    mass = tmj.Structure("mass", {"n<1>": (0.0, 0.0, 0.0)}, point_masses=(tmj.PointMass("n<1>", 1.0),))
    prism_run = tmj.simulate(tmj.Scene(mass, gravity=(0, 0, -9.81)), None, tmj.DAE(), duration=0.1)
    assert "<img" in prism_run._repr_html_()
    assert "<img" not in prism_run.until(0)._repr_html_()
    assert "<img" not in prism_run.until(1)._repr_html_()


def test_a_scene_is_one_line_and_shows_its_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tmj.load_scene("prism")
    assert repr(scene) == "<Scene 'prism': 6 nodes, 3 rods, 12 strings, law lyapunov, 10 s>"
    png = scene._repr_png_()
    if png is None:
        pytest.skip("no OpenGL on this machine")
    assert png.startswith(b"\x89PNG")

    def none() -> str:
        raise MissingLibraryError("no OpenGL")

    monkeypatch.setattr(opengl, "choose_backend", none)
    assert scene._repr_png_() is None  # a notebook shows the text


def test_the_file_of_a_picture_is_a_path_that_shows_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tmj.load_scene("prism")
    try:
        path = tmj.pictures.picture(scene, tmp_path / "prism.png", size=(64, 64))
    except MissingLibraryError:
        pytest.skip("no OpenGL on this machine")
    assert isinstance(path, Path)
    assert path == tmp_path / "prism.png"
    assert hash(path) == hash(tmp_path / "prism.png")
    assert pickle.loads(pickle.dumps(path)) == path
    shown = re.fullmatch('<img src="data:image/png;base64,([^"]+)">', path._repr_html_())
    assert shown is not None
    assert base64.b64decode(shown[1]) == path.read_bytes()
    monkeypatch.setattr(video, "MOST_EMBEDDED", 10)
    assert path._repr_html_() == f"<code>{path}</code>"


def test_videos_play_and_other_files_are_named(tmp_path: Path) -> None:
    film = ShownFile(tmp_path / "a.mp4")
    assert film._repr_html_() == f"<code>{film}</code>"  # there is none
    film.write_bytes(b"film")
    assert film._repr_html_() == '<video controls loop src="data:video/mp4;base64,ZmlsbQ=="></video>'
    assert film.parent._repr_html_() == f"<code>{tmp_path}</code>"  # type: ignore[attr-defined]


def test_a_figure_is_shown_without_pyplot(prism_run: tmj.Trajectory) -> None:
    assert plots.plot_motion(prism_run)._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
