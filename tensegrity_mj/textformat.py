"""Structures and scenes as TOML that a person can write; read and saved without loss. See docs/format.md.

Numbers are written with the fewest digits that read back to the same float. The reader says what is wrong
(`FormatError`: what no file of this format may hold; `StructureError`, `SceneError`: what is well written but
not valid), always with the file first.
"""

from __future__ import annotations

import difflib
import importlib.resources
import os
import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import tomli_w
from numpy.typing import NDArray

from tensegrity_mj.contact import Contact
from tensegrity_mj.errors import FormatError, SceneError, StructureError
from tensegrity_mj.files import replacing
from tensegrity_mj.motion import Harmonic, Motion
from tensegrity_mj.resistance import Bending, Drag, Resistance
from tensegrity_mj.scene import Break, ControlSpec, Load, Scene, Target
from tensegrity_mj.strings import StringLaw
from tensegrity_mj.structure import LIMITS, PointMass, Rod, String, Structure, Support

Array = NDArray[np.float64]
T = TypeVar("T")

FORMAT = 1
HEADING = "# tensegrity-mj; SI units, world frame with z up. Every key: docs/format.md"
PINNED = Support.pinned().directions

FILE_KEYS = ("format", "name", "source", "structure", "scene")
STRUCTURE_KEYS = ("name", "string_law", "fixed_nodes", "nodes", "rods", "strings", "point_masses")
ROD_KEYS = ("name", "nodes", "mass", "radius", "support")
STRING_KEYS = ("name", "nodes", "stiffness", "damping", "rest_length", "tension", "force_density", *LIMITS)
POINT_MASS_KEYS = ("node", "mass", "plane")
SUPPORT_KEYS = {
    "free": ("kind", "sigma", "plane"),
    "pinned": ("kind", "sigma", "plane"),
    "constrained": ("kind", "sigma", "plane", "D", "values"),
}
SCENE_KEYS = (
    "gravity",
    "duration",
    "loads",
    "breaks",
    "motions",
    "contact",
    "resistance",
    "initial_nodes",
    "initial_velocities",
    "target",
    "control",
)
CONTACT_KEYS = ("floor", "normal", "rods", "friction", "stiffness", "damping", "impedance")
RESISTANCE_KEYS = ("viscous", "bending", "drag", "wind")
BENDING_KEYS = ("stiffness", "damping", "pairs")
DRAG_KEYS = ("normal", "tangential", "density", "diameter")
BREAK_KEYS = ("string", "time")
LOAD_KEYS = ("node", "force", "angular_frequency", "phase")
MOTION_DATA = ("times", "displacements", "velocities", "accelerations")
MOTION_KEYS = ("support", "harmonics", *MOTION_DATA)
HARMONIC_KEYS = ("amplitude", "angular_frequency", "phase")
TARGET_KEYS = ("nodes", "waypoints", "times", "values", "rates", "accelerations", "shapes")
CURVE_KEYS = TARGET_KEYS[2:]
SHAPE_KEYS = ("parameter", "nodes")
WAYPOINT_KEYS = ("time", "nodes")
CONTROL_KEYS = ("law", "options")


def scene_names() -> list[str]:
    """Names of the scenes that come with the package."""
    folders = importlib.resources.files("tensegrity_mj.models").iterdir()
    return sorted(folder.name for folder in folders if folder.joinpath("scene.toml").is_file())


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """The scene of that name in the package (see `scene_names`), or the one in that .toml file.

    A text without a path separator that does not end in .toml is a name.

    Raises:
        FormatError: if there is no such scene or file, or it is not of this format.
        StructureError, SceneError: if what it describes is not valid.
    """
    text, where, folder = _find(name_or_path)
    return scene_from_toml(text, where, folder)


