"""Which errors the rows notice: the table `tables/sensitivity.json`, made by `sensitivity`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

from tensegrity_mj.thesis.statement import Statement
from tensegrity_mj.thesis.tables import FOLDER

FILE = FOLDER / "sensitivity.json"
NOTHING, NOT_STUDIED, FORMULA = "nothing", "not studied", "a formula, of no run"


@cache
def _table() -> Mapping[str, Any]:
    if not FILE.is_file():
        return {}
    found: Mapping[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))["rows"]
    return found


def noticed(statement: Statement) -> str:
    """The errors that a number or a statement notices, as text; "–" for other rows and those that cannot be judged."""
    if not statement.kind.is_evidence or statement.unjudged:
        return "–"
    if not statement.needs:
        return FORMULA
    found = _table().get(statement.id)
    if found is None:
        return NOT_STUDIED
    parts = [f"{name} {size} %" for name, size in found.items() if size]
    return ", ".join(parts) or NOTHING
