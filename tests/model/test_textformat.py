"""The text format: nothing is lost, and what is wrong in a file is said with the file, the item and the remedy."""

from __future__ import annotations

import math
import os
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evidence.random_structures import random_configuration, random_scene, random_structure
from tensegrity_mj.basics.fields import item_of, registered
from tensegrity_mj.errors import FormatError, SceneError, StructureError, TensegrityError
from tensegrity_mj.library.named import load_scene, load_structure
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.elements.terrain import Terrain
from tensegrity_mj.model.events import ControlSpec, Load
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene, Whole
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.model.text import keys as format_keys
from tensegrity_mj.model.text.reading import scene_from_toml, structure_from_toml
from tensegrity_mj.model.text.schema import format_schema
from tensegrity_mj.model.text.sources import scene_names
from tensegrity_mj.model.text.writing import save_scene, save_structure, scene_to_toml, structure_to_toml
from tensegrity_mj.statics.self_stress import SelfStress

ROOT = Path(__file__).resolve().parents[2]
fair = settings(derandomize=True, max_examples=80, deadline=None)
finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e100, max_value=1e100)
positive = st.floats(min_value=1e-100, max_value=1e100)
texts = st.text(st.characters(exclude_categories=("Cs",)), max_size=30)
names = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=12)


def plain() -> Structure:
    """One rod on three strings."""
    return Structure(
        "plain",
        {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, 1.0), "f": (1.0, 0.0, 1.0), "g": (-1.0, 0.0, 1.0)},
        (Rod("rod", ("a", "b"), 1.0, support=Support.pinned(0.0)),),
        (String("s1", ("b", "f"), 5.0), String("s2", ("b", "g"), 5.0)),
        ("f", "g"),
    )


# Nothing is lost ------------------------------------------------------------------------------------------


@fair
@given(st.data(), st.integers(0, 2**32 - 1))
def test_random_scenes_come_back_equal(data: st.DataObject, seed: int) -> None:
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng,
        rods=data.draw(st.integers(1, 4)),
        planar=data.draw(st.booleans()),
        own_planes=0.3,
        fixed_nodes=data.draw(st.integers(0, 3)),
        point_masses=data.draw(st.integers(0, 2)),
        damping=data.draw(st.sampled_from([(0.0, 0.0), (0.0, 1.0)])),
        law=data.draw(st.sampled_from(StringLaw)),
        size=10.0 ** data.draw(st.integers(-3, 3)),
    )
    scene = random_scene(
        rng,
        structure,
        displaced=data.draw(st.sampled_from([0.0, 0.2])),
        moving=data.draw(st.sampled_from([0.0, 1.0])),
        gravity=data.draw(st.booleans()),
        loads=data.draw(st.integers(0, 3)),
        duration=data.draw(positive),
    )
    times = np.cumsum(rng.uniform(0.2, 1.0, data.draw(st.integers(0, 3))))
    if len(times):
        ways = [random_configuration(rng, structure, 0.3) for _ in times]
        scene = scene.with_(target=Target.path(times.tolist(), ways) if len(times) > 1 else Target.set_point(ways[0]))
    if data.draw(st.booleans()):
        scene = scene.with_(control=ControlSpec("lyapunov", {"decay_rate": float(rng.uniform(0.1, 1)), "norm": 2}))
    text = scene_to_toml(scene)
    assert scene_from_toml(text) == scene
    assert scene_to_toml(scene_from_toml(text)) == text
    assert structure_from_toml(structure_to_toml(structure)) == structure
    assert structure_from_toml(text) == structure


@fair
@given(st.tuples(names, names, names, names).filter(lambda drawn: len(set(drawn)) == 4), names, texts, texts)
def test_any_name_and_text_comes_back(nodes: tuple[str, str, str, str], member: str, title: str, source: str) -> None:
    a, b, c, f = nodes
    structure = Structure(
        title,
        {a: (0, 0, 0), b: (0, 0, 1), c: (5, 5, 5), f: (1, 0, 1)},
        (Rod(member, (a, b), 1.0),),
        (String(member, (b, f), 5.0), String(member + "2", (c, f), 5.0)),
        (f,),
        (PointMass(c, 1.0),),
    )
    load, control = Load(c, (0, 0, 1)), ControlSpec(member.replace(":", "_") + "_", {member: source})
    scene = Scene(structure, name=title, source=source, loads=(load,), control=control)
    assert scene_from_toml(scene_to_toml(scene)) == scene


