"""Plain values: what points, outcomes and files of a study hold, in one form, independent of their origin."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tensegrity_mj.basics.jsontext import from_exact_json, to_exact_json
from tensegrity_mj.basics.texts import shortened
from tensegrity_mj.errors import OptionError


def plain(value: Any, what: str) -> Any:
    """The value as JSON gives it back: dicts with text keys, lists, texts, numbers, truth values, None.

    Tuples become lists, numpy's numbers and arrays plain ones; NaN and infinity are kept.

    Raises:
        OptionError: naming the part that is nothing of the kind.
    """
    _check(value, what)
    return from_exact_json(to_exact_json(value))


def _check(value: Any, what: str) -> None:
    if value is None or isinstance(value, (bool, int, float, str, np.bool_, np.integer, np.floating)):
        return
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return
    if isinstance(value, Mapping):
        for key, item in value.items():
            if not isinstance(key, str):
                raise OptionError(f"{what}: key {key!r} must be a text")
            _check(item, f"{what}[{key!r}]")
    elif isinstance(value, (list, tuple)):
        for number, item in enumerate(value):
            _check(item, f"{what}[{number}]")
    else:
        raise OptionError(
            # No repr of it: that may hold an address, and results are to be the same each time.
            f"{what} is of type {type(value).__name__}; it must be a plain value: a number, a text, a truth value, "
            "None, or lists and dicts of them"
        )


def value_at(values: Any, keys: Sequence[str]) -> Any:
    """Return the value at the end of these keys among nested values; None where one of the keys is missing."""
    for key in keys:
        values = None if values is None else values.get(key)
    return values


def canonical(value: Any) -> str:
    """Return the same JSON text for equal plain values, in any order of their keys."""
    return json.dumps(json.loads(to_exact_json(value)), sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(value: Any) -> str:
    """SHA-256 of the canonical text, in hexadecimal."""
    return hashlib.sha256(canonical(value).encode("ascii")).hexdigest()


def difference(ours: Any, theirs: Any, where: str = "") -> str | None:
    """Return where and how two plain values first differ; None if they are equal."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        for key in [*ours, *(key for key in theirs if key not in ours)]:
            place = f"{where}.{key}" if where else key
            if key not in ours or key not in theirs:
                return f"{place} is given {'there only' if key in theirs else 'here only'}"
            if found := difference(ours[key], theirs[key], place):
                return found
        return None
    if isinstance(ours, list) and isinstance(theirs, list):
        for number, (a, b) in enumerate(zip(ours, theirs, strict=False)):
            if found := difference(a, b, f"{where}[{number}]"):
                return found
        return None if len(ours) == len(theirs) else f"{where} has {len(theirs)} entries there and {len(ours)} here"
    if canonical(ours) == canonical(theirs):
        return None
    if isinstance(ours, str) and isinstance(theirs, str) and "\n" in ours + theirs:
        return difference(ours.splitlines(), theirs.splitlines(), f"{where}, lines") or f"{where} has other line ends"
    there, here = (shortened(to_exact_json(value), 80) for value in (theirs, ours))
    return f"{where} is {there} there and {here} here"