def load_structure(name_or_path: str | os.PathLike[str]) -> Structure:
    """The structure of a file, or of a scene of the package; named, and failing, as `load_scene`."""
    text, where, folder = _find(name_or_path)
    return structure_from_toml(text, where, folder)


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> Path:
    """Write a scene, atomically (a crash leaves the old file or none); returns the path.

    Raises:
        SceneError: if its loads or a motion are a Python function, which no file can hold.
        FormatError: if the file cannot be written.
    """
    return _write(path, scene_to_toml(scene))


def save_structure(structure: Structure, path: str | os.PathLike[str]) -> Path:
    """Write a structure, atomically; returns the path.

    Raises:
        FormatError: if the file cannot be written.
    """
    return _write(path, structure_to_toml(structure))


def scene_from_toml(text: str, where: str = "TOML text", folder: Path | None = None) -> Scene:
    """The scene that a TOML text describes.

    Args:
        text: the text.
        where: what error messages call it.
        folder: what a `structure = "other.toml"` in it is relative to; without one it is refused.
    """
    top = _top(text, where)
    structure = _read_structure(top, folder)
    return _validated(where, lambda: _read_scene(top, structure))


def structure_from_toml(text: str, where: str = "TOML text", folder: Path | None = None) -> Structure:
    """The structure that a TOML text describes; a [scene] in it is checked for its keys only."""
    return _read_structure(_top(text, where), folder)


def scene_to_toml(scene: Scene) -> str:
    """The scene as TOML text, without loss.

    Raises:
        SceneError: if its loads or a motion are a Python function, which no file can hold.
    """
    if callable(scene.loads):
        raise SceneError(
            f"scene '{scene.name}': its loads are a Python function, which a file cannot hold: "
            "describe them by Loads, or save it without them (scene.with_(loads=()))"
        )
    for motion in scene.motions:
        if motion.function is not None:
            raise SceneError(
                f"scene '{scene.name}': the motion of '{motion.support}' is a Python function, which a file cannot "
                "hold: describe it by harmonics or data (motion.sampled(times) makes data of it)"
            )
    head = [HEADING, f"format = {FORMAT}", _entry("name", scene.name)]
    if scene.source:
        head.append(_entry("source", scene.source))
    return "\n".join([*head, "", *_structure_lines(scene.structure, scene.name), "", *_scene_lines(scene)]) + "\n"


def structure_to_toml(structure: Structure) -> str:
    """The structure as TOML text, without loss."""
    head = [HEADING, f"format = {FORMAT}", _entry("name", structure.name), ""]
    return "\n".join(head + _structure_lines(structure, structure.name)) + "\n"


# Reading -------------------------------------------------------------------------------------------------


