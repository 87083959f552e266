"""Families called by a text: what they make, and how wrong calls are refused."""

from __future__ import annotations

import ast
import enum
import inspect
import json
import re
import subprocess
import sys
import typing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import ROOT

import tensegrity_mj as tmj
from evidence.families.in_waves import BeamEnd, beam_in_waves, tower_in_waves
from evidence.families.thesis_towers import appendix_beam, chapter7_tower
from tensegrity_mj.basics.hints import fitted
from tensegrity_mj.cli import main
from tensegrity_mj.errors import FormatError, OptionError, TensegrityError
from tensegrity_mj.library import load_structure, named
from tensegrity_mj.library.cable import RopeMass, cable
from tensegrity_mj.library.cross import cross
from tensegrity_mj.library.fish_farm import fish_net, moored_chain
from tensegrity_mj.library.hanging import Held, net, suspended_cable
from tensegrity_mj.library.named import family_names, is_family_call
from tensegrity_mj.library.planar_beam import planar_beam
from tensegrity_mj.library.prism import prism, three_bar_robot
from tensegrity_mj.library.rolling import six_bar_roll
from tensegrity_mj.library.six_bar import icosahedron, superball
from tensegrity_mj.library.spine import spine
from tensegrity_mj.library.tower import Axis, Topology, tower
from tensegrity_mj.library.truss_arm import truss_arm
from tensegrity_mj.model.elements.water import Weights

CALLS: dict[str, tuple[str, Any]] = {
    "places and names": ("truss_arm(6, braced=2, tension=5)", lambda: truss_arm(6, braced=2, tension=5)),
    "no arguments": ("cross()", cross),
    "blanks": ("  net ( (3 , 2) ,\n load = .25 ) ", lambda: net((3, 2), load=0.25)),
    "a list for a tuple": ("net([3, 2])", lambda: net((3, 2))),
    "an enum": ("net((3, 3), held='edges')", lambda: net((3, 3), held=Held.EDGES)),
    "another": ("cable(5, rope_mass='table')", lambda: cable(5, rope_mass=RopeMass.TABLE)),
    "None in a tuple": ("planar_beam(3, angle=(0.1, 0.2))", lambda: planar_beam(3, angle=(0.1, 0.2))),
    "a sign": ("suspended_cable(6, rise=-0.1)", lambda: suspended_cable(6, rise=-0.1)),
    "a tower": (
        "tower(2, topology='reduced_b', axis='z', pinned_base=True)",
        lambda: tower(2, topology=Topology.REDUCED_B, axis=Axis.Z, pinned_base=True),
    ),
    "None": ("tower(2, tension=None)", lambda: tower(2)),
    "a row of a table": (
        "appendix_beam('TB3', form_found=False)",
        lambda: appendix_beam("TB3", form_found=False),
    ),
    "afloat": (
        "tower_in_waves(stages=3, weights='hermite', current=(0.1, 0.0, 0.0))",
        lambda: tower_in_waves(stages=3, weights=Weights.HERMITE, current=(0.1, 0.0, 0.0)),
    ),
    "in waves": (
        "beam_in_waves('TB1', 3, end='clamped')",
        lambda: beam_in_waves("TB1", 3, end=BeamEnd.CLAMPED),
    ),
    "three names": (
        "icosahedron(base=['r1a', 'r5b', 'r6b'], tilt=(0.1, 0, 0))",
        lambda: icosahedron(base=("r1a", "r5b", "r6b"), tilt=(0.1, 0.0, 0.0)),
    ),
    "any number of rods": ("prism(7, tension=5)", lambda: prism(7, tension=5.0)),
    "published robots": ("superball(drop=1)", lambda: superball(drop=1.0)),
    "another of them": ("three_bar_robot(prestress=.1)", lambda: three_bar_robot(prestress=0.1)),
    "with its program": ("six_bar_roll(steps=2)", lambda: six_bar_roll(steps=2)),
    "moored": ("moored_chain(5, pull=2000)", lambda: moored_chain(5, pull=2000.0)),
    "a net": ("fish_net(2, 3, solidity=.1)", lambda: fish_net(2, 3, solidity=0.1)),
    "bodies": ("spine(3, push=0)", lambda: spine(3, push=0.0)),
    "of the study": ("chapter7_tower(2e4, 0.15)", lambda: chapter7_tower(2e4, 0.15)),
}


