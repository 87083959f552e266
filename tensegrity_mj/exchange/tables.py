"""Tables of nodes and members (CSV), as spreadsheets write them: X_nodes.csv and, beside it, X_members.csv.

Nodes have `name`, `x`, `y`, `z` and may have `fixed` (the axes in which they are held: xyz, y, ...), `mass` (of a point
mass there) and `vx`, `vy`, `vz`. Members have `name`, `kind` (rod or string), `i`, `j` and the fields of a rod or a
string by their names in scene files, `group` among them. Empty cells are absent values. A line that begins
with # is a comment; cells are parted by commas, semicolons or tabs, whichever the first line has.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.basics.files import content_of, replacing
from tensegrity_mj.basics.texts import closest
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.exchange.importing import AXES, Draft, ImportOptions, held_axes
from tensegrity_mj.model.members import PRESTRESS, Rod, String
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.strings import StringLaw
from tensegrity_mj.model.structure_checks import check_bars_alone, names_of
from tensegrity_mj.model.text import codec
from tensegrity_mj.model.text.codec import Table

OF_ALL = {"name": "", "source": "", "structure": "", "duration": ""}


def left_out(scene: Scene, carried: Sequence[str]) -> list[str]:
    """A sentence for each field of a scene that is not at its default, and not among those carried over."""
    notes = []
    if scene.structure.string_law is not StringLaw.CLIPPED:
        notes.append(f"the string law '{scene.structure.string_law.value}' is left out")
    strings = scene.structure.strings
    curved, own = [len(one.curve) > 1 for one in strings], [one.string_law is not None for one in strings]
    for words, having in (
        ("the tension curves of strings {} are left out, but for their first slopes", curved),
        ("the string laws of strings {} are left out", own),
    ):
        if names := [string.name for string, has in zip(strings, having, strict=True) if has]:
            notes.append(words.format(names_of(names)))
    structure = scene.structure
    if any(point.damping for point in structure.point_masses):
        notes.append("the damping of point masses is left out")
    if any(rod.masses for rod in structure.rods):
        notes.append("the masses that rods carry are left out")
    if structure.constraints and "constraints" not in carried:
        notes.append("the linear constraints are left out")
    for key, one in item_of(Scene).keys.items():
        value = getattr(scene, one.name)
        if key in OF_ALL or key in carried or value is None or value is one.default or value == one.default:
            continue
        notes.append(f"the scene's {key.replace('_', ' ')} is left out")
    return notes


MOST_BYTES = 10_000_000
POSITION, VELOCITY = ("x", "y", "z"), ("vx", "vy", "vz")
NODE_COLUMNS = ("name", *POSITION, "fixed", "mass", *VELOCITY)
SECTION = tuple(item_of(Section).keys)
STRING = tuple(key for key, one in item_of(String).keys.items() if one.kind.load is float)
BAR = ("stiffness", "damping", "rest_length")  # of an elastic rod
MEMBER_COLUMNS = tuple(dict.fromkeys(("name", "kind", "i", "j", "group", "mass", "radius", *SECTION, *STRING)))
WORDS = ("name", "kind", "i", "j", "group", "fixed")


def pair_of(path: Path) -> tuple[Path, Path]:
    """The tables of nodes and of members, of which one is given.

    Raises:
        OptionError: if the name ends in neither.
    """
    for own in ("nodes", "members"):
        if path.stem.endswith(own):
            start = path.stem.removesuffix(own)
            return path.with_stem(f"{start}nodes"), path.with_stem(f"{start}members")
    raise OptionError(f"{path}: the name must end in nodes.csv (and that of its members in members.csv, beside it)")


def read(path: Path, options: ImportOptions) -> Draft:
    """The draft of two tables.

    Raises:
        FormatError: for what is wrong in a line of them.
        OptionError: for a name that ends neither in nodes.csv nor in members.csv.
    """
    nodes, members = pair_of(path)
    name = nodes.stem.removesuffix("nodes").rstrip("_-. ") or nodes.resolve().parent.name
    draft = Draft(name, f"CSV, {nodes.name}")
    for row in _rows(nodes, NODE_COLUMNS):
        key, fixed = row.text("name"), row.text("fixed", "").lower()
        if key in draft.nodes:
            raise row.fail("name", "a name of its own: a node above has it")
        draft.nodes[key] = [row.number(axis) for axis in POSITION]
        if set(fixed) - set(AXES):
            raise row.fail("fixed", "the axes in which the node is held: some of the letters xyz")
        if fixed:
            draft.held[key] = frozenset(fixed)
        if "mass" in row.data:
            draft.masses[key] = row.number("mass")
        if any(axis in row.data for axis in VELOCITY):
            draft.velocities[key] = [row.number(axis, 0.0) for axis in VELOCITY]
    for row in _rows(members, MEMBER_COLUMNS):
        kind = row.choice("kind", ("rod", "string"))
        for end in "ij":
            if row.text(end) not in draft.nodes:
                raise row.fail(end, f"the name of a node{closest(row.text(end), draft.nodes)}: {names_of(draft.nodes)}")
        ends = [row.data.pop(end) for end in "ij"]
        section = {key: row.data.pop(key) for key in SECTION if key in row.data}
        row.data.pop("kind")
        given = {"mass": options.rod_mass, "radius": options.rod_radius, "section": section or None}
        given = given if kind == "rod" else {key: getattr(options, key) for key in ("stiffness", "damping")}
        row.data = {key: value for key, value in given.items() if value is not None} | row.data | {"nodes": ends}
        if kind == "rod":
            draft.rods.append(codec.read(Rod, row))
        else:
            draft.strings.append(codec.read(String, row))
    joined = {name for rod in draft.rods for name in rod.nodes}
    for key in draft.nodes:
        if options.node_mass is not None and key not in joined and len(draft.held.get(key, ())) < 3:
            draft.masses.setdefault(key, options.node_mass)
    return draft


def _rows(path: Path, columns: Sequence[str]) -> Iterator[Table]:
    """The lines of a file whose first line names columns, some of these: tables of what is not empty."""
    try:
        text = content_of(path, MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not a text in UTF-8 ({error.reason} at byte {error.start})") from None
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    reader = csv.reader(io.StringIO(text), delimiter=max(",;\t", key=first.count), strict=True)
    header: list[str] = []
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if not any(cells) or cells[0].startswith("#"):
                continue
            if header:
                if len(cells) != len(header):
                    raise FormatError(
                        f"{path}: line {reader.line_num}: {len(cells)} cells; the first line has {len(header)}"
                    )
                filled = {key: _plain(key, cell) for key, cell in zip(header, cells, strict=True) if cell}
                yield Table(filled, str(path), f"line {reader.line_num}", None)
                continue
            header = cells
            for name in header:
                if name not in columns or header.count(name) > 1:
                    fault = "stands twice" if name in columns else f"is unknown{closest(name, columns)}"
                    raise FormatError(f"{path}: column '{name}' {fault}; allowed: {', '.join(columns)}")
    except csv.Error as error:
        raise FormatError(f"{path}: line {reader.line_num}: {error}") from None
    if not header:
        raise FormatError(f"{path}: it is empty; its first line must name the columns: {', '.join(columns)}")


def _plain(column: str, cell: str) -> Any:
    """A cell as a number, where its column has numbers and it is one."""
    try:
        return cell if column in WORDS else float(cell)
    except ValueError:
        return cell


def save_csv(scene: Scene, path: str | os.PathLike[str]) -> tuple[list[Path], list[str]]:
    """Write nodes and members beside each other; returns both paths, and what the tables do not hold.

    Raises:
        OptionError: for a name that does not end in nodes.csv or members.csv.
        FormatError: if a file cannot be written.
    """
    nodes, members = pair_of(Path(path))
    structure = scene.structure
    check_bars_alone(
        structure,
        "tables of members have two nodes a member, i and j; save the scene as TOML or MJCF",
    )
    held, notes = held_axes(structure)
    masses = {point.node: point.mass for point in structure.point_masses}
    rows: list[dict[str, Any]] = []
    # Where supports move, the start is that of their motion, which is left out.
    start, speeds = (scene.nodes0, scene.velocities0) if not scene.motions else (structure.positions, 0 * scene.nodes0)
    for name, at, speed in zip(structure.node_names, start.tolist(), speeds.tolist(), strict=True):
        row = {"name": name, **dict(zip(POSITION, at, strict=True)), "fixed": "".join(sorted(held.get(name, ())))}
        row |= {"mass": masses.get(name), **dict(zip(VELOCITY, (x or None for x in speed), strict=True))}
        rows.append(row)
    _write(nodes, NODE_COLUMNS, rows)
    rows = []
    for rod in structure.rods:
        section = {} if rod.section is None else {key: getattr(rod.section, key) for key in SECTION}
        row = {"name": rod.name, "kind": "rod", "group": rod.group, "mass": rod.mass, "radius": rod.radius}
        elastic = {} if rod.stiffness is None else {key: getattr(rod, key) for key in BAR}
        rows.append(row | {"nodes": rod.nodes} | section | elastic)
    for string, rest in zip(structure.strings, structure.rest_lengths.tolist(), strict=True):
        row = {key: getattr(string, key) for key in STRING}
        if scene.initial_nodes is not None:
            row |= dict.fromkeys(PRESTRESS) | {"rest_length": rest}  # which does not depend on where the nodes are
        rows.append({"name": string.name, "kind": "string", "group": string.group, "nodes": string.nodes} | row)
    for row in rows:
        row["i"], row["j"] = row.pop("nodes")
    _write(members, MEMBER_COLUMNS, rows)
    return [nodes, members], notes + left_out(scene, ("initial_nodes", "initial_velocities"))


def _write(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """A table with those of the columns that have a value somewhere; numbers read back the same."""
    used = [column for column in columns if any(row.get(column) not in (None, "") for row in rows)]
    with replacing(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, used, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
