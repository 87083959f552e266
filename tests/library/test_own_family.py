"""A new family is a function in a file of `library/` and a row of its table: every command calls it by its name."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import tensegrity_mj as tmj
from tensegrity_mj import library
from tensegrity_mj.cli import main
from tensegrity_mj.library import named

FAMILY = '''
"""Plumb lines: rods that hang from pins, each by itself."""

from tensegrity_mj.basics.checks import positive, whole
from tensegrity_mj.model.members import Rod, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure


def plumb(length: float = 1.0, mass: float = 2.0, count: int = 1) -> Scene:
    positive("plumb: length", length, "m")
    rows = range(whole("plumb: count", count, 1))
    nodes = {f"{end}{n}": (float(n), 0.0, z) for n in rows for end, z in (("pin", 0.0), ("bob", -length))}
    rods = tuple(Rod(f"rod{n}", (f"pin{n}", f"bob{n}"), mass, support=Support.pinned()) for n in rows)
    return Scene(Structure("plumb", nodes, rods), gravity=(0.0, 0.0, -9.81), duration=1.0)
'''


@pytest.fixture(autouse=True)
def _plumb(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    (tmp_path / "plumb.py").write_text(FAMILY, encoding="utf-8")
    monkeypatch.setattr(library, "__path__", [*library.__path__, str(tmp_path)])
    monkeypatch.setitem(named._HOME, "plumb", "plumb")
    yield
    sys.modules.pop("tensegrity_mj.library.plumb", None)


def answer(capsys: pytest.CaptureFixture[str], *words: Any) -> Any:
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_commands_and_sweeps_call_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert len(tmj.load_scene("plumb(count=3)").structure.rods) == 3
    # A thin rod about its end: ω² = m g (ℓ/2) / (m ℓ²/3).
    found = answer(capsys, "linearize", "plumb(length=2.0)", "--engine", "dae")["frequencies"]
    assert found == pytest.approx([math.sqrt(1.5 * 9.81 / 2.0) / (2 * math.pi)] * len(found), rel=1e-6)
    words = ["plumb()", "--set", "scene.duration=0.1", "--backend", "this-process"]
    assert answer(capsys, "sweep", *words, "--vary", "family.length=1,2")["ended"] == {"completed": 2}
    assert main(["sweep", *words, "--vary", "family.length=1,-1"]) == 2
    assert "plumb: length = -1.0; it must be a finite number > 0 m" in capsys.readouterr().err


def test_what_it_has_not_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in {
        "run plum()": "unknown family 'plum' (did you mean 'plumb'?)",
        "run plumb(lenght=2)": "plumb: unknown argument 'lenght' (did you mean 'length'?); it has length, mass, count",
        "run plumb(count=1.5)": "plumb: count = 1.5; it must be an integer",
    }.items():
        assert main(words.split()) == 2
        assert message in capsys.readouterr().err