@fair
@given(
    mass=positive,
    stiffness=positive,
    damping=st.floats(0.0, 1e100),
    rest=positive,
    gravity=st.tuples(finite, finite, finite),
    phase=finite,
)
def test_any_float_comes_back(
    mass: float, stiffness: float, damping: float, rest: float, gravity: tuple[float, float, float], phase: float
) -> None:
    structure = plain()
    rod, (first, second) = structure.rods[0], structure.strings
    structure = replace(
        structure,
        rods=(replace(rod, mass=mass, radius=stiffness),),
        strings=(replace(first, stiffness=stiffness, damping=damping, rest_length=rest), second),
    )
    scene = Scene(structure, gravity=gravity, loads=(Load("b", gravity, mass, phase),), duration=stiffness)
    assert scene_from_toml(scene_to_toml(scene)) == scene


scalars = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | texts
options = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3), max_leaves=8)


@fair
@given(st.dictionaries(st.text(st.characters(exclude_categories=("Cs",)), min_size=1), options, max_size=4))
def test_any_option_of_a_law_comes_back_with_its_type(drawn: dict[str, object]) -> None:
    scene = Scene(plain(), control=ControlSpec("law", drawn))  # type: ignore[arg-type]
    again = scene_from_toml(scene_to_toml(scene))
    assert again == scene
    assert again.control is not None
    assert repr(dict(again.control.options)) == repr(drawn)  # 1, 1.0, True and -0.0 differ here


@pytest.mark.parametrize("number", [1e-5, 1e-7, 1e16, 1e22, 1e-100, 1e100, 0.1 + 0.2, 1 / 3])
def test_floats_are_legal_toml(number: float) -> None:
    scene = Scene(plain(), duration=number)
    line = next(line for line in scene_to_toml(scene).splitlines() if line.startswith("duration"))
    assert tomllib.loads(line) == {"duration": number}
    assert scene_from_toml(scene_to_toml(scene)).duration == number


SUPPORTS = [
    Support.free(),
    Support.free(0.25),
    Support.free(plane=(0, 1, 0)),
    Support.pinned(),
    Support.pinned(1.0, plane=(0, -2, 0)),
    Support.constrained([0, 0, 1]),
    Support.constrained([[0, 0, 1], [1, 0, 0]], 0.5, [0.5, 0.0]),
    Support.constrained(np.eye(3), 0.0, [0.0, 0.0, 0.0]),
    Support.constrained([[0, 1, 0], [1, 0, 0], [0, 0, 1]], 0.0),
    Support.constrained([1, 0, 0], 0.0, plane=(0, 1, 0)),
]


@pytest.mark.parametrize("support", SUPPORTS)
def test_every_support_comes_back(support: Support) -> None:
    structure = replace(plain(), rods=(Rod("rod", ("a", "b"), 1.0, 0.02, support),))
    assert structure_from_toml(structure_to_toml(structure)) == structure


def test_what_is_given_but_equal_to_the_default_comes_back_as_given() -> None:
    structure = plain()
    still = Scene(structure, initial_nodes=structure.positions, initial_velocities=np.zeros((4, 3)))
    again = scene_from_toml(scene_to_toml(still))
    assert again == still
    assert again.initial_nodes is not None
    assert again.initial_velocities is not None
    assert scene_from_toml(scene_to_toml(Scene(structure))).initial_nodes is None
    negative_zero = Scene(structure, initial_velocities=-np.zeros((4, 3)))
    assert np.all(np.signbit(scene_from_toml(scene_to_toml(negative_zero)).velocities0))


@pytest.mark.parametrize("times", [(0.0,), (2.0,), (-1.0, 2.0)])
def test_targets_come_back(times: tuple[float, ...]) -> None:
    structure = plain()
    scene = Scene(structure, target=Target.path(times, [structure.positions] * len(times)))
    assert scene_from_toml(scene_to_toml(scene)) == scene


