"""Remedies that messages print work: their options and names exist, packages are in an index, and commands run."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache, reduce
from importlib import import_module
from importlib.metadata import packages_distributions
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import tensegrity_mj as tmj
from tensegrity_mj.basics.dependencies import distribution_of, of_extra
from tensegrity_mj.cli import build_parser, main
from tensegrity_mj.commands.doctor import CHECKS, EXTRAS, check_extras

ROOT = Path(__file__).resolve().parents[2]
# Options of pip and of MuJoCo's and ffmpeg's command lines, which messages and calls of ours have too.
OTHERS = {"--no-deps", "--force-reinstall", "--editable"}


@cache
def messages() -> list[tuple[str, str]]:
    """Every text in the code of the package and in its tables, read once."""
    return list(_read())


def _read() -> Iterator[tuple[str, str]]:
    """Texts of the code, docstrings apart, and of tables, with the file that has each."""
    for path in sorted([*(ROOT / "tensegrity_mj").rglob("*.py"), *(ROOT / "controllers").rglob("*.py")]):
        place, tree = str(path.relative_to(ROOT)), ast.parse(path.read_text(encoding="utf-8"))
        told = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if id(node) in told:
                continue
            if isinstance(node, ast.JoinedStr):  # what is put in is one word
                parts = (str(one.value) if isinstance(one, ast.Constant) else "X" for one in node.values)
                yield place, "".join(parts)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield place, node.value
    for path in sorted((ROOT / "tensegrity_mj").rglob("*.toml")):
        yield str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")


def options_of(parser: Any) -> set[str]:
    own = set(parser._option_string_actions)
    return own.union(*(options_of(one) for one in parser.commands.values()))


def test_options_and_commands_that_messages_name_exist() -> None:
    parser = build_parser()
    known = options_of(parser) | OTHERS
    wrong = []
    for place, text in messages():
        for option in re.findall(r"(?<![\w<!-])(--[a-z][a-z-]*[a-z])\b", text):
            if option not in known:
                wrong.append(f"{place}: {option} in {text[:80]!r}")
        for command in re.findall(r"\btensegrity-mj ([a-z]+)\b(?! ?[=:])", text):
            if command not in parser.commands and "`tensegrity-mj" in text:
                wrong.append(f"{place}: tensegrity-mj {command} in {text[:80]!r}")
    assert not wrong, "\n".join(wrong)


def test_python_names_that_messages_name_exist() -> None:
    wrong = []
    for place, text in messages():
        for name in re.findall(r"\btmj\.((?:[A-Za-z]\w*\.)*[A-Za-z]\w*)", text.replace(".X", "")):
            try:
                reduce(member, name.split("."), tmj)
            except AttributeError:
                wrong.append(f"{place}: tmj.{name}")
    assert not wrong, "\n".join(wrong)


def member(of: Any, name: str) -> Any:
    try:
        return getattr(of, name)
    except AttributeError:
        if not hasattr(of, "__path__"):
            raise
    try:
        return import_module(f"{of.__name__}.{name}")
    except ImportError:
        raise AttributeError(name) from None


def test_no_message_names_this_package_to_an_index_that_does_not_have_it() -> None:
    wrong = [f"{place}: {text[:80]!r}" for place, text in messages() if re.search(r"tensegrity[-_]mj\[", text)]
    assert not wrong, "\n".join(wrong)


def test_extras_are_installed_by_the_names_of_their_packages() -> None:
    given = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    extras = {*EXTRAS, *(row["extra"] for row in CHECKS.values() if "extra" in row)}
    # All that users call, which is what `all` has.
    assert extras == set(re.findall(r"\w+", given["all"][0].partition("[")[2]))
    for extra in extras:
        command = of_extra(extra)
        wanted = {str(Requirement(line)) for line in given[extra]}
        assert {str(Requirement(one)) for one in re.findall(r'"([^"]+)"', command)} == wanted
    assert of_extra("no such extra") == "'.[no such extra]'"  # as in sources that were never installed


def test_modules_are_installed_by_the_names_of_their_distributions(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = (lines for extra, lines in project["optional-dependencies"].items() if extra not in ("dev", "docs"))
    wanted = {canonicalize_name(Requirement(line).name) for line in [*project["dependencies"], *chain(*extras)]}
    homes = {name: set(map(canonicalize_name, own)) for name, own in packages_distributions().items()}
    beside = {"attr", "mpl_toolkits", "pylab"}  # second names, which nothing here imports
    modules = [name for name, own in homes.items() if own & wanted and name[0] != "_" and name not in beside]
    assert {"OpenGL", "PIL", "yaml", "imageio_ffmpeg", "numpy"} <= set(modules)
    for name in modules:
        assert canonicalize_name(distribution_of(name)) in homes[name], name
        assert distribution_of(f"{name}.part") == distribution_of(name)
    assert distribution_of("mujoco.mjx._src") == "mujoco-mjx"
    assert distribution_of("treelib") == "treelib"

    def fail(options: Any) -> None:
        raise ModuleNotFoundError("No module named 'OpenGL'", name="OpenGL")

    monkeypatch.setattr("tensegrity_mj.commands.scenes.execute", fail)
    assert main(["scenes"]) == 5
    assert "'OpenGL' is missing: install it with python -m pip install PyOpenGL\n" in capsys.readouterr().err


def test_the_doctor_looks_at_the_packages_of_extras(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {check.name: check for check in check_extras()}
    assert set(found) == {f"extra {extra}" for extra in EXTRAS}
    for check in found.values():
        assert not check.required
        assert check.works is not bool(check.remedy)
    monkeypatch.setattr("tensegrity_mj.basics.dependencies.unmet", lambda item: f"{item.name} went away")
    for extra, check in zip(EXTRAS, check_extras(), strict=True):
        assert not check.works
        assert check.remedy == f"python -m pip install {of_extra(extra)}"


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A table of four legs on a floor, braced by strings, which nothing else holds."""
    corners = {"1": (0.2, 0.0), "2": (0.0, 0.2), "3": (-0.2, 0.0), "4": (0.0, -0.2)}
    nodes = {f"f{k}": (x, y, 0.0) for k, (x, y) in corners.items()}
    nodes |= {f"h{k}": (0.7 * (x - y), 0.7 * (x + y), 0.3) for k, (x, y) in corners.items()}
    order = ["1", "2", "3", "4", "1"]
    pairs = list(pairwise(order))
    rods = tuple(tmj.Rod(f"rod{i}", (f"f{i}", f"h{j}"), 0.15, 0.01) for i, j in pairs)
    around = [(f"{kind}{i}", (f"{kind}{i}", f"{kind}{j}"), 50.0) for kind in "fh" for i, j in pairs]
    sides = [(f"side{i}", (f"f{i}", f"h{i}"), 70.71) for i in corners]
    strings = tuple(
        tmj.model.String(name, ends, 800.0, 4.0, force_density=density) for name, ends, density in [*around, *sides]
    )
    scene = tmj.Scene(
        tmj.Structure("table", nodes, rods, strings), gravity=(0.0, 0.0, -9.81), contact=tmj.model.Contact(floor=-0.011)
    )
    return tmj.save_scene(scene, tmp_path / "table.toml")


