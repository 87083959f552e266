"""`tensegrity-mj stability`: its limits are those of `stable_step`, on its page too, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_words import choices_of

import tensegrity_mj as tmj
from tensegrity_mj.cli import main
from tensegrity_mj.engines.table import NAMES, TITLES
from tensegrity_mj.studies.stable_steps import predict_steps


def test_the_words_of_the_command_are_those_of_the_study() -> None:
    assert choices_of("stability", "--engines") == list(NAMES)
    assert set(TITLES) == set(NAMES)


def test_limits_are_those_of_stable_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At the start and along the run that the command makes: of the DAE, under the scene's law."""
    scene = tmj.load_scene("prism")
    assert main(["stability", "prism", "--engines", "rk4", "discrete", "--out", str(tmp_path), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    run = tmj.simulate(scene, engine="dae")
    for name, engine in (("rk4", tmj.MuJoCo(1.0)), ("discrete", tmj.MuJoCo(1.0, tmj.Integrator.DISCRETE))):
        found = data["start"]["engines"][name]
        for when, expected in (
            ("start", tmj.stable_step(scene, engine)),
            ("worst", tmj.stable_step(scene, engine, run=run)),
        ):
            assert found[when]["limit"] == (expected.limit if expected.limit < float("inf") else None)
    least = min(one["worst"]["limit"] for one in data["start"]["engines"].values())
    assert data["verdict"] == f"2 of 2 engines limit the step of prism; the smallest limit is {1e3 * least:.3g} ms."
    assert [one["mark"] for one in data["findings"]] == ["limited"]
    assert "edge of slackness" in data["findings"][0]["text"]
    page = (tmp_path / "stability.html").read_text(encoding="utf-8")
    assert f'<td class="n">{least:.4g}</td>' in page
    assert json.loads((tmp_path / "stability.json").read_text())["start"] == data["start"]


def test_an_engine_that_refuses_the_scene_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "ladder", "--engines", "ode"]) == 0
    text = capsys.readouterr().out
    assert "0 of 1 engines limit the step of ladder." in text
    assert "not judged  ODE RK4: ODE refuses the scene: constraint 'wall'" in text


def test_a_loop_is_closed_by_a_law_of_every_stage_alone() -> None:
    """The scene's own law is left out where it switches; one that is given is refused."""
    assert main(["stability", "prism", "--open-loop", "--law", "lyapunov"]) == 2
    assert not predict_steps(tmj.load_scene("pinned_rod"), law=None, engines=["rk4"]).data["start"]["closed_loop"]
    with pytest.raises(tmj.errors.OptionError, match="did you mean 'rk4'"):
        predict_steps(tmj.load_scene("prism"), engines=["rk"])


@pytest.mark.parametrize("wrong", [["nowhere"], ["prism", "--engines", "rk"], ["prism", "--maps", "damping"]])
def test_bad_usage_is_refused(wrong: list[str]) -> None:
    assert main(["stability", *wrong]) == 2


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    assert main(["audit", "stability", "prism", "--out", str(file)]) == 2
