"""Writes structures and scenes, without loss."""

from __future__ import annotations

import dataclasses
import enum
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.kinds import part
from tensegrity_mj.errors import FormatError, SceneError
from tensegrity_mj.model.members import StringLaw
from tensegrity_mj.model.ropes import moved_ropes
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.model.text.codec import check_kinds, table_of
from tensegrity_mj.model.text.keys import FORMAT, MEMBER_KEYS, MOST_BYTES, SCENE_LINES

HEADING = "# tensegrity-mj; SI units, world frame with z up. Every key: docs/format.md"


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> Path:
    """Write a scene, atomically (a crash leaves the old file or none); returns the path.

    Raises:
        SceneError: if it is no Scene, or its loads or a motion are a Python function, which no file can hold.
        FormatError: if the file cannot be written, or would be too large to be read back.
    """
    return _write(
        path, scene_to_toml(checked("scene", scene, part(Scene, "a Scene, or load_scene(name or path)"), SceneError))
    )


def save_structure(structure: Structure, path: str | os.PathLike[str]) -> Path:
    """Write a structure, atomically; returns the path.

    Raises:
        SceneError: if it is no Structure.
        FormatError: if the file cannot be written, or would be too large to be read back.
    """
    whole = checked("structure", structure, part(Structure, "a Structure"), SceneError)
    return _write(path, structure_to_toml(whole))


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


def _structure_lines(structure: Structure, file_name: str) -> list[str]:
    lines = ["[structure]"]
    if structure.name != file_name:
        lines.append(_entry("name", structure.name))
    if structure.string_law is not StringLaw.CLIPPED:
        lines.append(_entry("string_law", structure.string_law.value))
    lines += [f"nodes.{_key(name)} = {_value(position)}" for name, position in structure.given.nodes.items()]
    if structure.fixed_nodes:
        lines.append(_entry("fixed_nodes", structure.fixed_nodes))
    for key in MEMBER_KEYS:
        lines += _array(key, getattr(structure.given, key, getattr(structure, key)))
    return lines


def _scene_lines(scene: Scene) -> list[str]:
    structure, keys = scene.structure, item_of(Scene).keys
    lines = ["[scene]"]
    for key in SCENE_LINES:
        held = getattr(scene, key)
        if keys[key].kind.many:
            check_kinds(key, keys[key], held)
            lines += _array(key, held)
        elif key == "duration" or (held is not None and held != keys[key].default):
            lines.append(_entry(key, held))
    if scene.water is not None:
        lines += _section("scene.water", _lines(scene.water))
    if scene.initial_nodes is not None:
        lines += _section("scene.initial_nodes", _node_lines(structure, scene.initial_nodes, structure.positions))
    if scene.initial_velocities is not None:
        still = np.zeros_like(structure.positions)
        lines += _section("scene.initial_velocities", _node_lines(structure, scene.initial_velocities, still))
    if scene.target is not None:
        lines += _target_lines(structure.massless, scene.target)
    if scene.control is not None:
        lines += _section("scene.control", _lines(scene.control))
    return lines


def _lines(value: Any) -> list[str]:
    """A line for each field of a value, and then those that are arrays of tables."""
    table = table_of(value)
    arrays = [key for key, one in item_of(type(value)).keys.items() if one.kind.many and key in table]
    lines = [_entry(key, held) for key, held in table.items() if key not in arrays]
    return lines + [line for key in arrays for line in _array(key, table[key])]


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
    """A line for each node whose row is not bit by bit that of `base`, for a rope's when its ends are as in `nodes`."""
    rows = zip(structure.node_names, nodes, moved_ropes(structure, nodes, base), strict=True)
    return [_entry(name, row.tolist()) for name, row, other in rows if row.tobytes() != other.tobytes()]


def _section(title: str, lines: list[str]) -> list[str]:
    return ["", f"[{title}]", *lines]


def _array(key: str, tables: Sequence[Any]) -> list[str]:
    return [f"{key} = [", *(f"    {_value(table)}," for table in tables), "]"] if tables else []


def _entry(key: str, value: Any) -> str:
    return f"{_key(key)} = {_value(value)}"


def _key(key: str) -> str:
    return tomli_w.dumps({key: 0}).removesuffix(" = 0\n")


def _value(value: Any) -> str:
    """A value on one line. tomli_w breaks every list into lines, so that only what is no list is left to it."""
    if dataclasses.is_dataclass(value):
        value = table_of(value)
    elif isinstance(value, enum.Enum):
        value = value.value
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_entry(key, item) for key, item in value.items()) + " }" if value else "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").removesuffix("\n")


def _write(path: str | os.PathLike[str], text: str) -> Path:
    size = len(text.encode())
    if size > MOST_BYTES:
        raise FormatError(
            f"{path}: the text has {size / 1e6:.3g} MB, and files of more than {MOST_BYTES / 1e6:g} MB are not "
            "read back: save a smaller structure"
        )
    return write_text(path, text)