@pytest.mark.parametrize("case", CALLS)
def test_calls_make_what_python_makes(case: str) -> None:
    text, build = CALLS[case]
    made = tmj.load_scene(text)
    assert made == build()
    if case in ("a tower", "moored"):  # made as the scene is
        assert load_structure(text) == made.structure


def test_every_family_is_called_above() -> None:
    assert {text.split("(")[0].strip() for text, _ in CALLS.values()} == set(family_names())


def test_every_default_can_be_written() -> None:
    """Families that are new are seen here: a parameter of a kind that no literal fits would refuse its own default."""
    count = 0
    for name in family_names():
        builder = named._builder(name, name)
        own = inspect.unwrap(builder)
        for key, parameter in inspect.signature(builder).parameters.items():
            default = parameter.default
            if default is not parameter.empty:
                literal = default.value if isinstance(default, enum.Enum) else default
                if isinstance(literal, tuple):
                    literal = tuple(item.item() if isinstance(item, np.generic) else item for item in literal)
                given = ast.literal_eval(repr(literal))
                if hasattr(own, "__item__"):
                    needed = {"stages": 1} if "stages" in inspect.signature(own).parameters else {}
                    given = getattr(own(**needed | {key: given}), key)
                else:
                    given = fitted(f"{name}: {key}", given, typing.get_type_hints(own)[key])
                assert given == default, f"{name}: {key}"
                count += 1
    assert count > 60


WRONG: list[tuple[str, str]] = [
    ("towr(3)", r"towr\(3\): unknown family 'towr' \(did you mean 'tower'\?\); families: appendix_beam, beam"),
    ("os(3)", "unknown family 'os'"),
    ("tower()", "tower: argument 'stages' is missing; it needs a value"),
    ("tower(2, 3)", r"tower: 2 arguments without a name, and it takes 1 \(stages\)"),
    ("tower(2, stage=3)", r"unknown argument 'stage' \(did you mean 'stages'\?\); it has stages, rod_length"),
    ("tower(2, stages=3)", "argument 'stages' is given twice"),
    ("tower(2, damping=1, damping=2)", "argument 'damping' is given twice"),
    ("tower(2.5)", "tower: stages = 2.5; it must be an integer"),
    ("tower(True)", "tower: stages = True; it must be an integer"),
    ("tower(2, damping='1')", "tower: damping = '1'; it must be a finite number"),
    ("tower(2, radius=True)", "tower: radius = True; it must be > 0 m, or None"),
    ("tower(2, alternating=1)", "tower: alternating = 1; it must be True or False"),
    (
        "tower(2, topology='Full')",
        r"topology = 'Full' \(did you mean 'full'\?\); it must be one of Topology.FULL, .*, or its text",
    ),
    ("tower(2, topology=Topology.FULL)", "topology = Topology.FULL is no literal; write a number, a text in quotes"),
    ("tower(2, origin=(0, 1))", r"origin = \(0, 1\); it must be three finite numbers \[m\]"),
    ("tower(2, origin=0)", r"origin = 0; it must be three finite numbers \[m\]"),
    ("tower(2, name=3)", "name = 3; it must be a text"),
    ("tower(2, damping=1j)", "damping = 1j; it must be a finite number"),
    ("tower(2, **{'damping': 1})", r"\*\* is no literal"),
    ("tower(*[2])", r"stages = \*\[2\] is no literal"),
    ("tower(1 + 1)", r"stages = 1 \+ 1 is no literal"),
    ("tower(open('x'))", r"open\('x'\) is no literal"),
    ("cable(motion=1)", "cable: motion = 1; use Motion.in_line"),
    ("planar_beam(3, angle=(0.1, 'x'))", "planar_beam: angle = 'x'; it must be a finite number > 0 rad"),
    ("cross(rod_mass='1')", "cross: rod_mass = '1'; it must be a finite number"),
    ("cross(start=(1, 2))", r"cross: start = \(1, 2\); it must be three finite numbers"),
    ("tower(2", "'\\(' was never closed; write a family and its arguments"),
    ("tower(2))", "unmatched '\\)'"),
    ("tower(2).structure", "it must be one call of a family by its name"),
    ("tower(2)(3)", "it must be one call of a family by its name"),
    ("tower(2), tower(3)", "it must be one call of a family by its name"),
    ("tower(2); tower(3)", "invalid syntax"),
    ("tower(" + "(" * 4000 + ")" * 4000 + ")", "nested|too many"),
    ("tower(" + "(" * 5000 + ")" * 5000 + ")", "at most 10000 are read"),
    ("tower(" + "9" * 9000 + ")", "too long|digits"),
    ("tower(2,\0)", "null bytes|too long"),
]


