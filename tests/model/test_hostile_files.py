"""Files from anyone: nothing outside the folder that was named, nothing that hangs, messages that can be shown."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from evidence.random_linked import random_linked_structure
from evidence.random_structures import random_structure
from evidence.random_taut import random_taut_structure
from tensegrity_mj.basics.texts import file_name
from tensegrity_mj.cli import main
from tensegrity_mj.errors import MOST_LETTERS, FormatError, OptionError, SceneError, TensegrityError
from tensegrity_mj.library.named import family_names, load_scene, load_structure
from tensegrity_mj.model.members import Rod, String
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.text import reading
from tensegrity_mj.model.text.keys import MOST_BYTES, MOST_DEPTH
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import save_scene

SMALL = """format = 1
name = "small"
[structure]
nodes = { a = [0, 0, 0], b = [1, 0, 0] }
rods = [{ name = "r", nodes = ["a", "b"], mass = 1.0 }]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "hostile.toml"
    path.write_text(text, encoding="utf-8")
    return path


# Files that never end --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("load", [load_scene, load_structure])
def test_devices_and_pipes_are_refused_before_they_are_opened(load: object, tmp_path: Path) -> None:
    assert callable(load)
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)  # opening it would wait for a writer for ever
    for path in ("/dev/zero", "/dev/stdin", pipe):
        if not Path(path).is_file():
            with pytest.raises(FormatError, match=r"that is no regular file .* name a file"):
                load(Path(path))


@pytest.mark.parametrize("place", ["/dev/zero", "pipe.toml"])
def test_scenes_that_refer_to_devices_and_pipes_are_refused(place: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    path = written(tmp_path, f'format = 1\nstructure = "{place}"')
    with pytest.raises(FormatError, match="no regular file"):
        load_scene(path)


def test_a_file_is_read_no_further_than_what_is_allowed(tmp_path: Path) -> None:
    path = tmp_path / "long.toml"
    with open(path, "wb") as file:
        file.truncate(10**12)  # a terabyte of zeros, which takes no room
    with pytest.raises(FormatError, match=r"more than 10 MB, the most that is read"):
        load_scene(path)


def test_what_is_too_large_to_be_read_back_is_not_written(tmp_path: Path) -> None:
    scene = load_scene("pinned_rod").with_(source="x" * MOST_BYTES)
    path = tmp_path / "large.toml"
    with pytest.raises(FormatError, match=r"has 10 MB, and files of more than 10 MB are not read back"):
        save_scene(scene, path)
    assert not path.exists()


@pytest.mark.parametrize(
    "path",
    ["a\0b.toml", "x" * 300 + ".toml", "/" * 5000 + "a.toml", "no/such/folder/a.toml"],
    ids=["null", "long name", "long path", "no folder"],
)
def test_paths_that_cannot_be(path: str) -> None:
    with pytest.raises(FormatError):
        load_scene(path)


@pytest.mark.parametrize("path", [None, 3, b"prism", [], 1.5])
def test_what_is_no_path(path: object) -> None:
    with pytest.raises(FormatError, match="it must be the name of a scene"):
        load_scene(path)  # type: ignore[arg-type]


# TOML that takes long ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "bomb",
    [
        "a." * 50_000 + "a = 1",
        "[" + "a." * 50_000 + "a]",
        "x = { " + "'a' . " * 50_000 + "a = 1 }",
        'x = "#"\n' + '"a"."\\""' + '."\\\\"' * 50_000 + " = 1",
        "\n".join(f"{'a.' * 200}b{i} = 1" for i in range(500)),
    ],
    ids=["key", "header", "inline", "quoted", "many"],
)
def test_dotted_keys_of_many_parts_are_refused_unread(bomb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading.tomllib, "loads", lambda text: pytest.fail("the parser was called"))
    with pytest.raises(FormatError, match=f"has more than {MOST_DEPTH} parts"):
        scene_from_toml(f"format = 1\n{bomb}\n")


