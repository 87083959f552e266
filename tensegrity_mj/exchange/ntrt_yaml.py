"""YAML files of NTRT as tables: texts, lists and tables only, no references, no key twice."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.dependencies import of_extra, optional
from tensegrity_mj.basics.files import content_of
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.text.codec import Table, shown

yaml = optional("yaml", "a model of NTRT", of_extra("ntrt"))

MOST_BYTES = 300_000  # of a file: NTRT's largest has 10 kB, and PyYAML reads this many in some seconds


class _Loader(yaml.BaseLoader):  # type: ignore[misc,name-defined]
    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem="a reference (*name), which NTRT's files have not")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        found: dict[str, Any] = {}
        for key, value in node.value:
            if str(key.value) in found:
                raise yaml.MarkedYAMLError(
                    problem=f"'{key.value}' stands twice in a table", problem_mark=key.start_mark
                )
            found[str(key.value)] = self.construct_object(value, deep=True)
        return found


class Words(Table):
    """A table all of whose values are words: numbers are made of them where they are read."""

    def _inside(self, name: str, data: Any, keys: Any) -> Words:
        return Words(data, self.file, f"{self.path}.{name}" if self.path else name, keys)

    def child(self, key: str) -> Words:
        """The table of a key, empty where it is missing."""
        return self._inside(key, self.data.get(key) or {}, None)

    def number(self, key: str, default: Any = ...) -> Any:
        self.data[key] = _number(self.data.get(key))
        return super().number(key, default)

    def position(self, key: str) -> Array:
        """Three numbers (3,)."""
        value = self.data.get(key)
        self.data[key] = [_number(one) for one in value] if isinstance(value, list) else value
        return np.array(self.vector(key))

    def pairs(self, key: str) -> Iterator[tuple[str, str]]:
        """The pairs of words of a list."""
        rows = self.get(key, "a list of pairs of names", lambda rows: isinstance(rows, list))
        for row in rows:
            if not (isinstance(row, list) and len(row) == 2 and all(isinstance(one, str) and one for one in row)):
                raise FormatError(f"{self.where}: {key}: {shown(row)}; it must be two names, as [first, second]")
            yield row[0], row[1]


def yaml_file(path: Path) -> Words:
    """The table of a file.

    Raises:
        FormatError: if it is no such file, too large, or not valid YAML.
    """
    content = content_of(path, MOST_BYTES)
    try:
        return Words(yaml.load(content, _Loader), str(path), "", None)
    except (yaml.YAMLError, ValueError) as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None) or error
        raise FormatError(f"{path}: not valid YAML{f', line {mark.line + 1}' if mark else ''}: {problem}") from None
    except RecursionError:
        raise FormatError(f"{path}: not valid YAML: values stand too deep in each other") from None


def _number(word: Any) -> Any:
    try:
        return float(word) if isinstance(word, str) and math.isfinite(float(word)) else word
    except ValueError:
        return word
