"""Rules that the contracts of pyproject.toml cannot express: imports at run time and of tests, lengths of modules."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import grimp
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).resolve().parents[2]


def test_importing_the_dae_leaves_mujoco_out() -> None:
    code = (
        "import sys, tensegrity_mj as tmj\n"
        "import tensegrity_mj.engines.reference.dae, tensegrity_mj.controllers, tensegrity_mj.dynamics\n"
        "tmj.DAE(), tmj.ODE(), tmj.load_scene('prism'), tmj.Trajectory\n"
        "assert 'mujoco' not in sys.modules and 'dm_control' not in sys.modules\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr


def test_data_stand_apart_from_analyses_in_annotations_too() -> None:
    """One circle of modules is left: scenes hold structures and elements, whose methods take a scene."""
    graph = grimp.build_graph("tensegrity_mj", exclude_type_checking_imports=False)
    names = sorted(graph.modules)
    arrows = [[two in graph.find_modules_directly_imported_by(one) for two in names] for one in names]
    labels = connected_components(np.array(arrows), connection="strong")[1]
    joined = [names[row] for row in range(len(names)) if np.sum(labels == labels[row]) > 1]
    rooms = ("tensegrity_mj.model", "tensegrity_mj.runs", "tensegrity_mj.statics")
    circles = {label for name, label in zip(names, labels, strict=True) if name in joined and name.startswith(rooms)}
    assert len(circles) == 1, joined
    assert labels[names.index("tensegrity_mj.model.scene")] in circles


@pytest.mark.parametrize("name", ["mujoco", "jax"])
def test_options_of_an_engine_import_nothing_that_runs(name: str) -> None:
    code = (
        f"import sys, tensegrity_mj.engines.{name}.settings\n"
        "found = {one.removeprefix('tensegrity_mj.engines.') for one in sys.modules if '.engines.' in one}\n"
        f"assert found <= {{'accuracy', 'table', '{name}', '{name}.settings'}}, found\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0 or "MissingPackageError" in child.stderr, child.stderr


def test_tests_import_nothing_from_other_tests() -> None:
    """What two of them need is a fixture of conftest.py or a module in helpers/; no fixture stands copied."""
    files = sorted(path for folder in ("tests", "evidence/tests") for path in (ROOT / folder).rglob("test_*.py"))
    assert len(files) > 90
    places: dict[str, list[str]] = {}
    for path in files:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"^ *(?:import|from) +(?:\S+, *)*test_", text, re.MULTILINE), path.name
        for node in ast.parse(text).body if "fixture" in text else ():
            if isinstance(node, ast.FunctionDef) and any("fixture" in ast.dump(one) for one in node.decorator_list):
                places.setdefault(ast.dump(ast.Module(node.body, [])), []).append(f"{path.name}: {node.name}")
    assert not [where for where in places.values() if len(where) > 1]


def reason_missing(source: str) -> str:
    """Say how a module breaks the rule of CONTRIBUTING.md for its length, or nothing."""
    long = len(source.splitlines()) > 500
    if not long and "Longer than 500 lines:" not in source:
        return ""
    reason = re.search(
        r"^Longer than 500 lines: (?:\S+ ){3,}\S+", ast.get_docstring(ast.parse(source)) or "", re.MULTILINE
    )
    if long and not reason:
        return "has more than 500 lines, and no line 'Longer than 500 lines: <the reason>' in its docstring"
    return "gives a reason for more than 500 lines, and has fewer" if reason and not long else ""


def test_a_module_of_more_than_500_lines_says_why() -> None:
    rooms = ("tensegrity_mj", "controllers", "evidence")
    files = [path for room in rooms for path in (ROOT / room).rglob("*.py") if "tests" not in path.parts]
    assert len(files) > 300
    assert not {path: said for path in files if (said := reason_missing(path.read_text(encoding="utf-8")))}


def test_a_module_without_a_reason_is_found() -> None:
    reason = '"""Equations.\n\nLonger than 500 lines: each equation uses the others.\n"""\n'
    assert reason_missing("x = 1\n" * 500) == ""
    assert "no line" in reason_missing("x = 1\n" * 501)
    assert "no line" in reason_missing('"""Longer than 500 lines: yes."""\n' + "x = 1\n" * 500)
    assert reason_missing(reason + "x = 1\n" * 500) == ""
    assert "has fewer" in reason_missing(reason)
