"""The words of a command: its help, its examples and its arguments, from the TOML file beside its module.

    help = "the mass of a structure"
    examples = "..."
    arguments = [
        { use = "scene" },
        { name = "--of", choices = ["rods", "point-masses", "all"], default = "all", help = "(all)" },
    ]

A row has `name` and what argparse's `add_argument` takes, `type` as the name of a function of the command's module, of
`experiment` or of `common`, or int. Choices may be "engines": those that there are. `several` are choices of
which some may be given, all by default. `use` stands for the rows of that name in `shared.toml`. The file's `[groups]`
have rows by the titles of argparse's groups. Choices that are values of enums stand in these files, so that --help need
not import the enums; tests compare both.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import cache
from types import ModuleType
from typing import Any

from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.commands import common, experiment
from tensegrity_mj.engines.table import ENGINES

Row = dict[str, Any]


def words_of(module: ModuleType) -> dict[str, Any]:
    """What the file beside a command's module holds."""
    return _read(str(module.__file__))


def add_arguments(parser: argparse.ArgumentParser, module: ModuleType) -> None:
    """The arguments of a command, those of groups after the others."""
    words = words_of(module)
    places: list[tuple[Any, Sequence[Row]]] = [(parser, words.get("arguments", ()))]
    places += [(parser.add_argument_group(title), rows) for title, rows in words.get("groups", {}).items()]
    for place, rows in places:
        for row in _expanded(rows):
            place.add_argument(row.pop("name"), **_settings(row, module))


@cache
def _read(module: str) -> dict[str, Any]:
    return table_beside(module)


def _expanded(rows: Sequence[Row]) -> Iterator[Row]:
    for row in rows:
        yield from _expanded(common.SHARED[row["use"]]) if "use" in row else [dict(row)]


def _settings(row: Row, module: ModuleType) -> Row:
    """What argparse takes."""
    row.pop("instead", None)  # for messages of `experiment`
    for key in ("choices", "several"):
        if row.get(key) == "engines":
            row[key] = list(ENGINES)
    if "several" in row:
        row |= {"nargs": "+", "choices": (choices := row.pop("several")), "help": f"of {', '.join(choices)} (all)"}
    if "type" in row:
        homes = (module, experiment, common)
        row["type"] = next((getattr(one, row["type"]) for one in homes if hasattr(one, row["type"])), int)
    if isinstance(row.get("metavar"), list):
        row["metavar"] = tuple(row["metavar"])
    return row
