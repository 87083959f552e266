"""Write the table of docs/developing/third-means.md from the markers of tests, which it reads and does not run.

python scripts/third_means.py
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "developing" / "third-means.md"
HEAD = "## The table\n\n"
FUNCTION = re.compile(r"[a-z_]+\.[a-z_*]+")  # of `native`, such as strings.over_rest or slack.*


class Check(NamedTuple):
    """A marker: the test (empty for a whole file) that checks functions by a formula of its own."""

    functions: list[str]
    path: str
    test: str
    by: str


def checks() -> list[Check]:
    """Return all markers of the tests, sorted by function."""
    found = []
    for path in (ROOT / "tests").rglob("test_*.py"):
        text = path.read_text(encoding="utf-8")
        if ".third_means(" not in text:
            continue
        for node in ast.parse(text).body:
            marks = node.decorator_list if isinstance(node, ast.FunctionDef) else [getattr(node, "value", None)]
            for mark in marks:
                if isinstance(mark, ast.Call) and getattr(mark.func, "attr", "") == "third_means":
                    functions = [ast.literal_eval(one) for one in mark.args]
                    name, (by,) = getattr(node, "name", ""), (ast.literal_eval(one.value) for one in mark.keywords)
                    found.append(Check(functions, path.relative_to(ROOT).as_posix(), name, by))
    return sorted(found, key=lambda one: (not FUNCTION.match(one.functions[0]), one))


def page() -> str:
    """Return the text of the page with the table of the markers."""
    lines = ["| function of `native` | test | third means |", "|---|---|---|"]
    for check in checks():
        functions = ", ".join(FUNCTION.sub(lambda found: f"`{found[0]}`", one) for one in check.functions)
        name = check.test or f"all of {check.path.rpartition('/')[2]}"
        lines.append(f"| {functions} | [{name}](../../{check.path}) | {check.by.replace('|', chr(92) + '|')} |")
    return PAGE.read_text(encoding="utf-8").partition(HEAD)[0] + HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