class _Table:
    """A TOML table that knows its place and reads its keys with their types, or says what is wrong."""

    def __init__(self, data: Any, file: str, path: str, keys: Sequence[str] | None) -> None:
        self.file, self.path = file, path
        self.where = f"{file}: {path}" if path else file
        if not isinstance(data, dict):
            raise FormatError(f"{self.where} = {_shown(data)}; it must be a table")
        self.data: dict[str, Any] = data
        if keys is not None:
            self.allow(keys)

    def allow(self, keys: Sequence[str]) -> None:
        for key in self.data:
            if key not in keys:
                raise FormatError(f"{self.where}: unknown key '{key}'{_closest(key, keys)}; allowed: {', '.join(keys)}")

    def fail(self, key: str, need: str) -> FormatError:
        if key not in self.data:
            return FormatError(f"{self.where}: '{key}' is missing; it must be {need}")
        return FormatError(f"{self.where}: {key} = {_shown(self.data[key])}; it must be {need}")

    def get(self, key: str, need: str, valid: Callable[[Any], bool], default: Any = ...) -> Any:
        """The value of a key, or the default (... for none: the key must be there)."""
        if key not in self.data and default is not ...:
            return default
        if key not in self.data or not valid(self.data[key]):
            raise self.fail(key, need)
        return self.data[key]

    def text(self, key: str, default: Any = ...) -> str:
        value: str = self.get(key, "a text in quotes", lambda x: isinstance(x, str), default)
        return value

    def choice(self, key: str, allowed: Collection[str], default: Any = ...) -> str:
        need = " or ".join(f'"{item}"' for item in allowed)
        value: str = self.get(key, need, lambda x: isinstance(x, str) and x in allowed, default)
        return value

    def number(self, key: str, default: Any = ...) -> Any:
        value = self.get(key, "a number", _is_number, default)
        return float(value) if key in self.data else value

    def numbers(self, key: str, need: str, size: int | None = None, default: Any = ...) -> Any:
        value = self.get(key, need, lambda x: _is_list(x, _is_number) and size in (None, len(x)), default)
        return tuple(float(x) for x in value) if key in self.data else value

    def vector(self, key: str, default: Any = ...) -> Any:
        return self.numbers(key, "three numbers [x, y, z]", 3, default)

    def texts(self, key: str, default: Any = ...) -> Any:
        need = "a list of names in quotes"
        return tuple(self.get(key, need, lambda x: _is_list(x, lambda item: isinstance(item, str)), default))

    def table(self, key: str, keys: Sequence[str] | None) -> _Table | None:
        """A table inside, or None if absent."""
        return self._inside(key, self.data[key], keys) if key in self.data else None

    def tables(self, key: str, keys: Sequence[str], title: str = "name") -> list[_Table]:
        """An array of tables inside, empty if absent; messages call each by its number and `title`."""
        found = self.get(key, "an array of tables", lambda x: _is_list(x, lambda item: isinstance(item, dict)), [])
        names = (f" '{item[title]}'" if isinstance(item.get(title), str) else "" for item in found)
        rows = enumerate(zip(found, names, strict=True))
        return [self._inside(f"{key}[{number}]{name}", item, keys) for number, (item, name) in rows]

    def _inside(self, name: str, data: Any, keys: Sequence[str] | None) -> _Table:
        return _Table(data, self.file, f"{self.path}.{name}" if self.path else name, keys)

    def node_rows(self, structure: Structure, base: Array) -> Array:
        """This table as node name = [x, y, z], over the rows of `base` (N, 3) for the nodes it leaves out."""
        rows = np.array(base)
        for name in self.data:
            if name not in structure.node_index:
                known = structure.node_names
                raise FormatError(
                    f"{self.where}: unknown node '{name}'{_closest(name, known)}; the nodes are {', '.join(known)}"
                )
            rows[structure.node_index[name]] = self.vector(name)
        return rows


def _top(text: str, where: str) -> _Table:
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError; numbers of thousands of digits; deep nesting
        raise FormatError(f"{where}: not valid TOML: {error}") from error
    if "format" not in data:
        raise FormatError(f"{where}: 'format' is missing; a file of this format starts with: format = {FORMAT}")
    if type(data["format"]) is not int or data["format"] != FORMAT:
        raise FormatError(f"{where}: format = {_shown(data['format'])}; this version reads format = {FORMAT}")
    top = _Table(data, where, "", FILE_KEYS)
    top.table("scene", SCENE_KEYS)
    return top


def _read_structure(top: _Table, folder: Path | None) -> Structure:
    if isinstance(top.data.get("structure"), str):
        return _other_structure(top, folder)
    if "structure" not in top.data:
        raise top.fail("structure", "a table [structure], or the path of the file that holds it")
    table = top.table("structure", STRUCTURE_KEYS)
    assert table is not None
    return _validated(top.where, lambda: _structure(table, top.text("name")))


def _other_structure(top: _Table, folder: Path | None) -> Structure:
    reference = top.text("structure")
    if folder is None:
        raise top.fail("structure", "a table here: a text on its own has no folder that a path could be relative to")
    path = folder / reference
    other = _top(_read(path), str(path))
    if isinstance(other.data.get("structure"), str):
        raise FormatError(
            f"{top.where}: structure = '{reference}', which refers to another file in turn: name that file here"
        )
    return _read_structure(other, None)


