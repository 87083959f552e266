"""`tensegrity-mj audit stability`: what it writes, that it is the same each time, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_words import choices_of

from evidence.stability.cases import AXES
from evidence.stability.page import describe, judgement_of
from tensegrity_mj.cli import main
from tensegrity_mj.engines.table import NAMES, TITLES

SMALL = ["pinned_rod", "--engines", "rk4", "--maps", "damping", "--quick", "--random", "1", "--workers", "1"]


def test_the_words_of_the_command_are_those_of_the_study() -> None:
    assert choices_of("audit stability", "--engines") == list(NAMES)
    assert choices_of("audit stability", "--maps") == list(AXES)
    assert set(TITLES) == set(NAMES)


def test_a_small_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["audit", "stability", *SMALL, "--out", str(tmp_path / "a"), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["status"] == "ok"
    assert data["base"]["engines"]["rk4"]["ratio"] == pytest.approx(1, abs=0.02)
    assert data["start"]["engines"]["rk4"]["start"]["limit"] is None or data["start"]["closed_loop"]
    assert [row["value"] for row in data["maps"]] == [0.0, 0.3, 10.0]
    assert data["random"]["summary"]["comparisons"] == 1
    assert data["random"]["summary"]["agree"] == 1
    assert data["joined"]["summary"]["comparisons"] == data["joined"]["summary"]["agree"] == 1
    page = (tmp_path / "a" / "index.html").read_text(encoding="utf-8")
    assert "Random taut structures" in page
    assert "Random structures whose rods share nodes" in page
    assert page.count("<img") == 3
    assert sorted(path.stem for path in (tmp_path / "a").glob("*.png")) == ["heat", "maps", "random"]
    assert all(path.stat().st_size > 5000 for path in (tmp_path / "a").glob("*.png"))
    text = "\n".join(describe(data))
    assert "1 of 1" in text
    assert "seed 0" in text
    # The same again, from scratch and in memory: bit-identical.
    assert main(["audit", "stability", *SMALL, "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert {**again, "out": None} == {**data, "out": None}


def test_the_page_of_a_step_without_a_limit(tmp_path: Path) -> None:
    # Prestress holds none of the T-bar's motions alone, so that `discrete` is stable at any step.
    assert main(["audit", "stability", "tbar", "--engines", "discrete", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "MuJoCo discrete: predicted none, measured none up to " in page


def test_a_limit_that_nothing_showed_is_not_judged_and_what_nothing_explains_is_bad() -> None:
    none = {"predicted": None, "measured": None, "largest": 1.0, "agrees": True, "ratio": 1.0, "cause": ""}
    met = {"predicted": 1.0, "measured": 0.98, "largest": 1.0, "agrees": True, "ratio": 1.02, "cause": ""}
    off = met | {"predicted": 2.0, "ratio": 2.04, "agrees": False}
    data = {
        "scene": "x",
        "base": {
            "text": "x",
            "stand_in": False,
            "engines": {
                "discrete": none,
                "euler": met,
                "implicit": off | {"cause": "a rod near the pole of the ODE's angles"},
                "rk4": off | {"cause": "not explained (nothing grew)"},
            },
        },
        "random": {"failed": 3, "summary": {"structures_agree": 0, "structures": 0, "allowed": 0.1}},
    }
    found = judgement_of(data)
    assert [one.mark.value for one in found.findings] == ["not judged", "good", "limited", "bad", "not judged"]
    assert "allowed 1 ± 0.1" in found.findings[1].text
    assert found.findings[-1].text.endswith("3 could not be computed.")
    alone = judgement_of({"scene": "x", "base": {"engines": {}}})
    assert alone.verdict == "The step of x is not judged: no engine that was chosen simulates it."


@pytest.mark.parametrize(
    "wrong", [["nowhere"], ["prism", "--random", "0"], ["prism", "--seed", "-1"], ["prism", "--maps", "colour"]]
)
def test_bad_usage_is_refused(wrong: list[str]) -> None:
    assert main(["audit", "stability", *wrong]) == 2
