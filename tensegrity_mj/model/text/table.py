"""A table of a file, which reads its keys with their types, or reports errors."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import closest
from tensegrity_mj.basics.toml_values import is_list, is_number, is_text
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.ropes import moved_ropes
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import names_of


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