def _structure(table: _Table, name: str) -> Structure:
    nodes = table.table("nodes", None)
    if nodes is None:
        raise table.fail("nodes", "a table of node name = [x, y, z]")
    laws = [law.value for law in StringLaw]
    return Structure(
        name=table.text("name", name),
        nodes={key: nodes.vector(key) for key in nodes.data},
        rods=tuple(_rod(item) for item in table.tables("rods", ROD_KEYS)),
        strings=tuple(_string(item) for item in table.tables("strings", STRING_KEYS)),
        fixed_nodes=table.texts("fixed_nodes", ()),
        point_masses=tuple(
            PointMass(item.text("node"), item.number("mass"), item.vector("plane", None))
            for item in table.tables("point_masses", POINT_MASS_KEYS, title="node")
        ),
        string_law=StringLaw(table.choice("string_law", laws, StringLaw.CLIPPED.value)),
    )


def _rod(table: _Table) -> Rod:
    support = table.table("support", None)
    return Rod(
        table.text("name"),
        table.texts("nodes"),
        table.number("mass"),
        table.number("radius", Rod.radius),
        Support.free() if support is None else _support(support),
    )


def _support(table: _Table) -> Support:
    kind = table.choice("kind", SUPPORT_KEYS)
    table.allow(SUPPORT_KEYS[kind])
    plane = table.vector("plane", None)
    if kind == "free":
        return Support.free(table.number("sigma", 0.5), plane)
    sigma = table.number("sigma", 0.0)
    if kind == "pinned":
        return Support.pinned(sigma, plane)
    rows = table.get("D", "rows of three numbers, as [[0, 0, 1]]", lambda x: bool(x) and _is_list(x, _is_row))
    return Support.constrained(rows, sigma, table.numbers("values", "a number a row of D", len(rows), None), plane)


def _string(table: _Table) -> String:
    return String(
        table.text("name"),
        table.texts("nodes"),
        table.number("stiffness"),
        table.number("damping", String.damping),
        table.number("rest_length", None),
        table.number("tension", None),
        table.number("force_density", None),
        *(table.number(name, None) for name in LIMITS),
    )


def _read_scene(top: _Table, structure: Structure) -> Scene:
    table = top.table("scene", SCENE_KEYS) or _Table({}, top.where, "scene", SCENE_KEYS)
    nodes, velocities = table.table("initial_nodes", None), table.table("initial_velocities", None)
    still = np.zeros_like(structure.positions)
    return Scene(
        structure=structure,
        name=top.text("name"),
        source=top.text("source", ""),
        gravity=table.vector("gravity", Scene.gravity),
        initial_nodes=None if nodes is None else nodes.node_rows(structure, structure.positions),
        initial_velocities=None if velocities is None else velocities.node_rows(structure, still),
        loads=tuple(_load(item) for item in table.tables("loads", LOAD_KEYS, title="node")),
        breaks=tuple(
            Break(item.text("string"), item.number("time"))
            for item in table.tables("breaks", BREAK_KEYS, title="string")
        ),
        motions=tuple(_motion(item) for item in table.tables("motions", MOTION_KEYS, title="support")),
        target=_target(table, structure),
        control=_control(table),
        duration=table.number("duration", Scene.duration),
        contact=_contact(table),
        resistance=_resistance(table),
    )


def _load(table: _Table) -> Load:
    frequency, phase = table.number("angular_frequency", 0.0), table.number("phase", 0.0)
    return Load(table.text("node"), table.vector("force"), frequency, phase)


def _motion(table: _Table) -> Motion:
    harmonics = tuple(
        Harmonic(item.vector("amplitude"), item.number("angular_frequency", 0.0), item.number("phase", 0.0))
        for item in table.tables("harmonics", HARMONIC_KEYS)
    )
    rows = "rows of three numbers, one a time"
    columns = [table.get(key, rows, lambda x: _is_list(x, _is_row), ()) for key in MOTION_DATA[1:]]
    return Motion(table.text("support"), harmonics, table.numbers("times", "a list of numbers", None, ()), *columns)


