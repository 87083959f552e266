"""The texts of a command: its help, its examples and its arguments, from the TOML file next to its module.

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

What is seen to before the command begins (`prepare`): `needs` begins with the option without which this one means
nothing, and goes on in words; `writes` are the endings of the file to write, `holds` the files of the folder.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from functools import cache
from types import ModuleType
from typing import Any

from tensegrity_mj.basics.files import checked, table_beside
from tensegrity_mj.commands import common, experiment
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError

Row = dict[str, Any]


@cache
def words_of(module: ModuleType) -> dict[str, Any]:
    """Read the TOML file next to a command's module."""
    return table_beside(str(module.__file__))


def add_arguments(parser: argparse.ArgumentParser, module: ModuleType) -> None:
    """Add the arguments of a command, those of groups after the others."""
    words = words_of(module)
    places: list[tuple[Any, Sequence[Row]]] = [(parser, words.get("arguments", ()))]
    places += [(parser.add_argument_group(title), rows) for title, rows in words.get("groups", {}).items()]
    prepared: dict[str, Row] = {}
    for place, rows in places:
        for row in _expanded(rows):
            own = {key: row.pop(key) for key in ("needs", "writes", "holds") if key in row} | {"name": row["name"]}
            prepared[place.add_argument(row.pop("name"), **_settings(row, module)).dest] = own
    parser.set_defaults(prepared=prepared)


def prepare(options: argparse.Namespace) -> None:
    """Refuse options without those that they need, and make paths of files and folders that can be written.

    Raises:
        OptionError: naming the option, what it needs, or why nothing can be written there.
    """
    values = vars(options)
    given = {key: row for key, row in options.prepared.items() if values[key] is not None and values[key] is not False}
    for row in given.values():
        needed = re.match(r"--([\w-]+)", row.get("needs", ""))
        if needed and needed[1].replace("-", "_") not in given:
            raise OptionError(f"{row['name']} needs {row['needs']}")
    for key, row in given.items():
        if "writes" in row:
            setattr(options, key, checked(values[key], row["writes"], row["name"]))
        if "holds" in row:
            setattr(options, key, common.output_folder(values[key], row["holds"]))


def _expanded(rows: Sequence[Row]) -> Iterator[Row]:
    for row in rows:
        yield from _expanded(common.SHARED[row["use"]]) if "use" in row else [dict(row)]


def _settings(row: Row, module: ModuleType) -> Row:
    """Turn a row of the file into keyword arguments of argparse."""
    row.pop("instead", None)  # for messages of `experiment`
    for key in ("choices", "several"):
        if row.get(key) == "engines":
            row[key] = list(ENGINES)
    if "several" in row:
        choices = row.pop("several")
        row |= {"nargs": "+", "choices": choices, "help": f"some of {', '.join(choices)} (default: all)"}
    if "type" in row:
        homes = (module, experiment, common)
        row["type"] = next((getattr(one, row["type"]) for one in homes if hasattr(one, row["type"])), int)
    if isinstance(row.get("metavar"), list):
        row["metavar"] = tuple(row["metavar"])
    return row
