"""The tables of what the thesis states: a TOML file a chapter, a row each, read into `Statement`s.

A row has `id`, `class`, `where`, `page`, `words` (what is measured), `stated`, `reason` (of the band), `measure` and
`runs`, and where they apply `figure`, `arguments`, `unit`, `band` (a row without one is a sentence that holds or does
not), `value`, `printed`, `line`, `origin`, `engines`, `differs = {cause, ours}` and `unjudged`. A reason, a cause, an
origin or an `unjudged` that is the name of one of the file's `[texts]` stands for that text. A measure is the name of a
function, which is given the runs and the arguments, or an expression of them, see `expression`.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from evidence.thesis.expression import compiled
from evidence.thesis.lookup import all_measures
from evidence.thesis.statement import Statement
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.text.codec import Table, read

FOLDER = Path(__file__).parent / "tables"
SENSITIVITY = FOLDER / "sensitivity.json"  # which errors rows notice, made by evidence/pages/sensitivity.py
FILES = ("chapter3", "chapter4", "chapter5", "chapter6", "chapter7", "appendix_c")

NAMED = ("reason", "origin", "unjudged")  # texts that may stand under a name in the file's `[texts]`
NOTHING, NOT_STUDIED, FORMULA = "nothing", "not studied", "a formula, of no run"


@cache
def all_statements() -> tuple[Statement, ...]:
    """The rows of all tables, in order."""
    return tuple(one for name in FILES for one in read_table(FOLDER / f"{name}.toml"))


def read_table(path: Path) -> list[Statement]:
    """The rows of one table.

    Raises:
        FormatError: naming the file, the row and what is wrong with it.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FormatError(f"{path}: cannot be read as a table of statements: {error}") from None
    table = Table(data, path.name, "", ("texts", "rows"))
    texts = table.inside("texts").data if "texts" in data else {}
    statements = [_statement(row, texts) for row in table.tables("rows", None, "id")]
    ids = [one.id for one in statements]
    for name in ids:
        if ids.count(name) > 1:
            raise FormatError(f"{path.name}: two rows have the id '{name}'; ids are unique")
    return statements


def _statement(row: Table, texts: Mapping[str, str]) -> Statement:
    for table, key in [(row.data, key) for key in NAMED] + [(row.data.get("differs"), "cause")]:
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = texts.get(table[key], table[key])
    one = read(Statement, row)
    if one.measure and one.measure not in all_measures():
        try:
            compiled(one.measure, tuple(all_measures()))
        except ValueError as error:
            raise row.fail("measure", f"a measure or an expression: it {error}") from None
    return one


@cache
def _notices() -> Mapping[str, Any]:
    if not SENSITIVITY.is_file():
        return {}
    found: Mapping[str, Any] = json.loads(SENSITIVITY.read_text(encoding="utf-8"))["rows"]
    return found


def noticed(statement: Statement) -> str:
    """The errors that a number or a statement notices, as text; "–" for other rows and those that cannot be judged."""
    if not statement.kind.is_evidence or statement.unjudged:
        return "–"
    if not statement.needs:
        return FORMULA
    found = _notices().get(statement.id)
    if found is None:
        return NOT_STUDIED
    parts = [f"{name} {size} %" for name, size in found.items() if size]
    return ", ".join(parts) or NOTHING