def _contact(scene: _Table) -> Contact | None:
    table = scene.table("contact", CONTACT_KEYS)
    if table is None:
        return None
    return Contact(
        table.number("floor", None),
        table.vector("normal", Contact.normal),
        table.get("rods", "true or false", lambda x: isinstance(x, bool), Contact.rods),
        table.number("friction", Contact.friction),
        table.number("stiffness", Contact.stiffness),
        table.number("damping", Contact.damping),
        table.numbers("impedance", "five numbers [d0, d1, width, midpoint, power]", 5, Contact.impedance),
    )


def _resistance(scene: _Table) -> Resistance | None:
    table = scene.table("resistance", RESISTANCE_KEYS)
    if table is None:
        return None
    bending, drag = table.table("bending", BENDING_KEYS), table.table("drag", DRAG_KEYS)
    return Resistance(
        table.number("viscous", Resistance.viscous),
        None if bending is None else _bending(bending),
        None
        if drag is None
        else Drag(
            drag.number("normal", Drag.normal),
            drag.number("tangential", Drag.tangential),
            drag.number("density", Drag.density),
            drag.number("diameter", None),
        ),
        table.vector("wind", Resistance.wind),
    )


def _bending(table: _Table) -> Bending:
    def is_pair(value: Any) -> bool:
        return _is_list(value, lambda name: isinstance(name, str)) and len(value) == 2

    need = 'a list of pairs of rods, as [["rod1", "rod2"]]'
    pairs = table.get("pairs", need, lambda x: _is_list(x, is_pair), None)
    return Bending(
        table.number("stiffness", Bending.stiffness),
        table.number("damping", Bending.damping),
        None if pairs is None else tuple((a, b) for a, b in pairs),
    )


def _target(scene: _Table, structure: Structure) -> Target | None:
    table = scene.table("target", TARGET_KEYS)
    if table is None:
        return None
    nodes = table.table("nodes", None)
    if sum(key in table.data for key in ("nodes", "waypoints", "shapes")) != 1:
        raise FormatError(
            f"{table.where}: it must hold one of 'nodes' (a set-point), 'waypoints' (a path) or 'shapes' (a curve)"
        )
    if "shapes" in table.data:
        return _curve(table, structure)
    table.allow(TARGET_KEYS[:2])
    if nodes is not None:
        return Target.set_point(nodes.node_rows(structure, structure.positions))
    times, rows = _node_tables(table, "waypoints", "time", WAYPOINT_KEYS, structure)
    return Target.path(times, rows)


def _curve(table: _Table, structure: Structure) -> Target:
    table.allow(CURVE_KEYS)
    parameters, shapes = _node_tables(table, "shapes", "parameter", SHAPE_KEYS, structure)
    need = "a list of numbers, one a time"
    times = table.numbers("times", "a list of numbers")
    values, rates, accelerations = (
        table.numbers(key, need, len(times), default)
        for key, default in (("values", ...), ("rates", None), ("accelerations", None))
    )
    return Target.curve(times, values, parameters, shapes, rates, accelerations)


def _node_tables(
    table: _Table, key: str, title: str, keys: Sequence[str], structure: Structure
) -> tuple[list[float], list[Array]]:
    """The numbers called `title` and the node positions of an array of tables."""
    numbers, positions = [], []
    for item in table.tables(key, keys):
        rows = item.table("nodes", None) or _Table({}, item.file, item.path, None)
        numbers.append(item.number(title))
        positions.append(rows.node_rows(structure, structure.positions))
    if not numbers:
        raise table.fail(key, "an array of at least one table")
    return numbers, positions


def _control(scene: _Table) -> ControlSpec | None:
    table = scene.table("control", CONTROL_KEYS)
    if table is None:
        return None
    options = table.table("options", None)
    for key, value in options.data.items() if options is not None else ():
        if not _is_option(value):
            assert options is not None
            raise options.fail(key, "a number, a text, true or false, or a list of them")
    return ControlSpec(table.text("law"), {} if options is None else options.data)


