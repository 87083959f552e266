"""Reports: everything is in the one page, nothing is fetched from elsewhere, and text stays text."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from analytic_runs import cone_run, cone_scene

from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures.page import Picture, Table, write_report
from tensegrity_mj.pictures.plots import plot_run
from tensegrity_mj.runs.comparison import compare


class Page(HTMLParser):
    """What a browser would see: tags with attributes, text, rows of tables; unclosed tags are counted."""

    VOID = ("meta", "img", "br")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "title"):
            self.text += data
        if self.rows and any(tag in ("td", "th") for tag in self.open):
            self.rows[-1][-1] += data

    def row(self, name: str) -> list[str]:
        return next(row[1:] for row in self.rows if row and row[0] == name)


def page_of(path: Path) -> Page:
    page = Page(path.read_text(encoding="utf-8"))
    assert page.open == []
    return page


def test_a_report_holds_everything_itself(tmp_path: Path):
    film = tmp_path / "film.mp4"
    film.write_bytes(bytes(range(256)) * 3)
    run, other = cone_run(engine="MuJoCo RK4"), cone_run(engine="DAE DOP853")
    path = write_report(
        tmp_path / "report.html",
        [run, other],
        comparison=compare(run, other),
        pictures=[Picture(plot_run(run), "Errors over time")],
        video=film,
        tables=[Table("Steps", ("step [s]", "error [m]"), [(1e-3, 1.234567e-9), (5e-3, None)])],
    )
    page = page_of(path)
    sources = {tag: attributes["src"] for tag, attributes in page.tags if "src" in attributes}
    assert base64.b64decode(sources["video"].removeprefix("data:video/mp4;base64,")) == film.read_bytes()
    assert base64.b64decode(sources["img"].removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")
    text = path.read_text(encoding="utf-8")
    assert "http://" not in text
    assert "https://" not in text
    assert not any(name in attributes for _, attributes in page.tags for name in ("href", "srcset", "onclick"))
    assert not any(tag in ("script", "link", "iframe") for tag, _ in page.tags)
    policy = next(a["content"] for tag, a in page.tags if tag == "meta" and a.get("http-equiv"))
    assert policy.startswith("default-src 'none'")
    assert any(a.get("name") == "viewport" for tag, a in page.tags if tag == "meta")
    assert "Errors over time" in page.text
    assert page.row("0.001") == ["1.235e-09"]
    assert page.row("0.005") == ["–"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["film.mp4", "report.html"]


def test_a_report_has_the_numbers(tmp_path: Path):
    run = cone_run(engine="first")
    nodes = run.nodes.copy()
    nodes[:, 1, 2] += 3e-4
    other = replace(run, nodes=nodes, engine="second", message="", reports={"drift": 2.5e-15})
    page = page_of(write_report(tmp_path / "report.html", [run, other], comparison=compare(run, other, tolerance=1e-4)))
    # The table has the difference; the finding has its tolerance, too, and the time since when it is beyond that.
    assert page.row("largest node error") == ["300 µm"]
    assert "the largest node error is 300 µm (allowed 100 µm, exceeded from 0 s on)" in page.text
    assert re.search(r"the largest tension error is [^()]* \(allowed 100 µN\)", page.text)
    assert page.row("status") == ["completed", "completed"]
    # The rod's end is 0.5910 m from its target: the chord of the tilt 0.6.
    assert page.row("distance to the target at the end")[0] == "0.591 m"
    assert page.row("largest force density u") == [f"{run.max_force_density:.4g} N/m"] * 2
    assert page.row("energy residual") == ["999.6 pJ"] * 2  # the largest of 1e-9 |sin t| at the samples
    assert page.row("wall time") == ["0.5 s", "0.5 s"]
    # What else was recorded, each run's by itself; groups become lines of their own.
    assert page.row("largest constraint drift [m]") == ["1.5e-13"]
    assert page.row("drift") == ["2.5e-15"]
    assert page.row("options: timestep") == ["0.001"]


def test_a_report_begins_with_its_verdict_and_has_no_dump_of_dictionaries(tmp_path: Path):
    run = cone_run(engine="MuJoCo RK4")
    run = replace(run, provenance={"controller": {"law": "lyapunov", "norm": 2, "u": [0.0] * 12}, "duration": 2.0})
    other = replace(run, engine="DAE DOP853", nodes=run.nodes + 1e-9)
    path = write_report(tmp_path / "report.html", [run, other], comparison=compare(run, other))
    page, text = page_of(path), path.read_text(encoding="utf-8")
    first = next(i for i, (_, attributes) in enumerate(page.tags) if attributes.get("class") == "verdict")
    assert not any(tag in ("table", "img", "video") for tag, _ in page.tags[:first])
    assert "MuJoCo and the DAE agree to 1.7 nm over 2 s (allowed 29 mm); the target is missed by 0.59 m" in page.text
    assert page.row("law") == ["lyapunov, norm 2"]
    assert page.row("controller: u") == ["0 (12 times)"]
    assert "{" not in text[text.index("<body>") :]


def test_text_stays_text(tmp_path: Path):
    evil = "<script>alert('x')</script> & \"more\""
    scene = cone_scene(evil)
    run = replace(cone_run(scene=scene, engine=evil), message=evil, provenance={evil: evil}, reports={evil: evil})
    path = write_report(
        tmp_path / "report.html",
        [run],
        introduction=evil,
        pictures=[Picture(plot_run(cone_run()), evil)],
        tables=[Table(evil, (evil, evil), [(evil, evil)], note=evil)],
        video_note=evil,
    )
    page = page_of(path)
    assert not any(tag == "script" for tag, _ in page.tags)
    assert page.text.count(evil) >= 10
    assert next(a for tag, a in page.tags if tag == "img")["alt"] == evil


def test_a_report_can_do_without_a_video_and_say_why(tmp_path: Path):
    page = page_of(write_report(tmp_path / "report.html", [cone_run()], video_note="No video: no OpenGL."))
    assert "No video: no OpenGL." in page.text
    assert not any(tag == "video" for tag, _ in page.tags)


def test_what_cannot_be_reported_is_refused(tmp_path: Path):
    run = cone_run()
    with pytest.raises(OptionError, match="at least one run"):
        write_report(tmp_path / "report.html", [])
    with pytest.raises(OptionError, match="html"):
        write_report(tmp_path / "report.txt", [run])
    with pytest.raises(OptionError, match=r"film\.mp4"):
        write_report(tmp_path / "report.html", [run], video=tmp_path / "film.mp4")
    with pytest.raises(OptionError, match="mp4"):
        write_report(tmp_path / "report.html", [run], video=tmp_path / "film.avi")
    with pytest.raises(OptionError, match="png"):
        write_report(tmp_path / "report.html", [run], pictures=[Picture(tmp_path / "plot.svg")])
    assert not list(tmp_path.iterdir())
