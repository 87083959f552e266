"""Read structures and scenes from texts and files, and records of the ground.

Keys that members share by `defaults` and `groups` are first written out in each of them.

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
from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.basics.files import path_of
from tensegrity_mj.basics.texts import closest, value_text
from tensegrity_mj.errors import FormatError, SceneError, StructureError
from tensegrity_mj.model.composition import rotation_matrix
from tensegrity_mj.model.ground import Ground
from tensegrity_mj.model.members import PRESTRESS, Rod, String, Support
from tensegrity_mj.model.scene import Scene, Whole
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import names_of
from tensegrity_mj.model.target import Target
from tensegrity_mj.model.text import keys as known
from tensegrity_mj.model.text import sources
from tensegrity_mj.model.text.codec import READERS, WRITERS, Table, built, fields_of, read, read_fields, read_key, shown
from tensegrity_mj.model.text.keys import STRUCTURE_KEYS, SUPPORT_KEYS, TUBE_KEYS

SUPPORTS: dict[str, Callable[..., Support]] = {
    "free": Support.free,
    "pinned": Support.pinned,
    "constrained": Support.constrained,
}
PINNED = Support.pinned().directions
SHARING: dict[str, type] = {"rods": Rod, "strings": String}  # members with defaults and groups
# The keys that these members may share.
SHARED = {
    kind: [key for key in item_of(cls).keys if key not in ("name", "nodes", "group")] for kind, cls in SHARING.items()
}


def structure_of(table: Table, name: str) -> Structure:
    """The structure of a table, called `name` unless it says otherwise."""
    nodes = table.inside("nodes", None, "a table of node name = [x, y, z]")
    keys = item_of(Structure).keys
    whole = Table(table.data | _written_out(table), table.file, table.path, None)
    read = [key for key in STRUCTURE_KEYS if key in table.data and key in keys and key != "nodes"]
    given = {key: read_key(keys[key], whole, key) for key in read}
    return Structure(**{"name": name, "nodes": {key: nodes.vector(key) for key in nodes.data}, **given})


def _written_out(table: Table) -> dict[str, list[dict[str, Any]]]:
    """The rods and strings of a structure's table; what one of them leaves out is its group's, or else that of all."""
    defaults, groups = (table.inside(key) if key in table.data else None for key in ("defaults", "groups"))
    if defaults is not None:
        defaults.allow(list(SHARING))
    found: dict[str, list[dict[str, Any]]] = {}
    used: dict[str, dict[str, Any]] = {}
    for kind in SHARING:
        found[kind], of_group, of_all = [], {}, _shared(defaults, kind, kind)
        for member in table.tables(kind, None):
            group = member.text("group", "")
            if group and groups is not None and group not in groups.data:
                raise FormatError(
                    f"{member.where}: group = '{group}'{closest(group, groups.data)}; [{groups.path}] has "
                    f"{names_of(groups.data)}: give it a table there, too, an empty one where it shares nothing"
                )
            if group not in of_group:
                of_group[group] = _shared(groups, group, kind)
            found[kind].append(_over(_over(member.data, of_group[group]), of_all))
        used |= of_group
    unused = [] if groups is None else [group for group in groups.data if group not in used]
    for group in unused[:1]:
        raise FormatError(
            f"{table.where}.groups.{group}: no rod or string has group = '{group}'; give it to some, or leave it out"
        )
    return found


def _shared(tables: Table | None, name: str, kind: str) -> dict[str, Any]:
    """Read and check the keys that a table gives to a group, or to all, of a kind of members."""
    if tables is None or name not in tables.data:
        return {}
    place = f"{tables.path}.{name}" + (f" (of {kind})" if name != kind else "")
    table = Table(tables.data[name], tables.file, place, SHARED[kind])
    for key in table.data:
        one = item_of(SHARING[kind]).keys[key]
        checked(f"{place}: {key}", read_key(one, table, key), one.kind, StructureError)
    if len(given := [key for key in PRESTRESS if key in table.data]) > 1:
        raise StructureError(f"{place}: {' and '.join(given)} are given; give at most one of them")
    return table.data


def _over(own: dict[str, Any], shared: dict[str, Any]) -> dict[str, Any]:
    """A member's table over a shared one; of the three keys that say how taut a string is, the own one alone holds."""
    taut = any(key in own for key in PRESTRESS)
    return {key: value for key, value in shared.items() if not (taut and key in PRESTRESS)} | own


def _section(table: Table) -> Section:
    """A section by its area and second moment, or as a round tube."""
    if "outer_radius" not in table.data and "wall" not in table.data:
        return read_fields(Section, table)
    table.allow(TUBE_KEYS)
    given = {key: table.number(key) for key in TUBE_KEYS if key in table.data or key != "yield_stress"}
    return built(table, Section, lambda: Section.tube(**given))


def _support(table: Table) -> Support:
    kind = table.choice("kind", SUPPORT_KEYS)
    table.allow(SUPPORT_KEYS[kind])
    keys = item_of(Support).keys
    given = {key: read_key(keys[key], table, key) for key in SUPPORT_KEYS[kind][1:] if key in table.data or key == "D"}
    return built(table, Support, lambda: SUPPORTS[kind](**given))


def _rod_table(rod: Rod) -> dict[str, Any]:
    table = fields_of(rod)
    if rod.stiffness is None:
        del table["damping"]
    last = {"support": Support.free(), "masses": ()}
    own = {key: table.pop(key) for key in last}
    return table | {key: held for key, held in own.items() if held != last[key]}


def _support_table(support: Support) -> dict[str, Any]:
    pinned = support.directions == PINNED and support.values is None
    kind = "free" if not support.directions else "pinned" if pinned else "constrained"
    given = {key: value for key, value in vars(support).items() if value is not None}
    if kind == "constrained":
        given["D"] = support.directions
    return {"kind": kind} | {key: given[key] for key in ("sigma", "D", "values", "plane") if key in given}


def _string_table(string: String) -> dict[str, Any]:
    table = fields_of(string)
    if string.curve:  # which has it
        del table["stiffness"]
    return table


READERS[Section], READERS[Support] = _section, _support
WRITERS[Rod], WRITERS[Support], WRITERS[String] = _rod_table, _support_table, _string_table


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