def _is_number(value: Any) -> bool:
    # A float cannot hold an integer beyond 1e308: no number here.
    return isinstance(value, float) or (type(value) is int and abs(value) < 10**308)


def _is_list(value: Any, valid: Callable[[Any], bool]) -> bool:
    return isinstance(value, list) and all(valid(item) for item in value)


def _is_row(value: Any) -> bool:
    return _is_list(value, _is_number) and len(value) == 3


def _is_option(value: Any) -> bool:
    return isinstance(value, (bool, int, float, str)) or _is_list(value, _is_option)


def _shown(value: Any) -> str:
    """A value as a person would write it, with its type, and not endlessly long."""
    kinds = {
        str: "a text",
        bool: "a truth value",
        int: "an integer",
        float: "a number",
        list: "a list",
        dict: "a table",
    }
    try:
        text = {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value)
    except ValueError:  # an integer of thousands of digits
        text = "..."
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({kinds.get(type(value), 'a ' + type(value).__name__)})"


def _closest(word: str, known: Iterable[str]) -> str:
    match = difflib.get_close_matches(word, list(known), 1)
    return f" (did you mean '{match[0]}'?)" if match else ""


def _validated(where: str, build: Callable[[], T]) -> T:
    """What `build` returns; an error of validation gets the file in front."""
    try:
        return build()
    except (StructureError, SceneError) as error:
        raise type(error)(f"{where}: {error}") from error


def _find(name_or_path: str | os.PathLike[str]) -> tuple[str, str, Path]:
    """The text, what to call it, and the folder it stands in."""
    given = os.fspath(name_or_path)
    if isinstance(name_or_path, str) and not given.endswith(".toml") and not set(given) & {"/", os.sep}:
        if given not in scene_names():
            raise FormatError(
                f"unknown scene '{given}'{_closest(given, scene_names())}; known: {', '.join(scene_names())}; "
                "the path of a .toml file works too"
            )
        path = Path(str(importlib.resources.files("tensegrity_mj.models").joinpath(given, "scene.toml")))
    else:
        path = Path(given)
    return _read(path), str(path), path.parent


