"""Each compiled function that engines share has a row in docs/developing/third-means.md, and each row a test."""

from __future__ import annotations

import ast
import re
from fnmatch import fnmatchcase
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COMPILED = {"borrowing", "inlined", "owning", "njit"}  # decorators


PAGE = (ROOT / "docs" / "developing" / "third-means.md").read_text(encoding="utf-8")


def rows() -> list[list[str]]:
    lines = [line for line in PAGE.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def compiled_functions() -> set[str]:
    """`module.function` of the folder that engines share."""
    found = set()
    for path in (ROOT / "tensegrity_mj" / "dynamics" / "native").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = {
                    getattr(item.func if isinstance(item, ast.Call) else item, "id", "") for item in node.decorator_list
                }
                if names & COMPILED:
                    found.add(f"{path.stem}.{node.name}")
    return found


def functions_of(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.FunctionDef)}


def test_every_function_that_engines_share_is_in_the_table_and_no_other() -> None:
    functions = compiled_functions()
    assert {"strings.tighten_strings", "water._wet_part", "slack.look_at_trial", "resistance.add_fluid"} <= functions
    named = [name for row in rows() for name in re.findall(r"`([a-z_]+\.[a-z_*]+)`", row[0])]
    assert [name for name in functions if not any(fnmatchcase(name, pattern) for pattern in named)] == []
    assert [name for name in named if not any(fnmatchcase(one, name) for one in functions)] == []


def test_every_test_that_the_table_names_is_there() -> None:
    own = {"S": "tests/dynamics/test_third_means_strings.py", "F": "tests/dynamics/test_third_means_fluids.py"}
    count = 0
    for row in rows():
        for part in row[1].split(";"):
            file = re.search(r"`(tests/[a-z_0-9/]+\.py)`", part)
            short = re.match(r"\s*([SF]) ", part)
            path = file.group(1) if file else own[short.group(1)] if short else None
            names = re.findall(r"`(test_[a-z_0-9]+)`", part)
            if path is None:
                assert part == "all of S and F"
                continue
            assert names
            count += len(names)
            assert set(names) <= functions_of(ROOT / path), part
    assert count > 25
    rest = PAGE.split("Segments of rods")[1]
    below = re.findall(r"`(tests/[a-z_0-9/]+\.py)`((?:[^`]|`test_[a-z_0-9]+`)*)", rest)
    assert len(below) == 4
    for path, text in below:
        assert set(re.findall(r"`(test_[a-z_0-9]+)`", text)) <= functions_of(ROOT / path)


def test_no_formula_of_the_third_means_calls_what_it_checks() -> None:
    # They import the package's face, what runs a single evaluation, and nothing with formulas of loads or strings.
    allowed = {
        "tensegrity_mj",
        "tensegrity_mj.model.actuation",
        "tensegrity_mj.dynamics.native.elements",
        "tensegrity_mj.dynamics.native.law",
        "tensegrity_mj.dynamics.native.plant",
        "tensegrity_mj.engines.request",
    }
    for name in ("strings", "fluids"):
        tree = ast.parse((ROOT / "tests" / "dynamics" / f"test_third_means_{name}.py").read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tensegrity_mj"):
                assert node.module in allowed, node.module
