"""Commands of other distributions: found by their entry points, and named where the evidence is missing."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Iterator
from importlib.metadata import EntryPoint

import pytest

from tensegrity_mj.cli import main
from tensegrity_mj.commands.parser import commands_of_others


@pytest.fixture
def points(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[EntryPoint]]:
    """The entry points that are found, none at first."""
    found: list[EntryPoint] = []
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: found)
    commands_of_others.cache_clear()
    yield found
    commands_of_others.cache_clear()


def test_the_commands_of_the_evidence_say_how_to_install_it(
    points: list[EntryPoint], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reproduce", "5.4", "--json"]) == 5
    said = capsys.readouterr()
    assert "python -m pip install --editable evidence" in json.loads(said.out)["error"]
    assert said.err.startswith("tensegrity-mj: reproduce: comes with tensegrity-mj-evidence: ")
    assert main(["audit", "drift", "prism"]) == 5
    assert main(["runn"]) == 2  # what is nobody's command stays bad usage


def test_a_command_that_cannot_be_imported_is_left_out_with_a_warning(
    points: list[EntryPoint], capsys: pytest.CaptureFixture[str]
) -> None:
    points += [EntryPoint("weigh", "weigh", "any"), EntryPoint("broken", "tensegrity_mj.nowhere", "any")]
    assert main(["weigh", "prism"]) == 0
    said = capsys.readouterr()
    assert said.out == "mass  3 kg\n"
    assert "tensegrity_mj.nowhere cannot be loaded" in said.err
    commands_of_others.cache_clear()
    assert main(["scenes", "--json"]) == 0  # an own command looks for no others
    assert not capsys.readouterr().err
