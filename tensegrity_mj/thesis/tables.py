"""The tables of what the thesis states: a TOML file a chapter, a row each, read into `Statement`s.

A row has `id`, `class`, `where`, `page`, `words` (what is measured), `stated`, `reason` (of the band), `measure` and
`runs`, and where they apply `figure`, `arguments`, `unit`, `band` (a row without one is a sentence that holds or does
not), `value`, `printed`, `line`, `origin`, `engines`, `differs = {cause, ours}` and `unjudged`. A reason, a cause, an
origin or an `unjudged` that is the name of one of the file's `[texts]` stands for that text. A measure is the name of a
function, which is given the runs and the arguments, or an expression of them, see `expression`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from tensegrity_mj.errors import FormatError
from tensegrity_mj.thesis.experiments import EngineName
from tensegrity_mj.thesis.expression import compiled
from tensegrity_mj.thesis.lookup import all_measures
from tensegrity_mj.thesis.statement import HOLDS, Class, Interval, KnownDifference, Statement

FOLDER = Path(__file__).parent / "tables"
FILES = ("chapter3", "chapter4", "chapter5", "chapter6", "chapter7", "appendix_c")

NEEDED = {"id": str, "class": str, "where": str, "page": int, "words": str, "stated": str}
OPTIONAL = {
    "figure": str,
    "reason": str,
    "measure": str,
    "runs": list,
    "arguments": dict,
    "unit": str,
    "band": list,
    "value": list,
    "printed": list,
    "line": int,
    "origin": str,
    "engines": list,
    "differs": dict,
    "unjudged": str,
}


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
    texts = data.get("texts", {})
    statements = [_statement(f"{path.name}, row {row.get('id', number)!r}", row, texts)
                  for number, row in enumerate(data.get("rows", []), start=1)]  # fmt: skip
    ids = [one.id for one in statements]
    for name in ids:
        if ids.count(name) > 1:
            raise FormatError(f"{path.name}: two rows have the id '{name}'; ids are unique")
    return statements


def _statement(where: str, row: Mapping[str, Any], texts: Mapping[str, str]) -> Statement:
    for key, kind in NEEDED.items():
        if not isinstance(row.get(key), kind):
            raise FormatError(f"{where}: {key} = {row.get(key)!r}; it must be a {kind.__name__}")
    for key, value in row.items():
        if key not in {**NEEDED, **OPTIONAL}:
            raise FormatError(f"{where}: unknown key '{key}'; allowed: {', '.join([*NEEDED, *OPTIONAL])}")
        if not isinstance(value, OPTIONAL.get(key, object)):
            raise FormatError(f"{where}: {key} = {value!r}; it must be a {OPTIONAL[key].__name__}")
    unjudged, measure = row.get("unjudged", ""), row.get("measure", "")
    if measure and measure not in all_measures():
        try:
            compiled(measure, tuple(all_measures()))
        except ValueError as error:
            raise FormatError(f"{where}: measure = '{measure}'; it {error}") from None
    if not measure and not unjudged:
        raise FormatError(f"{where}: it has neither a measure nor a reason why it cannot be judged (unjudged)")
    differs = row.get("differs")
    known = None
    if differs is not None:
        cause = differs.get("cause", "")
        known = KnownDifference(texts.get(cause, cause), _interval(where, differs.get("ours")))
    return Statement(
        id=row["id"],
        kind=_member(where, Class, row["class"]),
        figure=row.get("figure", ""),
        place=row["where"],
        page=row["page"],
        says=row["words"],
        stated=row["stated"],
        accepted=_interval(where, row["band"]) if "band" in row else Interval() if unjudged else HOLDS,
        tolerance=texts.get(row.get("reason", ""), row.get("reason", "")),
        needs=tuple(row.get("runs", ())),
        measure=measure,
        arguments=row.get("arguments", {}),
        unit=row.get("unit", ""),
        value=tuple(float(x) for x in row.get("value", ())),
        printed=tuple(row.get("printed", ())),
        line=row.get("line", 0),
        origin=texts.get(row.get("origin", ""), row.get("origin", "")),
        known=known,
        engines=tuple(_member(where, EngineName, name) for name in row.get("engines", ())),
        unjudged=texts.get(unjudged, unjudged),
    )


def _interval(where: str, ends: Any) -> Interval:
    if not isinstance(ends, list) or len(ends) != 2 or not all(isinstance(x, (int, float)) for x in ends):
        raise FormatError(f"{where}: {ends!r}; a band is two numbers, [low, high]")
    if not ends[0] <= ends[1]:
        raise FormatError(f"{where}: {ends!r}; the first end of a band is not above the second")
    return Interval(float(ends[0]), float(ends[1]))


def _member(where: str, kind: Any, value: str) -> Any:
    try:
        return kind(value)
    except ValueError:
        raise FormatError(f"{where}: '{value}'; allowed: {', '.join(one.value for one in kind)}") from None
