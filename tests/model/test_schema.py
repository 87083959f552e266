"""The JSON Schema of the format takes what the package reads, and refuses misspelt keys and wrong types."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.cli import main
from tensegrity_mj.model import format_schema
from tensegrity_mj.model.text.writing import scene_to_toml

jsonschema = pytest.importorskip("jsonschema")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = json.loads(json.dumps(format_schema()))
    jsonschema.Draft4Validator.check_schema(schema)
    return jsonschema.Draft4Validator(schema)


@pytest.mark.parametrize("path", sorted(ROOT.glob("models/**/scene.toml")), ids=lambda path: path.parent.name)
def test_every_shipped_scene_is_valid(validator: Any, path: Path) -> None:
    validator.validate(tomllib.loads(path.read_text(encoding="utf-8")))


def test_the_files_of_the_docs_are_valid(validator: Any) -> None:
    pages = [ROOT / "docs" / "format.md", *(ROOT / "docs" / "format").glob("*.md")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    blocks = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    head = 'format = 1\nname = "x"\nstructure = "other.toml"\n'
    for text in blocks:
        validator.validate(tomllib.loads(text if text.startswith("format") else head + text))
    assert len(blocks) > 15


@pytest.mark.parametrize("seed", range(20))
def test_what_is_written_is_valid(validator: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, planar=seed % 2 == 1, own_planes=0.5, fixed_nodes=2, point_masses=1)
    scene = random_scene(rng, structure, displaced=0.2, moving=1.0)
    validator.validate(tomllib.loads(scene_to_toml(scene)))


GOOD = """\
format = 1
name = "all"
[structure]
string_law = "clipped"
nodes = { a = [0, 0, 0], b = [0, 0, 1], c = [1, 0, 0] }
rods = [{ name = "r", nodes = ["a", "b"], mass = 1, support = { kind = "pinned", sigma = 0.5 } }]
strings = [{ name = "s", nodes = ["b", "c"], group = "g" }]
point_masses = [{ node = "c", mass = 2 }]
defaults.strings = { stiffness = 5.0 }
groups.g = { damping = 0 }
[scene]
gravity = [0, 0, -9.81]
whole = { velocity = [1, 0, 0] }
contact = { floor = 0.0, impedance = [0.9, 0.95, 0.001, 0.5, 2] }
water = { waves = [{ amplitude = 1, wavelength = 9.0 }], segments = 5, weights = "rigid" }
resistance = { bending = { stiffness = 1.0, pairs = [["r", "q"]] } }
motions = [{ support = "r", times = [0, 1], displacements = [[0, 0, 0], [1, 0, 0]] }]
target = { waypoints = [{ time = 0.0, nodes = { a = [0, 0, 0] } }] }
control = { law = "lyapunov", options = { norm = 2 } }
elements = [{ kind = "mine", size = 3 }]
"""
WRONG = [
    ("strings = [{ name", "strings = [{ nmae"),
    ("mass = 1,", ""),
    ("mass = 1,", 'mass = "1",'),
    ("mass = 1,", "mass = 0,"),
    ('["a", "b"]', '["a"]'),
    ('kind = "pinned"', 'kind = "pined"'),
    ("sigma = 0.5", "sigma = 1.5"),
    ("[0, 0, 1]", "[0, 0]"),
    ('"clipped"', '"cliped"'),
    ("defaults.strings", "defaults.string"),
    ("{ stiffness = 5.0 }", "{ stifness = 5.0 }"),
    ("damping = 0", "damping = -1"),
    ("groups.g = {", "groups.g = { name = 'x',"),
    ("[scene]", "[scen]"),
    ("-9.81]", '"-9.81"]'),
    ("velocity", "velcity"),
    ("0.5, 2]", "0.5]"),
    ("floor = 0.0", "flor = 0.0"),
    ("amplitude = 1", "amplitude = -1"),
    ("segments = 5", "segments = 0"),
    ("segments = 5", "segments = 5.5"),
    ('"rigid"', '"stiff"'),
    ('["r", "q"]', '["r"]'),
    ("[[0, 0, 0], [1", "[[0, 0], [1"),
    ("time = 0.0,", ""),
    ("a = [0, 0, 0] } }]", "a = [0] } }]"),
    ('law = "lyapunov"', "law = 3"),
    ('kind = "mine", ', ""),
    ("format = 1", "format = 2"),
    ("target = {", "target = { node = {},"),
    ("gravity", "gravty"),
    ("point_masses = [{ node", "point_masses = [{ nodes"),
]


@pytest.mark.parametrize(("old", "new"), WRONG, ids=[f"{old!r}-{new!r}" for old, new in WRONG])
def test_what_is_misspelt_or_of_another_type_is_refused(validator: Any, old: str, new: str) -> None:
    assert validator.is_valid(tomllib.loads(GOOD))
    assert GOOD.count(old) == 1
    changed = tomllib.loads(GOOD.replace(old, new))
    if old == "mass = 1,":  # a rod may have its mass by default: the package says that it is missing
        assert validator.is_valid(changed) == (new == "")
    else:
        assert not validator.is_valid(changed)


def test_descriptions_units_and_defaults_are_there_for_editors() -> None:
    parts = format_schema()["definitions"]
    assert parts["Rod"]["required"] == ["name", "nodes"]
    assert parts["PointMass"]["required"] == ["node", "mass"]
    assert parts["Rod"]["properties"]["radius"]["default"] == 0.01
    assert "default" not in parts["Rod"]["properties"]["mass"]
    assert parts["String"]["properties"]["stiffness"]["description"].startswith("> 0 N/m")
    assert parts["Contact"]["properties"]["friction"]["description"]


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["scenes", "--schema"], ["scenes", "--schema", "--json"]):
        assert main(words) == 0
        assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(format_schema()))
    assert main(["scenes", "prism", "--schema"]) == 2
    assert "scenes prism: --schema prints that of all scene files; leave out the scene" in capsys.readouterr().err