@pytest.mark.parametrize(
    "text",
    [
        'source = "' + "a." * 100 + '"',
        "source = '" + "a." * 100 + "'",
        "source = '''\n" + "a." * 100 + "\n'''",
        'source = """' + 'a." ' * 100 + '"""',
        "# " + "a." * 100,
        'source = "\\"' + "a." * 100 + '"',
        "source = 'x' # '" + "b." * 100,
    ],
    ids=["basic", "literal", "lines", "basic lines", "comment", "escape", "after"],
)
def test_dots_in_texts_and_comments_are_no_keys(text: str) -> None:
    assert scene_from_toml(SMALL.replace('name = "small"', f'name = "small"\n{text}')).name == "small"


@pytest.mark.parametrize("parts", [2, 3, MOST_DEPTH])
def test_keys_that_are_allowed_reach_the_parser(parts: int) -> None:
    text = ".".join("a" * parts) + " = 1"
    assert reading.parse(text, "text") == tomllib.loads(text)
    with pytest.raises(FormatError, match="parts"):
        reading.parse("x." * MOST_DEPTH + "x = 1", "text")


@pytest.mark.parametrize("depth", [MOST_DEPTH + 1, 100, 400, 5000])
@pytest.mark.parametrize("brackets", ["[]", "{}"])
def test_what_is_nested_deeply_is_refused(depth: int, brackets: str) -> None:
    opening = "[" if brackets == "[]" else "{ a = "
    value = opening * depth + "1" + (" }" if brackets == "{}" else "]") * depth
    with pytest.raises(FormatError, match=r"deep|not valid TOML"):
        scene_from_toml(f'{SMALL}[scene.control]\nlaw = "lyapunov"\noptions = {{ x = {value} }}')


def test_the_search_for_long_keys_does_not_go_back() -> None:
    # What a search that goes back would take the square of: quotes that are never closed, and one endless word.
    for text in ('"' + '\\"' * 500_000, '"""' + '\\"' * 500_000, "'" * 10**6, "a" * 10**6, "a " * 500_000, "." * 10**6):
        with pytest.raises(FormatError):
            scene_from_toml(text)


# Nothing outside the folder ----------------------------------------------------------------------------------------

NAMES = ["../victim/x", "/absolute/x", "..", "a\\b", "\x1b[31m\nx", "y" * 300, "NUL", ""]


def evil(folder: Path, name: str) -> Path:
    """The pinned rod, short, under another name."""
    scene = load_scene("pinned_rod").with_(duration=0.02)
    path = folder / "evil.toml"
    save_scene(scene, path)
    text = path.read_text(encoding="utf-8")
    reported = "".join(f"\\u{ord(letter):04x}" for letter in name)
    path.write_text(text.replace('name = "pinned_rod"', f'name = "{reported}"', 1), encoding="utf-8")
    assert load_scene(path).name == (name or load_scene(path).structure.name)
    return path


