"""Conversion of tables of a file to value classes and back, by the fields of the class (`basics.fields`).

A class whose table has other keys than its fields has functions of its own in `READERS` and `WRITERS`. A class that is
no value class stands for all registered for it (`basics.fields.register`): the key `kind` of a table says which.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import attrs

from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import Key, item_of, kind_of, registered, without_item
from tensegrity_mj.errors import FormatError, SceneError, StructureError
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
        value: T = READERS[cls](table)
        return value
    if not dataclasses.is_dataclass(cls):
        known = registered(cls)
        if not known:
            raise FormatError(
                f"{table.where}: no kind of {cls.__name__.lower()} is registered here: install the package that has it,"
                " or import the module that registers it before the file is read"
            )
        return read_fields(known[table.choice("kind", known)], table, ("kind",))
    return read_fields(cls, table)


def read_fields(cls: type[T], table: Table, more: Sequence[str] = ()) -> T:
    """The value of a table whose keys are the fields of its class, and more."""
    keys = item_of(cls).keys
    table.allow([*more, *keys])
    needed = [key for key, one in keys.items() if key in table.data or one.default is attrs.NOTHING]
    values = {keys[key].name: read_key(keys[key], table, key) for key in needed}

    bare = not attrs.has(cls)  # a dataclass takes what it is given

    def make() -> T:
        if bare:
            return cls(**{name: checked(name, value, keys[name].kind, SceneError) for name, value in values.items()})
        return cls(**values)

    return built(table, cls, make, values)


def read_key(one: Key, table: Table, key: str) -> Any:
    """Read the value of a field from a key of a table."""
    kind = one.kind
    if kind.part is None or key not in table.data:
        return kind.load(table.get(key, kind.need, kind.fits))
    if kind.many:
        title = item_of(kind.part).title if dataclasses.is_dataclass(kind.part) else "kind"
        return [read(kind.part, item) for item in table.tables(key, None, title)]
    return read(kind.part, table.inside(key))


def built(table: Table, cls: type, make: Callable[[], T], values: Mapping[str, Any] | None = None) -> T:
    """Return `make()`; errors of its class, which has these values, name the table in place of them."""
    try:
        return make()
    except (StructureError, SceneError, FormatError) as error:
        # The file is put in front of all that is wrong with a structure or a scene.
        place = table.where if isinstance(error, FormatError) else table.path
        raise type(error)(f"{place}: {without_item(cls, values or {}, error)}") from None


def table_of(value: Any) -> dict[str, Any]:
    """The table of a value."""
    return WRITERS.get(type(value), fields_of)(value)


def check_kinds(key: str, one: Key, values: Iterable[Any]) -> None:
    """Raise SceneError where a field holds values of classes that files know by names, and one has none."""
    for number, value in enumerate(() if dataclasses.is_dataclass(one.kind.part) else values):
        cls = type(value)
        if not kind_of(cls):
            raise SceneError(
                f"{key}[{number}] is a {cls.__name__}, which files know by no name: give it one with "
                f"register(name, {cls.__name__})"
            )


def fields_of(value: Any) -> dict[str, Any]:
    """Return, by key, the fields of a value that are not None and, unless its class is written whole, not defaults.

    Its class's name comes first, where it is registered.
    """
    of, kind = item_of(type(value)), kind_of(type(value))
    found: dict[str, Any] = {"kind": kind} if kind else {}
    for key, one in of.keys.items():
        held = getattr(value, one.name)
        if held is not None and (of.whole or held != one.default):
            found[key] = held
    return found
