"""A new command is a module and an entry of `GROUPS`; all that commands have in common it has by that."""

from __future__ import annotations

import json

import pytest
import weigh

from tensegrity_mj.cli import GROUPS, main


@pytest.fixture(autouse=True)
def _entry(monkeypatch: pytest.MonkeyPatch) -> None:
    analyses = dict(GROUPS["analyse"]) | {"weigh": weigh}
    monkeypatch.setitem(GROUPS, "analyse", analyses)  # type: ignore[attr-defined]


def test_it_runs_and_answers_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["weigh", "prism"]) == 0
    assert capsys.readouterr().out == "mass  3 kg\n"  # three rods of 1 kg
    assert main(["weigh", "prism", "--of", "point-masses", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"status": "ok", "mass": 0}


def test_help_has_it_in_its_group_and_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--help"], ["weigh", "--help"]):
        with pytest.raises(SystemExit):
            main(words)
    whole, _, own = capsys.readouterr().out.partition("usage: tensegrity-mj weigh")
    assert "  weigh       the mass of a structure\n" in whole.partition("analyse:")[2].partition("many runs:")[0]
    assert "--of {rods,point-masses,all}" in own
    assert "tensegrity-mj weigh prism --of rods" in own
    assert "exit codes:" in own


def test_its_errors_of_usage_are_those_of_all(capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in {
        "wiegh prism": "wiegh: there is no such command; did you mean weigh?",
        "weigh prism --off rods": "weigh: --off: there is no such option; did you mean --of?",
        "weigh prism --of rod": "weigh: --of: 'rod': allowed: rods, point-masses, all; did you mean rods?",
        "weigh": "weigh: SCENE: missing; see tensegrity-mj weigh --help",
    }.items():
        assert main(words.split()) == 2
        assert capsys.readouterr().err == f"tensegrity-mj: {message}\n"