def everything(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@pytest.mark.slow
@pytest.mark.parametrize("command", ["demo", "tradeoff"])
def test_commands_write_inside_their_folder(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What these two write is called after the scene: the names of the file must not lead elsewhere."""
    (tmp_path / "victim").mkdir()
    name = "../victim/$\\frac{$x"  # and a formula that matplotlib cannot read
    scene = evil(tmp_path, name)
    out = tmp_path / "out"
    out.mkdir()
    before = everything(tmp_path)
    arguments = {
        "demo": ["demo", "--scene", str(scene), "--out", str(out)],
        "tradeoff": [
            *("tradeoff", str(scene), "--out", str(out), "--loops", "closed", "--engines", "mujoco"),
            *("--families", "Euler", "--actuations", "continuous", "--budget", "1e4", "--repeats", "1"),
        ],
    }[command]
    assert main(arguments) == 0, capsys.readouterr().err
    made = everything(tmp_path) - before
    assert made
    assert all(path.startswith(("out/", "out")) for path in made)
    assert any(file_name(name) in path for path in made)
    assert not any("victim/" in path for path in made)


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_folders_of_scenes_with_such_names_are_inside(name: str, tmp_path: Path) -> None:
    """The path that `tradeoff` makes of a name, without its runs."""
    from tensegrity_mj.studies.tradeoff import study

    requested: list[Path] = []

    def stop(*given: object, folder: Path, **options: object) -> None:
        requested.append(folder)
        raise FormatError("far enough")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "tradeoff", stop)
        assert main(["tradeoff", str(evil(tmp_path, name)), "--out", str(tmp_path / "out")]) == 2
    assert [path.parent for path in requested] == [tmp_path / "out"]
    assert requested[0].name not in ("", ".", "..")


def test_files_of_tasks_stay_in_the_folder_of_their_study(tmp_path: Path) -> None:
    from tensegrity_mj.studies.many import _file_name

    for name in NAMES:
        assert (tmp_path / _file_name(3, name)).parent == tmp_path
    assert _file_name(3, "run.nc") == "000003-run.nc"


# Messages -----------------------------------------------------------------------------------------------------------


def test_control_characters_of_keys_are_escaped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, SMALL.replace("name =", '"\\u001b[31mred" = 1\nname =', 1))
    assert main(["scenes", str(path)]) == 2
    reported = capsys.readouterr().err
    assert "unknown key '\\x1b[31mred'" in reported
    assert "\x1b" not in reported


def test_control_characters_of_names_are_escaped_in_answers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(
        tmp_path,
        SMALL.replace('"small"', '"\\u001b[31m\\nred"').replace("[structure]", 'source = "\\u009b2J"\n[structure]'),
    )
    assert main(["scenes", str(path)]) == 0
    reported = capsys.readouterr().out
    assert "\\x1b[31m" in reported
    assert not set(reported) & {"\x1b", "\x9b"}


@pytest.mark.parametrize(
    "change",
    [
        ('name = "small"', f'name = "small"\n{"k" * 10**5} = 1'),
        ('"r"', f'"{"r" * 10**5}"'),
        ("mass = 1.0", f"mass = {'9' * 4000}"),
        ("mass = 1.0", "mass = [" + "1, " * 10**5 + "]"),
        ('["a", "b"]', f'["a", "{"c" * 10**5}"]'),
    ],
    ids=["key", "name", "integer", "list", "node"],
)
def test_messages_stay_short(change: tuple[str, str], tmp_path: Path) -> None:
    path = written(tmp_path, SMALL.replace(*change).replace("mass = 1.0", "mass = -1.0"))
    with pytest.raises(TensegrityError) as caught:
        load_scene(path)
    assert len(str(caught.value)) <= MOST_LETTERS


def test_unknown_members_of_large_structures_give_short_messages(tmp_path: Path) -> None:
    scene = load_scene("tower(stages=100, form_found=False)")
    path = tmp_path / "tower.toml"
    save_scene(scene, path)
    text = path.read_text(encoding="utf-8")
    for more in ('breaks = [{ string = "nothing", time = 1.0 }]', "initial_nodes = { nothing = [0, 0, 0] }"):
        path.write_text(f"{text}\n{more}\n", encoding="utf-8")
        with pytest.raises(TensegrityError, match="nothing") as caught:
            load_scene(path)
        assert len(str(caught.value)) <= MOST_LETTERS


# Sizes --------------------------------------------------------------------------------------------------------------

FAMILIES = [
    "tower(stages=1000000000)",
    "tower(stages=5001, form_found=False)",
    "tower_in_waves(stages=1000000000)",
    "net(cells=(1000000, 1000000))",
    "net(cells=(1, 1000000000))",
    "cable(elements=1000000000)",
    "suspended_cable(elements=1000000000)",
    "moored_chain(elements=1000000000)",
    "fish_net(rows=1000000000)",
    "prism(n=1000000000)",
    "spine(vertebrae=1000000000)",
    "planar_beam(cells=1000000001)",
    "planar_beam(shapes=1000000000)",
    "truss_arm(cells=1000000000)",
    "truss_arm(cells=1000000000, braced=999999999)",
    f"tower(stages={'9' * 4000})",
]


@pytest.mark.parametrize("call", FAMILIES, ids=lambda call: call[:40])
def test_families_refuse_absurd_sizes_before_they_build(call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np, "linspace", lambda *given, **options: pytest.fail("it was built"))
    for kind in (Rod, String, Structure):
        monkeypatch.setattr(kind, "__init__", lambda self, *given, **options: pytest.fail("it was built"))
    with pytest.raises(OptionError, match=r"that makes .* nodes, and at most [0-9]+ are built"):
        load_scene(call)


def test_every_family_with_a_size_is_among_those() -> None:
    """Families without an integer parameter of their size: their numbers of members are fixed, or other checks hold."""
    fixed = {"appendix_beam", "beam_in_waves", "chapter7_tower", "cross", "icosahedron", "six_bar_roll", "superball"}
    fixed |= {"three_bar_robot"}
    assert {call.partition("(")[0] for call in FAMILIES} | fixed == set(family_names())


def test_random_families_refuse_absurd_sizes() -> None:
    rng = np.random.default_rng(0)
    for build in (random_structure, random_linked_structure, random_taut_structure):
        for rods in (10**9, 10**5000):
            with pytest.raises(OptionError, match="nodes, and at most"):
                build(rng, rods=rods)


def test_calls_of_endless_text_are_refused() -> None:
    with pytest.raises(FormatError, match="at most 10000 are read"):
        load_scene("tower(" + "(" * 10**6)


# Numbers ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["1e-320", "1e-161", "2.2e-308", "1e-101", "1.1e100", "1e306"])
@pytest.mark.parametrize("item", ["duration", "mass", "radius", "length", "gravity", "force", "place"])
def test_numbers_whose_products_are_none_are_refused(item: str, value: str, tmp_path: Path) -> None:
    """1e-320 has a digit or two left; of 1e-161 the square is zero; of 1e306 it is infinite."""
    small = value.startswith(("1e-", "2"))
    changes = {
        "duration": ("[structure]", f"scene.duration = {value}\n[structure]"),
        "mass": ("mass = 1.0", f"mass = {value}"),
        "radius": ("mass = 1.0", f"mass = 1.0, radius = {value}"),
        "length": ("[1, 0, 0]", f"[{value}, 0, 0]"),
        "gravity": ("[structure]", f"scene.gravity = [0, 0, {value}]\n[structure]"),
        "force": ("[structure]", f'scene.loads = [{{ node = "b", force = [0, 0, {value}] }}]\n[structure]'),
        "place": ("[0, 0, 0]", f"[0, 0, {value}]"),
    }
    path = written(tmp_path, SMALL.replace(*changes[item]))
    if small and item in ("gravity", "force", "place"):  # next to nothing, which these may be
        load_scene(path)
        return
    with pytest.raises(TensegrityError, match=r"magnitude from 1e-100 to 1e\+100|at most 1e\+100|length 0 m"):
        load_scene(path)


@pytest.mark.parametrize("option", ["--duration", "--timestep"])
def test_options_have_the_magnitudes_of_scenes(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    for value in ("1e-320", "1e300"):
        assert main(["run", "pinned_rod", option, value]) == 2
        assert "magnitude from 1e-100 to 1e+100" in capsys.readouterr().err


def test_a_target_has_at_most_a_million_positions(tmp_path: Path) -> None:
    times = ", ".join(f"{{ time = {number} }}" for number in range(20_000))
    path = tmp_path / "tower.toml"
    save_scene(load_scene("tower(stages=10, form_found=False)"), path)
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}\n[scene.target]\nwaypoints = [{times}]\n", encoding="utf-8")
    with pytest.raises(FormatError, match="at most 1000000 positions are read"):
        load_scene(path)
    shapes = ", ".join(f"{{ parameter = {number} }}" for number in range(1001))
    path.write_text(f"{text}\n[scene.target]\nshapes = [{shapes}]\ntimes = [0, 1]\nvalues = [0, 1]\n", encoding="utf-8")
    with pytest.raises(SceneError, match="goes through at most 1000"):
        load_scene(path)
