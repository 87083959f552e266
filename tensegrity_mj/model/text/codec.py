"""Value classes out of tables of a file and into them, each by its fields (`basics.fields`), and each way once.

A class whose table is not what its fields are has functions of its own in `READERS` and `WRITERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import attrs

from tensegrity_mj.basics.fields import item_of, without_item
from tensegrity_mj.errors import SceneError, StructureError
from tensegrity_mj.model.text.table import Table

T = TypeVar("T")

READERS: dict[type, Callable[[Table], Any]] = {}
WRITERS: dict[type, Callable[[Any], dict[str, Any]]] = {}


def read(cls: type[T], table: Table) -> T:
    """The value of a table.

    Raises:
        FormatError: for a key that its class does not have, one that is missing, or what is of another type.
        StructureError, SceneError: for what its class refuses, with the place in front.
    """
    if cls in READERS:
        return READERS[cls](table)
    keys = item_of(cls).keys
    table.allow(list(keys))
    needed = [key for key, one in keys.items() if key in table.data or one.default is attrs.NOTHING]
    return made(cls, table, {keys[key].name: read_key(keys[key], table, key) for key in needed})


def read_key(one: attrs.Attribute[Any], table: Table, key: str) -> Any:
    """What a key of a table holds for a field."""
    kind = one.metadata["kind"]
    if kind.part is None or key not in table.data:
        return kind.load(table.get(key, kind.need, kind.fits))
    if kind.many:
        return [read(kind.part, item) for item in table.tables(key, None, item_of(kind.part).title)]
    inside = table.table(key, None)
    assert inside is not None
    return read(kind.part, inside)


def made(cls: type[T], table: Table, values: dict[str, Any]) -> T:
    """A value of these fields."""
    try:
        return cls(**values)
    except (StructureError, SceneError) as error:
        raise type(error)(f"{table.path}: {without_item(cls, values, error)}") from None


def table_of(value: Any) -> dict[str, Any]:
    """The table of a value: what is not None and, unless its class is written whole, not at its default."""
    cls = type(value)
    if cls in WRITERS:
        return WRITERS[cls](value)
    of, found = item_of(cls), {}
    for key, one in of.keys.items():
        held = getattr(value, one.name)
        if held is not None and (of.whole or held != one.default):
            found[key] = held
    return found
