"""Tables of a file, and their conversion to value classes and back, by the fields of the class (`basics.fields`).

A class whose table has other keys than its fields has functions of its own in `READERS` and `WRITERS`. A class that is
no value class stands for all registered for it (`basics.fields.register`): the key `kind` of a table says which.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import attrs
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import Key, item_of, kind_of, registered, without_item
from tensegrity_mj.basics.texts import closest
from tensegrity_mj.basics.toml_values import is_list, is_number, is_text
from tensegrity_mj.errors import FormatError, SceneError, StructureError
from tensegrity_mj.model.ropes import moved_ropes
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import names_of

T = TypeVar("T")

READERS: dict[type, Callable[[Table], Any]] = {}
WRITERS: dict[type, Callable[[Any], dict[str, Any]]] = {}


class Table:
    """A TOML table that knows its place and reads its keys with their types, or reports errors."""

    def __init__(self, data: Any, file: str, path: str, keys: Sequence[str] | None) -> None:
        self.file, self.path = file, path
        self.where = f"{file}: {path}" if path else file
        if not isinstance(data, dict):
            raise FormatError(f"{self.where} = {shown(data)}; it must be a table")
        self.data: dict[str, Any] = data
        if keys is not None:
            self.allow(keys)

    def allow(self, keys: Sequence[str]) -> None:
        for key in self.data:
            if key not in keys:
                raise FormatError(f"{self.where}: unknown key '{key}'{closest(key, keys)}; allowed: {', '.join(keys)}")

    def fail(self, key: str, need: str) -> FormatError:
        if key not in self.data:
            return FormatError(f"{self.where}: '{key}' is missing; it must be {need}")
        return FormatError(f"{self.where}: {key} = {shown(self.data[key])}; it must be {need}")

    def get(self, key: str, need: str, valid: Callable[[Any], bool], default: Any = ...) -> Any:
        """The value of a key, or the default (... for none: the key must be there)."""
        if key not in self.data and default is not ...:
            return default
        if key not in self.data or not valid(self.data[key]):
            raise self.fail(key, need)
        return self.data[key]

    def text(self, key: str, default: Any = ...) -> str:
        value: str = self.get(key, "a text in quotes", is_text, default)
        return value

    def choice(self, key: str, allowed: Collection[str], default: Any = ...) -> str:
        given = self.data.get(key)
        meant = closest(given, allowed) if isinstance(given, str) else ""
        need = " or ".join(f'"{item}"' for item in allowed) + meant
        value: str = self.get(key, need, lambda x: is_text(x) and x in allowed, default)
        return value

    def number(self, key: str, default: Any = ...) -> Any:
        value = self.get(key, "a number", is_number, default)
        return float(value) if key in self.data else value

    def numbers(self, key: str, need: str, size: int | None = None, default: Any = ...) -> Any:
        value = self.get(key, need, lambda x: is_list(x, is_number) and size in (None, len(x)), default)
        return tuple(float(x) for x in value) if key in self.data else value

    def vector(self, key: str, default: Any = ...) -> Any:
        return self.numbers(key, "three numbers [x, y, z]", 3, default)

    def inside(self, key: str, keys: Sequence[str] | None = None, need: str = "a table") -> Table:
        """A table inside, with these keys at most; None: any."""
        if key not in self.data:
            raise self.fail(key, need)
        return self._inside(key, self.data[key], keys)

    def tables(self, key: str, keys: Sequence[str] | None, title: str = "name") -> list[Table]:
        """An array of tables inside, empty if absent; messages call each by its number and `title`."""
        place = f"{self.path}.{key}" if self.path else key
        need = f"an array of tables, each under [[{place}]]"
        found = self.get(key, need, lambda x: is_list(x, lambda item: isinstance(item, dict)), [])
        names = (f" '{item[title]}'" if isinstance(item.get(title), str) else "" for item in found)
        rows = enumerate(zip(found, names, strict=True))
        return [self._inside(f"{key}[{number}]{name}", item, keys) for number, (item, name) in rows]

    def _inside(self, name: str, data: Any, keys: Sequence[str] | None) -> Table:
        return Table(data, self.file, f"{self.path}.{name}" if self.path else name, keys)

    def node_rows(self, structure: Structure, base: Array) -> Array:
        """Read this table as node name = [x, y, z]; nodes that it leaves out have their rows of `base` (N, 3).

        Those of ropes are left out together with their ends, or move with them.
        """
        rows = np.array(base)
        for name in self.data:
            if name not in structure.node_index:
                known = structure.node_names
                raise FormatError(
                    f"{self.where}: unknown node '{name}'{closest(name, known)}; the nodes are {names_of(known)}"
                )
            rows[structure.node_index[name]] = self.vector(name)
        carried = moved_ropes(structure, rows, base)
        left_out = [row for name, row in structure.node_index.items() if name not in self.data]
        rows[left_out] = carried[left_out]
        return rows


def shown(value: Any) -> str:
    """Format a value as text, with its type, shortened where it is long."""
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
