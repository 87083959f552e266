"""Each compiled function that engines share has a test marked third_means, a row of docs/developing/third-means.md."""

from __future__ import annotations

import ast
import runpy
from fnmatch import fnmatchcase
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COMPILED = {"alone", "borrowing", "inlined", "owning", "njit"}  # decorators
TABLE = runpy.run_path(str(ROOT / "scripts" / "third_means.py"))


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


def test_every_function_that_engines_share_has_a_test_and_no_other() -> None:
    functions = compiled_functions()
    assert {"strings.tighten_strings", "water._wet_part", "slack.look_at_trial", "resistance.add_fluid"} <= functions
    texts = [text for check in TABLE["checks"]() for text in check.functions]
    named = {found[0] for text in texts if (found := TABLE["FUNCTION"].match(text))}
    assert [name for name in functions if not any(fnmatchcase(name, pattern) for pattern in named)] == []
    assert [name for name in named if not any(fnmatchcase(one, name) for one in functions)] == []


def test_the_page_has_the_table_of_the_markers() -> None:
    stale = "run .venv/bin/python scripts/third_means.py, which writes the table from the markers"
    assert TABLE["PAGE"].read_text(encoding="utf-8") == TABLE["page"](), stale


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
