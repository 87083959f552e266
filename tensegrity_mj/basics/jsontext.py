"""Strict JSON of the values in this package's results."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
from collections.abc import Callable, Mapping
from typing import Any

NOT_FINITE = "$float"


def plain(value: Any) -> Any:
    """Lists of arrays, tuples and sets, the values of enums, dictionaries of results; all numbers as they are."""
    return _plain(value, lambda number: number)


def plain_values(result: Any, *names: str) -> dict[str, Any]:
    """Attributes of a result by their names, as plain values."""
    return {name: plain(getattr(result, name)) for name in names}


def to_json(data: Any, indent: int | None = None) -> str:
    """Strict JSON text: NaN and infinity become null, enums their value, arrays lists, paths and the like text."""
    return _text(_plain(data, lambda value: None), indent)


def to_exact_json(data: Any, indent: int | None = None) -> str:
    """Write JSON with NaN and infinity as objects such as {"$float": "nan"}, which `from_exact_json` reads."""
    return _text(_plain(data, lambda value: {NOT_FINITE: repr(value)}), indent)


def from_exact_json(text: str) -> Any:
    """Read what `to_exact_json` wrote.

    Raises:
        ValueError: if the text is no JSON.
    """
    return json.loads(text, object_hook=lambda item: float(item[NOT_FINITE]) if item.keys() == {NOT_FINITE} else item)


def _text(plain: Any, indent: int | None = None) -> str:
    return json.dumps(plain, ensure_ascii=False, allow_nan=False, indent=indent)


def _plain(value: Any, not_finite: Callable[[float], Any]) -> Any:
    if isinstance(value, enum.Enum):
        return _plain(value.value, not_finite)
    if isinstance(value, Mapping):
        return {str(_plain(key, not_finite)): _plain(item, not_finite) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_plain(item, not_finite) for item in value]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if hasattr(value, "to_dict"):
        return _plain(value.to_dict(), not_finite)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: _plain(getattr(value, name), not_finite) for name in names}
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return _plain(value.tolist(), not_finite)
    if isinstance(value, float):
        return value if math.isfinite(value) else not_finite(value)
    return str(value)
