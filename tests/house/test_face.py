"""The faces of the package and of its rooms: few names, each listed once, each there, and imported when first used."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import tensegrity_mj as tmj
from tensegrity_mj.basics.dependencies import missing_for_dm_control

ROOT = Path(__file__).resolve().parents[2]
FACES = [
    "",
    "controllers",
    "engines",
    "exchange",
    "library",
    "linearization",
    "model",
    "pictures",
    "runs",
    "simulation",
    "statics",
    "studies",
    "studies.tradeoff",
]


@pytest.mark.parametrize("room", FACES)
def test_every_name_is_there_and_stands_once(room: str) -> None:
    module = import_module(f"tensegrity_mj.{room}".rstrip("."))
    source = Path(str(module.__file__)).read_text(encoding="utf-8")
    written = re.findall(r"import \w+ as (\w+)", source)
    assert written
    assert sorted(written) == module.__all__ == dir(module)
    for name in written:
        assert source.count(f"import {name} as {name}\n") == 1
        assert getattr(module, name) is not None
    # The name of the thing, not of a module that happens to be called the same.
    for line in ast.walk(ast.parse(source)):
        if isinstance(line, ast.ImportFrom) and line.module is not None and line.module != module.__name__:
            for alias in line.names:
                assert getattr(module, alias.name, None) is getattr(import_module(line.module), alias.name) or (
                    alias.asname is None
                )
    # Importing such a module would put it in the place of the name.
    own = {path.stem for path in Path(str(module.__file__)).parent.iterdir()}
    assert not {name for name in written if not isinstance(getattr(module, name), ModuleType)} & own


def test_the_package_has_at_most_41_names() -> None:
    assert len(tmj.__all__) <= 41
    used = set(re.findall(r"\btmj\.(\w+)", (ROOT / "README.md").read_text(encoding="utf-8")))
    assert used <= set(tmj.__all__)
    namespace: dict[str, object] = {}
    exec("from tensegrity_mj import *", namespace)
    assert set(tmj.__all__) <= set(namespace)


def test_names_in_the_guides_are_there() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "models").glob("*/README.md")]
    named = {(page.name, name) for page in pages for name in re.findall(r"\btmj((?:\.\w+)+)", page.read_text("utf-8"))}
    assert len(named) > 100
    for page, name in named:
        if name.startswith(".dm_control") and missing_for_dm_control():
            continue
        place: object = tmj
        for part in name[1:].split("."):
            if isinstance(place, ModuleType) and not hasattr(place, part):
                place = import_module(f"{place.__name__}.{part}")  # of a room that is no name of the top
                continue
            assert hasattr(place, part), f"{page}: tmj{name}"
            place = getattr(place, part)


def test_a_name_that_is_not_there_says_what_is() -> None:
    with pytest.raises(
        AttributeError, match=r"'tensegrity_mj' has no attribute 'Structre' \(did you mean 'Structure'\?\)"
    ):
        tmj.Structre  # noqa: B018
    # Names of rooms and of their modules; `SceneError` is no misspelt `Scene`.
    for room, name, home in (
        (tmj, "SceneError", "errors"),
        (tmj, "Contact", "model"),
        (tmj, "plots", "pictures"),
        (tmj.studies, "TradeoffOptions", "tradeoff"),
    ):
        with pytest.raises(AttributeError, match=rf"'{name}'; it is {room.__name__}\.{home}\.{name}$"):
            getattr(room, name)
    with pytest.raises(AttributeError, match=r"'tensegrity_mj.runs' has no attribute 'Rod'; it has Approach, "):
        tmj.runs.Rod  # noqa: B018
    assert not hasattr(tmj, "__wrapped__")


def test_importing_the_package_imports_nothing_of_it_before_it_is_used() -> None:
    code = (
        "import sys\n"
        "import tensegrity_mj as tmj\n"
        "heavy = {'numpy', 'numba', 'mujoco', 'tensegrity_mj.model', 'tensegrity_mj.errors'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "tmj.TensegrityError\n"
        "assert 'tensegrity_mj.errors' in sys.modules and 'numpy' not in sys.modules\n"
        "try:\n"
        "    tmj.library\n"
        "except AttributeError as error:\n"
        "    assert str(error).endswith(\"has no attribute 'library' yet; import tensegrity_mj.library\")\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
