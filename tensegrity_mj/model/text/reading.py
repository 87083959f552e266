"""Read structures and scenes from texts and files, and records of the ground.

Records are of the ground's acceleration (CSV): a column `time` [s], and `ax`, `ay`, `az` or some of them.

The first line may name the columns; without it they are in this order. A line that begins with # is a comment.
"""

from __future__ import annotations

import csv
import math
import os
import re
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.basics.files import path_of
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.errors import FormatError, SceneError, StructureError
from tensegrity_mj.model.composition import rotation_matrix
from tensegrity_mj.model.ground import Ground
from tensegrity_mj.model.scene import Scene, Whole
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.model.text import keys as known
from tensegrity_mj.model.text import sources
from tensegrity_mj.model.text.codec import Table, built, read, read_key, shown
from tensegrity_mj.model.text.structures import structure_of

T = TypeVar("T")


Families = Callable[[str], Structure | None]  # the structure that a call of a family makes; None for another text


def scene_from_toml(
    text: str, where: str = "TOML text", folder: Path | None = None, families: Families | None = None
) -> Scene:
    """The scene that a TOML text describes.

    Args:
        text: the text.
        where: its name in error messages.
        folder: base of relative paths, as in `structure = "other.toml"`, and of records; without one they are refused.
        families: reader of a `structure = "tower(stages=3)"` in it; without one that is the path of a file.
    """
    top = _top(text, where)
    structure = _read_structure(top, folder, families)
    return _validated(where, lambda: scene_of(top, structure, folder))


def structure_from_toml(
    text: str, where: str = "TOML text", folder: Path | None = None, families: Families | None = None
) -> Structure:
    """The structure that a TOML text describes; a [scene] in it is checked for its keys only."""
    return _read_structure(_top(text, where), folder, families)


def _top(text: str, where: str) -> Table:
    data = parse(text, where)
    if "format" not in data:
        raise FormatError(f"{where}: 'format' is missing; a file of this format starts with: format = {known.FORMAT}")
    if type(data["format"]) is not int or data["format"] != known.FORMAT:
        raise FormatError(f"{where}: format = {shown(data['format'])}; this version reads format = {known.FORMAT}")
    top = Table(data, where, "", known.FILE_KEYS)
    if "scene" in data:
        top.inside("scene", known.SCENE_KEYS)
    return top


def _read_structure(top: Table, folder: Path | None, families: Families | None = None) -> Structure:
    if isinstance(top.data.get("structure"), str):
        called = None if families is None else families(top.data["structure"])
        return _other_structure(top, folder) if called is None else called
    need = "a table [structure], or the path of the file that holds it"
    table = top.inside("structure", known.STRUCTURE_KEYS, need)
    return _validated(top.where, lambda: structure_of(table, top.text("name")))


def _other_structure(top: Table, folder: Path | None) -> Structure:
    reference = top.text("structure")
    if folder is None:
        raise top.fail("structure", "a table here: a text on its own has no folder that a path could be relative to")
    path = folder / reference
    other = _top(sources.read(path), str(path))
    if isinstance(other.data.get("structure"), str):
        raise FormatError(
            f"{top.where}: structure = '{reference}', which refers to another file in turn: name that file here"
        )
    return _read_structure(other, None)


def _validated(where: str, build: Callable[[], T]) -> T:
    """Return `build()`; an error of validation gets the file in front."""
    try:
        return build()
    except (StructureError, SceneError) as error:
        raise type(error)(f"{where}: {error}") from error