def test_a_robot_on_a_floor_is_told_how_to_stand_and_does(robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["statics", str(robot)]) == 3
    said = capsys.readouterr().err
    (hold,) = re.findall(r"--hold (\S+),", said)
    assert hold == "f1,f2,f3,f4:z"
    assert main(["statics", str(robot), "--hold", hold]) == 0
    assert "is in stable equilibrium" in capsys.readouterr().out
    (call,) = re.findall(r"tmj\.statics\.stand\(scene, \[.*?\]\)", said)
    assert eval(call, {"tmj": tmj, "scene": tmj.load_scene(robot)}).is_stable


def test_a_path_of_a_loaded_scene_says_what_grows_and_what_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmj.load_scene("truss_arm")
    loaded = tmj.save_scene(scene.with_(loads=(tmj.model.Load("t4", (0.0, 0.0, -5.0)),)), tmp_path / "loaded.toml")
    assert main(["statics", str(loaded), "--path"]) == 2
    said = capsys.readouterr().err
    assert "nothing depends" not in said
    assert "the loads of the scene itself stay constant" in said
    (form,) = re.findall(r"--hold NODE=X,Y,Z|--load, --hold NODE=X,Y,Z", said)[:1]
    assert form
    assert main(["statics", str(loaded), "--path", "--points", "5", "--load", "t4=0,0,-5"]) == 0
    assert main(["statics", str(loaded), "--path", "--points", "5", "--hold", "t4:z=0,0,-0.01"]) == 0