def _read(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise FormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not a text in UTF-8 ({error.reason} at byte {error.start})") from error


# Writing -------------------------------------------------------------------------------------------------


def _structure_lines(structure: Structure, file_name: str) -> list[str]:
    lines = ["[structure]"]
    if structure.name != file_name:
        lines.append(_entry("name", structure.name))
    if structure.string_law is not StringLaw.CLIPPED:
        lines.append(_entry("string_law", structure.string_law.value))
    lines += [f"nodes.{_key(name)} = {_value(position)}" for name, position in structure.nodes.items()]
    if structure.fixed_nodes:
        lines.append(_entry("fixed_nodes", structure.fixed_nodes))
    lines += _array("rods", [_rod_table(rod) for rod in structure.rods])
    lines += _array("strings", [_string_table(string) for string in structure.strings])
    return lines + _array("point_masses", [_given(vars(point)) for point in structure.point_masses])


def _string_table(string: String) -> dict[str, Any]:
    table = _given(vars(string))
    return table if string.damping else {key: value for key, value in table.items() if key != "damping"}


def _rod_table(rod: Rod) -> dict[str, Any]:
    table = {"name": rod.name, "nodes": rod.nodes, "mass": rod.mass, "radius": rod.radius}
    support = rod.support
    if support == Support.free():
        return table
    pinned = support.directions == PINNED and support.values is None
    details: dict[str, Any] = {
        "kind": "free" if not support.directions else "pinned" if pinned else "constrained",
        "sigma": support.sigma,
    }
    if details["kind"] == "constrained":
        details |= {"D": support.directions, "values": support.values}
    return table | {"support": _given(details | {"plane": support.plane})}


def _scene_lines(scene: Scene) -> list[str]:
    structure = scene.structure
    lines = ["[scene]"]
    if scene.gravity != Scene.gravity:
        lines.append(_entry("gravity", scene.gravity))
    lines.append(_entry("duration", scene.duration))
    assert not callable(scene.loads)
    lines += _array("loads", [vars(load) for load in scene.loads])
    lines += _array("breaks", [vars(event) for event in scene.breaks])
    lines += _array("motions", [_motion_table(motion) for motion in scene.motions])
    if scene.contact is not None:
        given = {key: value for key, value in vars(scene.contact).items() if value != getattr(Contact, key)}
        lines.append(_entry("contact", given))
    if scene.resistance is not None:
        parts = {key: value for key, value in vars(scene.resistance).items() if value != getattr(Resistance, key)}
        given = {key: _given(vars(value)) if key in ("bending", "drag") else value for key, value in parts.items()}
        lines.append(_entry("resistance", given))
    if scene.initial_nodes is not None:
        lines += _section("scene.initial_nodes", _node_lines(structure, scene.initial_nodes, structure.positions))
    if scene.initial_velocities is not None:
        still = np.zeros_like(structure.positions)
        lines += _section("scene.initial_velocities", _node_lines(structure, scene.initial_velocities, still))
    if scene.target is not None:
        lines += _target_lines(structure, scene.target)
    if scene.control is not None:
        options = dict(scene.control.options)
        lines += _section("scene.control", [_entry("law", scene.control.law), _entry("options", options)])
    return lines


def _motion_table(motion: Motion) -> dict[str, Any]:
    table: dict[str, Any] = {"support": motion.support}
    if motion.harmonics:
        table["harmonics"] = [vars(item) for item in motion.harmonics]
    return table | {key: values for key in MOTION_DATA if (values := getattr(motion, key))}


def _target_lines(structure: Structure, target: Target) -> list[str]:
    curve, still = target.along, structure.positions
    if curve is not None:
        entries = {"times": target.times, "values": curve.values}
        entries |= {key: values for key in ("rates", "accelerations") if any(values := getattr(curve, key))}
        lines = _section("scene.target", [_entry(key, values) for key, values in entries.items()])
        return lines + _node_table_lines("scene.target.shapes", "parameter", curve.parameters, curve.shapes, structure)
    if target.times == (0.0,):
        return _section("scene.target.nodes", _node_lines(structure, target.nodes[0], still))
    return _node_table_lines("scene.target.waypoints", "time", target.times, target.nodes, structure)


def _node_table_lines(
    key: str, title: str, numbers: Iterable[float], positions: Array, structure: Structure
) -> list[str]:
    lines = []
    for number, nodes in zip(numbers, positions, strict=True):
        rows = _node_lines(structure, nodes, structure.positions)
        lines += ["", f"[[{key}]]", _entry(title, number), *(f"nodes.{row}" for row in rows)]
    return lines


def _node_lines(structure: Structure, nodes: Array, base: Array) -> list[str]:
    """A line for each node whose row is not bit by bit that of `base`."""
    rows = zip(structure.node_names, nodes, base, strict=True)
    return [_entry(name, row.tolist()) for name, row, other in rows if row.tobytes() != other.tobytes()]


def _section(title: str, lines: list[str]) -> list[str]:
    return ["", f"[{title}]", *lines]


def _array(key: str, tables: Sequence[Mapping[str, Any]]) -> list[str]:
    return [f"{key} = [", *(f"    {_value(table)}," for table in tables), "]"] if tables else []


def _entry(key: str, value: Any) -> str:
    return f"{_key(key)} = {_value(value)}"


def _key(key: str) -> str:
    return tomli_w.dumps({key: 0}).removesuffix(" = 0\n")


def _value(value: Any) -> str:
    """A value on one line. tomli_w breaks every list into lines, so that only what is no list is left to it."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_entry(key, item) for key, item in value.items()) + " }" if value else "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").removesuffix("\n")


def _given(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value is not None}


def _write(path: str | os.PathLike[str], text: str) -> Path:
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)
