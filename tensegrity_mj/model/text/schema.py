"""The JSON Schema of the format, by which editors complete and check files, made of the value classes and their kinds.

It is in the words of draft 4, the latest that the TOML editors of VS Code and others (Taplo) know. What hangs on more
than one key is left to the reader: which of two a table has, and what a member has by default or of its group.
"""

from __future__ import annotations

import enum
import inspect
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any

from attrs import NOTHING

from tensegrity_mj.basics.fields import Key, item_of, kind_of, registered
from tensegrity_mj.basics.kinds import NUMBER, TEXT, list_schema, positive, vector
from tensegrity_mj.model import ground, section
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.scene import Scene, Whole
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.model.text import keys as known
from tensegrity_mj.model.text.reading import SHARED, SHARING

BY_NUMBER = {"waypoints": known.WAYPOINT_KEYS, "shapes": known.SHAPE_KEYS}
NODES = {"type": "object", "additionalProperties": dict(vector("m").schema), "description": "node = [x, y, z]"}


def format_schema() -> dict[str, Any]:
    """The JSON Schema (draft 4) of structure and scene files, as plain data."""
    parts: dict[str, Any] = {}
    structure = _keys(Structure, parts) | {"nodes": NODES}
    shared = {kind: _keys(cls, parts, SHARED[kind]) for kind, cls in SHARING.items()}
    structure["defaults"] = _table({kind: _table(keys) for kind, keys in shared.items()})
    structure["groups"] = {"type": "object", "additionalProperties": _table(shared["rods"] | shared["strings"])}
    scene = _keys(Scene, parts, [key for key in known.SCENE_KEYS if not key.startswith("initial_")])
    scene |= {"initial_nodes": NODES, "initial_velocities": NODES, "whole": _part(Whole, parts)}
    scene["ground"] = _table({"file": TEXT} | _keys(ground.Ground, parts, known.GROUND_KEYS), ["file"])
    file = {
        "format": {"enum": [known.FORMAT]},
        "name": TEXT,
        "source": TEXT,
        "structure": {"anyOf": [_table(structure, ["nodes"]), TEXT]},
        "scene": _table(scene),
    }
    head = {"$schema": "http://json-schema.org/draft-04/schema#", "title": "A structure or scene of tensegrity_mj"}
    return head | _table(file, ["format", "name", "structure"]) | {"definitions": parts}


def _table(keys: Mapping[str, Any], needed: Sequence[str] = ()) -> dict[str, Any]:
    """Schema of a table that has these keys and no others."""
    found = {"type": "object", "properties": dict(keys), "additionalProperties": False}
    return found | ({"required": list(needed)} if needed else {})


def _keys(cls: type, parts: dict[str, Any], only: Collection[str] | None = None) -> dict[str, Any]:
    """Schemas of the keys of a class, or of `only` some, with their descriptions from its docstring."""
    notes = re.findall(r"^    ([\w, ]+): (.+(?:\n {8}.+)*)", inspect.getdoc(cls) or "", re.MULTILINE)
    about = {name: " ".join(text.split()) for names, text in notes for name in names.split(", ")}
    keys = {key: one for key, one in item_of(cls).keys.items() if only is None or key in only}
    return {key: _key(one, about.get(one.name, ""), parts) for key, one in keys.items()}


def _key(one: Key, about: str, parts: dict[str, Any]) -> dict[str, Any]:
    if one.kind.part is not None:
        inner = _part(one.kind.part, parts)
        return list_schema(inner) if one.kind.many else inner
    default = None if one.default is NOTHING else one.default
    default = default.value if isinstance(default, enum.Enum) else default
    found = {**one.kind.schema, **({"description": about} if about else {})}
    return found | ({"default": default} if isinstance(default, (bool, int, float, str)) else {})


def _part(cls: type, parts: dict[str, Any]) -> dict[str, Any]:
    """A reference to the table of a class, which stands among the parts."""
    if cls is Element:
        parts["Element"] = {"type": "object", "properties": {"kind": TEXT}, "required": ["kind"]}  # the rest is its own
    elif not is_dataclass(cls):
        parts[cls.__name__] = {"anyOf": [_part(one, parts) for one in registered(cls).values()]}
    elif cls is Target:
        tables = {key: {one: NODES if one == "nodes" else NUMBER for one in keys} for key, keys in BY_NUMBER.items()}
        target = {key: list_schema(_table(keys, list(keys)[:1])) for key, keys in tables.items()}
        parts["Target"] = _table(dict.fromkeys(known.TARGET_KEYS, list_schema(NUMBER)) | target | {"nodes": NODES})
    elif cls.__name__ not in parts:
        keys = _keys(cls, parts)
        maybe = next((SHARED[kind] for kind, one in SHARING.items() if one is cls), [])
        needed = [key for key, one in item_of(cls).keys.items() if one.default is NOTHING and key not in maybe]
        kinds = list(known.SUPPORT_KEYS) if cls is Support else [kind_of(cls)]
        if any(kinds):
            keys, needed = {"kind": {"enum": kinds}} | keys, ["kind", *needed]
        if cls is section.Section:
            keys, needed = {key: dict(positive().schema) for key in known.TUBE_KEYS} | keys, ["elasticity_modulus"]
        parts[cls.__name__] = _table(keys, needed)
    return {"$ref": f"#/definitions/{cls.__name__}"}
