"""What members share in a file, by defaults and groups: who comes first, what is written, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tensegrity_mj.errors import FormatError, OptionError, StructureError, TensegrityError
from tensegrity_mj.model.members import Section, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.reading import scene_from_toml, structure_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml, structure_to_toml
from tensegrity_mj.pictures.run_panels import rod_groups, string_groups
from tensegrity_mj.studies.scene_parameters import changed_scene

GOOD = """\
format = 1
name = "two"

[structure]
nodes = { a = [0, 0, 0], b = [0, 0, 1], c = [1, 0, 0], d = [1, 0, 1], e = [2, 0, 0] }
fixed_nodes = ["e"]
rods = [
    { name = "r1", nodes = ["a", "b"], group = "heavy" },
    { name = "r2", nodes = ["c", "d"], radius = 0.03, support = { kind = "free" } },
]
strings = [
    { name = "s1", nodes = ["a", "d"], group = "saddle" },
    { name = "s2", nodes = ["b", "c"], group = "saddle", tension = 3 },
    { name = "s3", nodes = ["b", "d"], group = "rim", stiffness = 7.0 },
    { name = "s4", nodes = ["d", "e"] },
]

[structure.defaults.rods]
mass = 2
support = { kind = "pinned" }

[structure.defaults.strings]
stiffness = 500
damping = 2.0
tension = 1.0

[structure.groups.heavy]
mass = 9.0
section = { outer_radius = 0.05, wall = 0.05, elasticity_modulus = 1e9 }

[structure.groups.saddle]
stiffness = 800
force_density = 20.0

[structure.groups.rim]
"""


def test_what_a_member_says_comes_first_then_its_group_then_the_defaults() -> None:
    structure = structure_from_toml(GOOD)
    first, second = structure.rods
    assert (first.mass, first.radius, first.support, first.group) == (9.0, 0.01, Support.pinned(), "heavy")
    assert first.section == Section.solid(0.05, 1e9)
    assert (second.mass, second.radius, second.support, second.group) == (2.0, 0.03, Support.free(), None)
    assert [(one.stiffness, one.damping) for one in structure.strings] == [(800, 2), (800, 2), (7, 2), (500, 2)]
    # Of the three that say how taut a string is, the nearest alone holds.
    assert [one.force_density for one in structure.strings] == [20, None, None, None]
    assert [one.tension for one in structure.strings] == [None, 3, 1, 1]
    assert [one.group for one in structure.strings] == ["saddle", "saddle", "rim", None]


def test_what_is_written_has_numbers_in_each_member_and_keeps_the_groups() -> None:
    structure = structure_from_toml(GOOD)
    text = structure_to_toml(structure)
    assert "defaults" not in text
    assert "[structure.groups" not in text
    assert structure_from_toml(text) == structure
    scene = Scene(structure)
    assert scene_from_toml(scene_to_toml(scene)) == scene
    bare = replace(structure, strings=tuple(replace(one, group=None) for one in structure.strings))
    bare = replace(bare, rods=tuple(replace(one, group=None) for one in structure.rods))
    assert "group" not in structure_to_toml(bare)
    assert bare != structure


WRONG = [
    ("[structure.groups.saddle]\nstiffness", "[structure.groups.saddle]\nstifness", FormatError,
     "structure.groups.saddle (of strings): unknown key 'stifness' (did you mean 'stiffness'?); allowed: stiffness, "),
    ("[structure.groups.heavy]\nmass", "[structure.groups.heavy]\nstrength", FormatError,
     "structure.groups.heavy (of rods): unknown key 'strength'"),
    ("stiffness = 800", "stiffness = -1", StructureError,
     "structure.groups.saddle (of strings): stiffness = -1.0; it must be > 0 N/m"),
    ("stiffness = 500", 'stiffness = "500"', FormatError,
     "structure.defaults.strings: stiffness = '500' (a text); it must be a number"),
    ("damping = 2.0", "dampng = 2.0", FormatError, "structure.defaults.strings: unknown key 'dampng'"),
    ("damping = 2.0", 'group = "rim"', FormatError, "structure.defaults.strings: unknown key 'group'"),
    ("damping = 2.0", "rest_length = 0.1", StructureError,
     "structure.defaults.strings: rest_length and tension are given; give at most one of them"),
    ("[structure.defaults.rods]", "[structure.defaults.rod]", FormatError,
     "structure.defaults: unknown key 'rod' (did you mean 'rods'?); allowed: rods, strings"),
    ('group = "rim"', 'group = "rims"', FormatError,
     "structure.strings[2] 's3': group = 'rims' (did you mean 'rim'?); [structure.groups] has 'heavy', 'saddle', "),
    ('group = "rim"', "group = 3", FormatError, "structure.strings[2] 's3': group = 3 (an integer); it must be a text"),
    ("[structure.groups.rim]", "[structure.groups.rim]\n[structure.groups.more]", FormatError,
     "structure.groups.more: no rod or string has group = 'more'; give it to some, or leave it out"),
    ("[structure.groups.rim]", "[structure.groups]\nrim = 3", FormatError, "structure.groups.rim (of strings) = 3"),
    ('kind = "pinned"', 'kind = "pined"', FormatError, 'structure.defaults.rods.support: kind = \'pined\' (a text)'),
    ("stiffness = 500\n", "", StructureError, "structure.strings[3] 's4': 'stiffness' is missing; it must be a number"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "error", "words"), WRONG, ids=[new[:40] for _, new, _, _ in WRONG])
def test_what_is_wrong_is_named_where_it_stands(old: str, new: str, error: type[TensegrityError], words: str) -> None:
    assert GOOD.count(old) == 1
    with pytest.raises(error) as caught:
        structure_from_toml(GOOD.replace(old, new), "mine.toml")
    assert str(caught.value).startswith(f"mine.toml: {words}")


def test_without_a_table_of_groups_a_group_is_a_word_alone() -> None:
    text = GOOD.partition("[structure.groups.heavy]")[0]
    assert structure_from_toml(text).strings[0].group == "saddle"
    with pytest.raises(
        StructureError, match=r"strings\[0\] 's1': group = ''; it must be the name of a group.*, or absent"
    ):
        structure_from_toml(text.replace("saddle", ""))


def test_plots_and_sweeps_know_groups() -> None:
    scene = Scene(structure_from_toml(GOOD))
    assert [label for label, _ in string_groups(scene.structure)] == ["saddle (2)", "rim (1)", "others (1)"]
    assert [rows.tolist() for _, rows in rod_groups(scene.structure)] == [[0], [1]]
    changed = changed_scene(scene, "structure", "strings[saddle].stiffness", "p", 50.0).structure
    assert changed.stiffness.tolist() == [50, 50, 7, 500]
    changed = changed_scene(scene, "structure", "strings[saddle, s4].damping", "p", 1.0).structure
    assert changed.damping.tolist() == [1, 1, 2, 1]
    with pytest.raises(OptionError, match=r"there is no string 'sadle' \(did you mean 'saddle'"):
        changed_scene(scene, "structure", "strings[sadle].stiffness", "p", 1.0)