# Texts in quotes, closed or not, and comments: each alternative takes what it can and never goes back.
_TEXTS = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:""")?+'
    r"|'''(?:[^']|'(?!''))*+(?:''')?+"
    r'|"(?:[^"\\\n]|\\.)*+"?+'
    r"|'[^'\n]*+'?+"
    r"|\#[^\n]*+",
    re.DOTALL,
)
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{known.MOST_DEPTH}}}")


def parse(text: str, where: str) -> dict[str, Any]:
    """The table that a TOML text describes.

    Raises:
        FormatError: if it is not valid TOML, has a key of more than `MOST_DEPTH` parts (the time to read one grows as
            their square), or values that stand in each other deeper than that.
    """
    # A text in quotes may be a part of a key, and counts as a word; a comment as nothing.
    found = _LONG_KEY.search(_TEXTS.sub(lambda one: "" if one[0].startswith("#") else "q", text))
    if found is not None:
        raise FormatError(
            f"{where}: a dotted key, {found[0]}..., has more than {known.MOST_DEPTH} parts; docs/format.md describes "
            "the keys"
        )
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError; numbers of thousands of digits; deep nesting
        found = re.search(r"at line (\d+)", str(error))
        line = text.splitlines()[int(found[1]) - 1 :][:1] if found else []
        quoted = f": {value_text(line[0].strip())}" if line else ""
        raise FormatError(f"{where}: not valid TOML: {error}{quoted}; docs/format.md shows how to write it") from error
    if _deeper(data, known.MOST_DEPTH):
        raise FormatError(
            f"{where}: its tables and lists stand in each other more than {known.MOST_DEPTH} deep; write what "
            "docs/format.md describes"
        )
    return data


def _deeper(data: Any, most: int) -> bool:
    """Return whether tables and lists are nested more than `most` deep."""
    level = [data]
    for _ in range(most):
        insides = [item.values() if isinstance(item, dict) else item for item in level]
        level = [item for inside in insides for item in inside if isinstance(item, (dict, list))]
        if not level:
            return False
    return True


def scene_of(top: Table, structure: Structure, folder: Path | None = None) -> Scene:
    """The scene of a file, with the structure that it names, which stands and starts as `whole` says.

    Its records are in files relative to a folder.
    """
    table = top.inside("scene", known.SCENE_KEYS) if "scene" in top.data else Table({}, top.where, "scene", None)
    whole = read(Whole, table.inside("whole")) if "whole" in table.data else None
    placed = structure if whole is None else structure.moved(whole.rotation, whole.translation)
    keys = item_of(Scene).keys
    given: dict[str, Any] = {}
    starts = {"initial_nodes": structure.positions, "initial_velocities": np.zeros_like(structure.positions)}
    for key in known.SCENE_KEYS:
        if key not in table.data or key not in keys:
            continue
        if key in starts:
            given[key] = table.inside(key).node_rows(structure, starts[key])
        elif key == "target":  # in the world frame: of the structure where it stands
            given[key] = _target(table, placed.massless)
        else:
            given[key] = read_key(keys[key], table, key)
    if whole is not None:
        turn = rotation_matrix(whole.rotation).T
        shifts = {"initial_nodes": np.array(whole.translation), "initial_velocities": np.zeros(3)}
        given |= {key: given[key] @ turn + shift for key, shift in shifts.items() if key in given}
    scene = Scene(structure=placed, name=top.text("name"), source=top.text("source", ""), **given)
    if "ground" in table.data:
        scene = _shaken(table.inside("ground", known.GROUND_KEYS), folder, scene)
    return scene if whole is None else whole.start(scene)


def _shaken(table: Table, folder: Path | None, scene: Scene) -> Scene:
    keys, name = item_of(Ground).keys, table.text("file")
    if folder is None:
        raise table.fail("file", "in a file: a text on its own has no folder that a path could be relative to")
    given = {key: read_key(keys[key], table, key) for key in known.GROUND_KEYS[1:] if key in table.data}
    return built(table, Ground, lambda: load_ground(folder / name, **given).shake(scene))


def _target(scene: Table, structure: Structure) -> Target:
    table = scene.inside("target", known.TARGET_KEYS)
    if sum(key in table.data for key in ("nodes", "waypoints", "shapes")) != 1:
        raise FormatError(
            f"{table.where}: it must hold one of 'nodes' (a set-point), 'waypoints' (a path) or 'shapes' (a curve)"
        )
    if "shapes" in table.data:
        return _curve(table, structure)
    table.allow(known.TARGET_KEYS[:2])
    if "nodes" in table.data:
        return Target.set_point(table.inside("nodes").node_rows(structure, structure.positions))
    times, rows = _node_tables(table, "waypoints", "time", known.WAYPOINT_KEYS, structure)
    return Target.path(times, rows)


def _curve(table: Table, structure: Structure) -> Target:
    table.allow(known.CURVE_KEYS)
    parameters, shapes = _node_tables(table, "shapes", "parameter", known.SHAPE_KEYS, structure)
    need = "a list of numbers, one a time"
    times = table.numbers("times", "a list of numbers")
    values, rates, accelerations = (
        table.numbers(key, need, len(times), default)
        for key, default in (("values", ...), ("rates", None), ("accelerations", None))
    )
    return Target.curve(times, values, parameters, shapes, rates, accelerations)


def _node_tables(
    table: Table, key: str, title: str, keys: Sequence[str], structure: Structure
) -> tuple[list[float], list[Array]]:
    """The numbers called `title` and the node positions of an array of tables."""
    numbers, positions = [], []
    items = table.tables(key, keys)
    if len(items) * len(structure.nodes) > known.MOST_POSITIONS:
        raise FormatError(
            f"{table.where}: {key} has {len(items)} tables for {len(structure.nodes)} nodes each; at most "
            f"{known.MOST_POSITIONS} positions are read: give fewer"
        )
    for item in items:
        rows = item.inside("nodes") if "nodes" in item.data else Table({}, item.file, item.path, None)
        numbers.append(item.number(title))
        positions.append(rows.node_rows(structure, structure.positions))
    if not numbers:
        raise table.fail(key, "an array of at least one table")
    return numbers, positions


COLUMNS = ("time", "ax", "ay", "az")
FORM = f"its columns must be {', '.join(COLUMNS)}, or time and some of the others"


def load_ground(path: str | os.PathLike[str], **options: Any) -> Ground:
    """The ground of a record, with `baseline` and `scale` as `Ground` has them.

    Raises:
        FormatError: for what is no such table, and times that do not increase.
        SceneError: for a first time below zero, and options that are none.
    """
    source, columns = path_of(path, "a record's CSV file"), list[str]()
    times, accelerations = list[float](), list[list[float]]()
    lines = sources.read(source).splitlines()
    rows = csv.reader("" if line.startswith("#") else line for line in lines)
    try:
        for cells in filter(None, rows):
            named = [cell.strip().lower() for cell in cells]
            if not columns:
                columns = named if "time" in named else list(COLUMNS[: len(cells)])
                if len(set(columns)) < max(2, len(cells)) or not {*columns} <= {*COLUMNS}:
                    raise FormatError(f"{source}, line {rows.line_num}: {', '.join(named)[:60]}; {FORM}")
                if columns == named:
                    continue
            if len(cells) != len(columns):
                raise FormatError(f"{source}, line {rows.line_num}: {len(cells)} cells below {len(columns)} columns")
            row = dict(zip(columns, map(_number, named), strict=True))
            if not all(map(math.isfinite, row.values())):
                raise FormatError(
                    f"{source}, line {rows.line_num}: {', '.join(cells)[:60]}; all must be finite numbers"
                )
            if times and row["time"] <= times[-1]:
                before = f"time is {row['time']:g} s after {times[-1]:g} s"
                raise FormatError(f"{source}, line {rows.line_num}: {before}; times must increase")
            times.append(row["time"])
            accelerations.append([row.get(name, 0.0) for name in COLUMNS[1:]])
    except csv.Error as error:
        raise FormatError(f"{source}, line {rows.line_num}: {error}") from None
    if len(times) < 2:
        raise FormatError(f"{source}: {len(times)} lines of numbers; a record needs two times or more")
    return Ground(times, accelerations, **options)  # type: ignore[arg-type]


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