def test_names_of_scene_and_structure_may_differ() -> None:
    structure = plain()
    for scene in (Scene(structure, name="other"), Scene(replace(structure, name=""), name="other")):
        assert scene_from_toml(scene_to_toml(scene)) == scene


def test_loads_that_are_a_function_are_refused() -> None:
    scene = Scene(plain(), loads=lambda t: np.zeros((4, 3)))
    with pytest.raises(SceneError, match=r"'plain': its loads are a Python function.*Loads.*loads=\(\)"):
        scene_to_toml(scene)


# Files ----------------------------------------------------------------------------------------------------


def test_saved_files_load(tmp_path: Path) -> None:
    scene = Scene(plain(), gravity=(0, 0, -9.81))
    path = save_scene(scene, tmp_path / "mine.toml")
    assert path == tmp_path / "mine.toml"
    assert load_scene(path) == load_scene(str(path)) == scene
    assert load_structure(path) == scene.structure
    assert save_structure(plain(), tmp_path / "only.toml").read_text().startswith("# tensegrity-mj")
    assert load_scene(tmp_path / "only.toml") == Scene(plain())


def test_what_is_no_scene_or_structure_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"scene = 3; use a Scene, or load_scene\(name or path\)"):
        save_scene(3, tmp_path / "mine.toml")  # type: ignore[arg-type]
    with pytest.raises(SceneError, match="structure = 'prism'; use a Structure"):
        save_structure("prism", tmp_path / "mine.toml")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_a_byte_order_mark_and_other_line_ends_are_read(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xef\xbb\xbf" + structure_to_toml(plain()).replace("\n", "\r\n").encode())
    assert load_structure(path) == plain()


def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save_structure(plain(), tmp_path / "mine.toml")
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(FormatError, match=r"mine\.toml: cannot be written \(No space left on device\)"):
        save_scene(Scene(plain(), duration=3.0), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_save_through_a_link_keeps_the_link_and_ordinary_rights(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    real, link, new = tmp_path / "there" / "real.toml", tmp_path / "link.toml", tmp_path / "new"
    real.write_text("")
    link.symlink_to(real)
    save_structure(plain(), link)
    assert link.is_symlink()
    assert load_structure(real) == plain()
    new.touch()
    assert real.stat().st_mode == new.stat().st_mode


def test_saving_where_there_is_no_folder(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"cannot be written \(No such file or directory\)"):
        save_structure(plain(), tmp_path / "none" / "mine.toml")


def test_a_scene_may_name_the_file_of_its_structure(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    save_structure(plain(), tmp_path / "parts" / "rod.toml")
    text = 'format = 1\nname = "uses it"\nstructure = "parts/rod.toml"\n[scene]\nduration = 3\n'
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert load_scene(path) == Scene(plain(), name="uses it", duration=3.0)
    assert load_structure(path) == plain()
    with pytest.raises(FormatError, match=r"structure = 'parts/rod\.toml' .*no folder"):
        scene_from_toml(text)
    (tmp_path / "third.toml").write_text('format = 1\nname = "third"\nstructure = "scene.toml"\n')
    with pytest.raises(FormatError, match=r"third\.toml: structure = 'scene\.toml', which refers to another file"):
        load_scene(tmp_path / "third.toml")
    (tmp_path / "lost.toml").write_text('format = 1\nname = "lost"\nstructure = "nowhere.toml"\n')
    with pytest.raises(FormatError, match=r"nowhere\.toml: no such file"):
        load_scene(tmp_path / "lost.toml")


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"absent\.toml: no such file"):
        load_scene("absent.toml")
    with pytest.raises(FormatError, match=r"that is a folder; name a file in it"):
        load_scene(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe9"')
    with pytest.raises(FormatError, match=r"latin\.toml: not a text in UTF-8 .*byte 8"):
        load_scene(tmp_path / "latin.toml")


def test_unknown_names_list_the_known_ones() -> None:
    assert scene_names() == sorted(scene_names())
    assert {"pinned_rod", "prism", "tbar"} <= set(scene_names())
    with pytest.raises(
        FormatError, match=r"unknown scene 'prsim' \(did you mean 'prism'\?\).*pinned_rod.*tbar.*\.toml"
    ):
        load_scene("prsim")


@pytest.mark.parametrize("name", scene_names())
def test_shipped_scenes_are_as_the_writer_writes_them(name: str) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert scene.source
    assert (ROOT / "models" / name / "scene.toml").read_text(encoding="utf-8") == scene_to_toml(scene)


# What is wrong in a file ----------------------------------------------------------------------------------

GOOD = """\
format = 1
name = "small"

[structure]
nodes.a = [0, 0, 0]
nodes.b = [0, 0, 1]
nodes.f = [1, 0, 1]
fixed_nodes = ["f"]

[[structure.rods]]
name = "rod"
nodes = ["a", "b"]
mass = 1
support = { kind = "pinned" }

[[structure.strings]]
name = "s1"
nodes = ["b", "f"]
stiffness = 5

[scene]
duration = 2

[[scene.loads]]
node = "b"
force = [0, 0, 1]

[scene.target.nodes]
b = [0, 1, 0]

[scene.control]
law = "lyapunov"
options = { norm = 2 }
"""


def test_the_file_that_the_cases_spoil_is_good() -> None:
    scene = scene_from_toml(GOOD)
    assert scene.structure.rods == (Rod("rod", ("a", "b"), 1.0, 0.01, Support.pinned()),)
    assert scene.loads == (Load("b", (0.0, 0.0, 1.0)),)
    assert scene.target is not None
    np.testing.assert_array_equal(scene.target.nodes[0], [[0, 0, 0], [0, 1, 0], [1, 0, 1]])
    assert scene.control == ControlSpec("lyapunov", {"norm": 2})


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ('{ kind = "free" }', Support.free(0.5)),
        ('{ kind = "pinned" }', Support.pinned(0.0)),
        ('{ kind = "constrained", D = [[0, 0, 1]] }', Support.constrained([0, 0, 1], 0.0)),
    ],
)
def test_defaults_of_supports(written: str, meant: Support) -> None:
    text = GOOD.replace('{ kind = "pinned" }', written)
    assert structure_from_toml(text).rods[0].support == meant
    without = GOOD.replace('support = { kind = "pinned" }', "")
    assert structure_from_toml(without).rods[0].support == Support.free()


# (what to replace in the good file, by what, the error, what its message must hold)
WRONG: list[tuple[str, str, type[TensegrityError], tuple[str, ...]]] = [
    ("mass = 1", "mass = ", FormatError, ("not valid TOML", "line 13")),
    ("mass = 1", "mass = 1\nmass = 2", FormatError, ("not valid TOML", "line 14")),
    ('law = "lyapunov"', "law = " + "[" * 5000, FormatError, ("not valid TOML",)),
    ("duration = 2", "duration = " + "9" * 5000, FormatError, ("not valid TOML",)),
    ("format = 1\n", "", FormatError, ("'format' is missing", "format = 1")),
    ("format = 1", "format = 2", FormatError, ("format = 2", "reads format = 1")),
    ("format = 1", "format = true", FormatError, ("format = true (a truth value)", "reads format = 1")),
    ('name = "small"\n', "", FormatError, ("'name' is missing", "text in quotes")),
    ('name = "small"', "name = 3", FormatError, ("name = 3 (an integer)", "text in quotes")),
    (
        "[structure]",
        "[structur]",
        FormatError,
        ("unknown key 'structur'", "did you mean 'structure'?", "allowed: format"),
    ),
    ("[scene]", "[structure.scene]", FormatError, ("structure: unknown key 'scene'", "allowed: name, string_law")),
    ("duration = 2", "time = 2", FormatError, ("scene: unknown key 'time'", "allowed: gravity, duration")),
    ("mass = 1", "mas = 1", FormatError, ("structure.rods[0] 'rod': unknown key 'mas' (did you mean 'mass'?)",)),
    ("mass = 1", "", FormatError, ("structure.rods[0] 'rod': 'mass' is missing", "a number")),
    ("mass = 1", 'mass = "1"', FormatError, ("structure.rods[0] 'rod': mass = '1' (a text)", "a number")),
    ("mass = 1", "mass = true", FormatError, ("mass = true (a truth value)", "a number")),
    ("mass = 1", "mass = " + "9" * 400, FormatError, ("mass = 999", "(an integer)", "a number")),
    ("mass = 1", "mass = 1979-05-27", FormatError, ("mass = ", "(a date)", "a number")),
    ("mass = 1", "mass = nan", StructureError, ("rods[0] 'rod': mass = nan", "> 0 kg")),
    ("mass = 1", "mass = -1", StructureError, ("rods[0] 'rod': mass = -1.0", "> 0 kg")),
    ('name = "rod"\n', "", FormatError, ("structure.rods[0]: 'name' is missing",)),
    ('nodes = ["a", "b"]', 'nodes = ["a", 2]', FormatError, ("rods[0] 'rod': nodes = ['a', 2] (a list)", "two names")),
    ('nodes = ["a", "b"]', 'nodes = "ab"', FormatError, ("nodes = 'ab' (a text)", "list of two names")),
    ('nodes = ["a", "b"]', 'nodes = ["a", "z"]', StructureError, ("rod 'rod'", "'z'", "'a', 'b', 'f'")),
    ("stiffness = 5", "stiffnes = 5", FormatError, ("structure.strings[0] 's1'", "'stiffnes'", "'stiffness'?")),
    ("stiffness = 5", "stiffness = inf", StructureError, ("strings[0] 's1': stiffness = inf", "> 0 N/m")),
    ('{ kind = "pinned" }', '{ kind = "pined" }', FormatError, ("rods[0] 'rod'.support: kind = 'pined'", '"free" or')),
    ('{ kind = "pinned" }', "{ sigma = 0 }", FormatError, ("'rod'.support: 'kind' is missing", '"constrained"')),
    ('{ kind = "pinned" }', '{ kind = "pinned", D = [[0, 0, 1]] }', FormatError, ("support: unknown key 'D'", "sigma")),
    ('{ kind = "pinned" }', '{ kind = "constrained" }', FormatError, ("support: 'D' is missing", "[[0, 0, 1]]")),
    ('{ kind = "pinned" }', '{ kind = "constrained", D = [0, 0, 1] }', FormatError, ("D = [0, 0, 1]", "rows of three")),
    (
        '{ kind = "pinned" }',
        '{ kind = "constrained", D = [[0, 0, 1]], values = [0, 0] }',
        StructureError,
        ("rods[0] 'rod'.support: values: r̄ has 2 values for 1 rows of D",),
    ),
    ('{ kind = "pinned" }', '{ kind = "pinned", plane = [0, 1] }', FormatError, ("plane = [0, 1]", "[x, y, z]")),
    (
        '{ kind = "pinned" }',
        '{ kind = "pinned", sigma = 2 }',
        StructureError,
        ("'rod'.support: sigma = 2.0",),
    ),
    ('{ kind = "pinned" }', '"pinned"', FormatError, ("'rod'.support = 'pinned' (a text)", "a table")),
    ("nodes.f = [1, 0, 1]", "nodes.f = [1, 0]", FormatError, ("structure.nodes: f = [1, 0] (a list)", "[x, y, z]")),
    ("nodes.f = [1, 0, 1]", 'nodes.f = [1, 0, "1"]', FormatError, ("structure.nodes: f = [1, 0, '1']", "[x, y, z]")),
    ("nodes.f = [1, 0, 1]", "nodes.f = [1, 0, nan]", StructureError, ("node 'f'", "nan", "finite")),
    ("[[structure.rods]]", "[structure.rods]", FormatError, ("structure: rods = ", "(a table)", "array of tables")),
    ('fixed_nodes = ["f"]', "fixed_nodes = [1]", FormatError, ("structure: fixed_nodes = [1]", "list of names")),
    (
        'fixed_nodes = ["f"]',
        'string_law = "strict"',
        FormatError,
        ("string_law = 'strict'", '"clipped" or "unclipped"'),
    ),
    (
        'fixed_nodes = ["f"]',
        'point_masses = [{ node = "f" }]',
        FormatError,
        ("point_masses[0] 'f': 'mass' is missing",),
    ),
    ("duration = 2", "gravity = -9.81", FormatError, ("scene: gravity = -9.81 (a number)", "[x, y, z]")),
    ("duration = 2", "duration = -2", SceneError, ("duration = -2.0", "> 0 s")),
    (
        "duration = 2",
        "initial_nodes.z = [0, 0, 1]",
        FormatError,
        ("scene.initial_nodes: unknown node 'z'", "'a', 'b', 'f'"),
    ),
    ("duration = 2", "initial_nodes.b = [0, 0, 2]", SceneError, ("initial_nodes: rod 'rod' would be 2 m long",)),
    ("duration = 2", "initial_velocities.b = [0, 0, 1]", SceneError, ("rod 'rod' would lengthen at 1 m/s",)),
    ("duration = 2", "motions = 3", FormatError, ("scene: motions = 3 (an integer)", "array of tables")),
    ("duration = 2", "motions = [{}]", FormatError, ("scene.motions[0]: 'support' is missing", "text in quotes")),
    ("duration = 2", 'motions = [{ support = "rod" }]', SceneError, ("'rod'", "nothing says how it moves")),
    (
        "duration = 2",
        'motions = [{ support = "rod", harmonic = [] }]',
        FormatError,
        ("scene.motions[0] 'rod': unknown key 'harmonic' (did you mean 'harmonics'?)",),
    ),
    (
        "duration = 2",
        'motions = [{ support = "rod", harmonics = [{ amplitude = [1, 2] }] }]',
        FormatError,
        ("scene.motions[0] 'rod'.harmonics[0]: amplitude = [1, 2]", "[x, y, z]"),
    ),
    (
        "duration = 2",
        'motions = [{ support = "rod", times = [0, 1], displacements = [0, 0] }]',
        FormatError,
        ("scene.motions[0] 'rod': displacements = [0, 0]", "rows of three numbers"),
    ),
    (
        "duration = 2",
        'motions = [{ support = "rod", times = [0, 1], displacements = [[0, 0, 0]] }]',
        SceneError,
        ("'rod': 2 times and 1 displacements",),
    ),
    (
        "duration = 2",
        'motions = [{ support = "b", harmonics = [{ amplitude = [1, 2, 3] }] }]',
        SceneError,
        ("motion of 'b'", "no such support", "'rod', 'f'"),
    ),
    ("duration = 2", "initial_velocities = 3", FormatError, ("scene.initial_velocities = 3 (an integer)", "a table")),
    ("force = [0, 0, 1]", "force = 1", FormatError, ("scene.loads[0] 'b': force = 1 (an integer)", "[x, y, z]")),
    ("force = [0, 0, 1]", "forces = [0, 0, 1]", FormatError, ("scene.loads[0] 'b'", "did you mean 'force'?")),
    ('node = "b"', 'node = "z"', SceneError, ("loads[0]", "unknown node 'z'")),
    (
        "b = [0, 1, 0]",
        "c = [0, 1, 0]",
        FormatError,
        ("scene.target.nodes: unknown node 'c'", "the nodes are 'a', 'b', 'f'"),
    ),
    ("b = [0, 1, 0]", "b = [0, 1, 1]", SceneError, ("target: rod 'rod' would be 1.414",)),
    (
        "[scene.target.nodes]\nb = [0, 1, 0]",
        "[scene.target]",
        FormatError,
        ("scene.target", "one of 'nodes'", "'waypoints'", "'shapes'"),
    ),
    (
        "[scene.target.nodes]\nb = [0, 1, 0]",
        "[[scene.target.waypoints]]\nnodes.b = [0, 1, 0]",
        FormatError,
        ("scene.target.waypoints[0]: 'time' is missing", "a number"),
    ),
    (
        "[scene.target.nodes]\nb = [0, 1, 0]",
        "[scene.target]\nwaypoints = []",
        FormatError,
        ("waypoints = []", "at least"),
    ),
    ('law = "lyapunov"\n', "", FormatError, ("scene.control: 'law' is missing", "text in quotes")),
    ("{ norm = 2 }", "{ norm = { p = 2 } }", SceneError, ("scene.control: options: option 'norm' = {'p': 2}",)),
    ("{ norm = 2 }", "{ norm = nan }", SceneError, ("option 'norm'", "nan")),
    ("options =", "option =", FormatError, ("scene.control: unknown key 'option' (did you mean 'options'?)",)),
]


@pytest.mark.parametrize(("old", "new", "error", "words"), WRONG, ids=[f"{new[:40]!r}" for _, new, _, _ in WRONG])
def test_wrong_files_are_refused(old: str, new: str, error: type[TensegrityError], words: tuple[str, ...]) -> None:
    assert GOOD.count(old) == 1
    with pytest.raises(error) as caught:
        scene_from_toml(GOOD.replace(old, new), where="mine.toml")
    message = str(caught.value)
    assert type(caught.value) is error
    assert message.startswith("mine.toml: ")
    assert len(message) < 500
    for word in words:
        assert word in message


def test_a_file_without_structure() -> None:
    with pytest.raises(FormatError, match=r"mine\.toml: 'structure' is missing; it must be a table \[structure\], or"):
        scene_from_toml('format = 1\nname = "x"\n', where="mine.toml")


# The documentation ----------------------------------------------------------------------------------------

# The page of the first file, and the four pages of all keys, of which scene.md and running.md have Python.
PAGES = [ROOT / "docs" / "format.md", *sorted((ROOT / "docs" / "format").glob("*.md"))]
DOCUMENT = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", DOCUMENT, re.DOTALL)


def test_the_documented_files_load(tmp_path: Path) -> None:
    files = blocks("toml")
    whole = [text for text in files if text.startswith("format")]
    assert whole
    (tmp_path / "hanging_rod.toml").write_text(whole[0], encoding="utf-8")
    for text in whole:
        scene = scene_from_toml(text, "docs/format.md", tmp_path)
        assert scene_from_toml(scene_to_toml(scene)) == scene


def test_the_documented_fragments_fit_into_a_file(tmp_path: Path) -> None:
    (tmp_path / "el_centro.csv").write_text("time,ax\n0,0\n1,0.1\n", encoding="utf-8")
    base = scene_to_toml(Scene(plain()))
    for text in blocks("toml"):
        if not text.startswith("format"):
            assert "scene" in tomllib.loads(text)
            head = base[: base.index("[scene]")]
            scene_from_toml(head + text, "docs/format.md", tmp_path)


def test_every_key_is_documented() -> None:
    groups = [value for name, value in vars(format_keys).items() if name.endswith("_KEYS") and isinstance(value, tuple)]
    keys = {key for group in [*groups, *format_keys.SUPPORT_KEYS.values()] for key in group}
    todo: list[type] = [Structure, Scene, Whole]
    for cls in todo:
        for key, one in item_of(cls).keys.items():
            if cls is not Scene or key in format_keys.SCENE_KEYS:
                keys.add(key)
                part = one.kind.part
                todo += [part] if part not in (None, Target, Support, Element, Terrain) else []
                todo += registered(Terrain).values() if part is Terrain else []
    assert len(keys) > 30
    rows = set(re.findall(r"^\| `(\w+)`", DOCUMENT, re.MULTILINE))
    assert rows == keys == keys_in(format_schema())


def keys_in(schema: object) -> set[str]:
    """All keys of tables that a JSON Schema knows."""
    inside = schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ()
    own = schema.get("properties", {}) if isinstance(schema, dict) else {}
    return set(own).union(*map(keys_in, inside))


def test_the_documented_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    for text in blocks("python"):
        exec(compile(text, "docs/format.md", "exec"), namespace)
    assert math.isclose(load_scene(tmp_path / "my_prism.toml").structure.rod_lengths[0], 1.0)
    stress = namespace["stress"]
    assert isinstance(stress, SelfStress)
    assert (stress.modes.shape, stress.mechanisms, stress.rigid_motions) == ((1, 9), 1, 6)