@pytest.mark.parametrize(("text", "message"), WRONG, ids=range(len(WRONG)))
def test_wrong_calls_are_refused_in_words(text: str, message: str) -> None:
    assert is_family_call(text)
    with pytest.raises(TensegrityError, match=message) as error:
        tmj.load_scene(text)
    assert isinstance(error.value, (FormatError, OptionError))
    assert len(str(error.value)) < 600
    with pytest.raises(type(error.value)):
        load_structure(text)


def test_what_a_family_refuses_is_its_own_error() -> None:
    with pytest.raises(OptionError, match="tower: stages = 0"):
        tmj.load_scene("tower(0)")
    with pytest.raises(OptionError, match="appendix_beam: which = 'TB9'; allowed: TB1"):
        tmj.load_scene("appendix_beam('TB9')")
    for text in ("tower(2, radius=1e400)", "net((1, 1))", "cross(duration=-1)"):
        with pytest.raises(TensegrityError):
            tmj.load_scene(text)


@pytest.mark.parametrize(
    "text", ["prism", "towers (copy)/a.toml", "a(1).toml", "./tower(2)", "tower", "", "(2)", "3(2)"]
)
def test_names_and_paths_are_no_calls(text: str) -> None:
    assert not is_family_call(text)


def test_files_with_parentheses_are_files(tmp_path: Path) -> None:
    path = tmp_path / "tower(2).toml"
    scene = tower(1, form_found=False)
    tmj.save_scene(scene, path)
    assert tmj.load_scene(str(path)) == scene
    with pytest.raises(FormatError, match="no such file"):
        tmj.load_scene(Path("tower(2)"))


def test_unknown_scenes_say_that_families_can_be_called() -> None:
    with pytest.raises(FormatError, match=r"a call of a family, as 'tower\(stages=10\)'"):
        tmj.load_scene("towr")


def test_commands_take_calls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", "tower(2, axis='z')", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["name"], len(found["rods"]), len(found["strings"])) == ("tower", 6, 24)
    assert main(["export", "tower(1, name='one')", "--out", str(tmp_path / "one.xml"), "--json"]) == 0
    assert "rod1_3" in (tmp_path / "one.xml").read_text()
    assert main(["run", "tower(1, stage=2)", "--json"]) == 2
    assert "unknown argument 'stage'" in capsys.readouterr().out


@pytest.mark.parametrize("first", ["tensegrity_mj.library.named", "tensegrity_mj.model.text", "tensegrity_mj.statics"])
def test_any_of_the_modules_may_be_imported_first(first: str) -> None:
    code = f"import {first}, sys\nassert 'mujoco' not in sys.modules\n"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr


def test_a_family_of_the_evidence_says_where_it_comes_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(named, "installed", lambda group: {})
    for name in named.OF_EVIDENCE:
        with pytest.raises(FormatError, match=rf"family '{name}' comes with tensegrity-mj-evidence: .* pip install"):
            tmj.load_scene(f"{name}()")
    assert set(named.OF_EVIDENCE).isdisjoint(family_names())


def test_the_page_of_the_format_has_every_family() -> None:
    section = (ROOT / "docs" / "format" / "running.md").read_text(encoding="utf-8").partition("\n## Families\n")[2]
    rows = re.findall(r"^\|(.+?)\|", section.partition("\n## ")[0], re.MULTILINE)
    assert set(re.findall(r"`(\w+)\(", "".join(rows))) == set(family_names())
