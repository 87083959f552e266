"""`tensegrity-mj import`: a file in, a scene out; what is not carried over stands on stderr and in it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import tensegrity_mj as tmj
from tensegrity_mj.cli import build_parser, main
from tensegrity_mj.exchange import FORMATS

DATA = Path(__file__).resolve().parents[1] / "data" / "exchange"


def test_a_file_becomes_a_scene_that_loads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "prism.toml"
    assert main(["import", str(DATA / "ntrt" / "prism.yaml"), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert said.out == f"{out}: 6 nodes, 3 rods, 9 strings\n"
    notes = [line for line in said.err.splitlines() if line.startswith("note: ")]
    text = out.read_text(encoding="utf-8")
    assert len(notes) == 3
    for note in notes:
        assert f"# - {note.removeprefix('note: ')}\n" in text
    assert "# Imported (NTRT's YAML structures). Differences from the source file:\n# - " in text
    assert tmj.load_scene(out).structure.class_number == 1


def test_json_and_values_that_the_file_does_not_give(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "one.m"
    script.write_text("N = [0 1 2; 0 0 0; 0 0 0]; C_b = [-1 1 0]; C_s = [0 -1 1]; % nothing else\n")
    out = tmp_path / "one.toml"
    words = ["import", str(script), "--out", str(out), "--from", "matlab", "--rod-mass", "2", "--node-mass", "0.5"]
    assert main(words) == 2
    assert "it gives no stiffness of strings" in capsys.readouterr().err
    assert not out.exists()
    assert main([*words, "--stiffness", "30", "--damping", "0.1", "--rod-radius", "0.03", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["nodes"], answer["rods"], answer["strings"], answer["format"]) == (3, 1, 1, "matlab")
    structure = tmj.load_scene(out).structure
    assert (structure.rods[0].mass, structure.rods[0].radius, structure.strings[0].damping) == (2.0, 0.03, 0.1)
    assert structure.point_masses[0].mass == 0.5


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in {
        "import": "import: FILE, --out: missing; see tensegrity-mj import --help",
        "import x.yaml --out x.xml": "--out x.xml: the name must end in .toml",
        "import x.yaml --out x.toml --from yaml": "import: --from: 'yaml': allowed: ntrt, mat, matlab, csv, mjcf",
        "import x.yaml --out x.toml --unit 0": "import: --unit: 0: it must be > 0",
        "import x.yaml --out x.toml --damping -1": "import: --damping: -1: it must be >= 0",
        "import x.yaml --out x.toml": "tensegrity-mj: x.yaml: no such file",
        "import x.stl --out x.toml": "x.stl: no format has such a name",
    }.items():
        assert main([word if word not in ("x.toml",) else str(tmp_path / word) for word in words.split()]) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1


def test_the_words_of_the_option_are_those_of_the_table() -> None:
    option = build_parser().commands["import"]._option_string_actions["--from"]
    assert list(option.choices or ()) == list(FORMATS)
