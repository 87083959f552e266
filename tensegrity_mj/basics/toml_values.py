"""Kinds of values that TOML gives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def is_text(value: Any) -> bool:
    return isinstance(value, str)


def is_table(value: Any) -> bool:
    return isinstance(value, dict)


def is_number(value: Any) -> bool:
    """Return whether a value from TOML is a number that a float can hold."""
    return isinstance(value, float) or (type(value) is int and abs(value) < 10**308)  # larger ones overflow


def is_list(value: Any, valid: Callable[[Any], bool]) -> bool:
    """Return whether a value is a list of valid items."""
    return isinstance(value, list) and all(valid(item) for item in value)


def is_row(value: Any, width: int = 3) -> bool:
    """Return whether a value is a list of `width` numbers."""
    return is_list(value, is_number) and len(value) == width
