"""Options of laws as scene files hold them: each reader makes the law's value of a file's, or says what is allowed.

A reader is called with the value and with what it is, for messages.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from typing import Any

from tensegrity_mj.basics.checks import choice_from
from tensegrity_mj.controllers.gains import Gains
from tensegrity_mj.controllers.known import KnownWater
from tensegrity_mj.controllers.table import Reader
from tensegrity_mj.errors import OptionError


def as_it_is(value: Any, what: str) -> Any:
    """The value itself: the law's class checks it."""
    return value


def norm(value: Any, what: str) -> Any:
    """A norm of u, 1, 2 or "inf"."""
    return math.inf if value == "inf" else value


def gains(value: Any, what: str) -> Gains | dict[str, Gains]:
    """Gains of all rods, or by the rod's name."""
    if isinstance(value, Gains):
        return value
    if not isinstance(value, Mapping):
        raise OptionError(f"{what} = {value!r}; it must be a table with X, Y, Z, or one by rod name")
    if set(value) <= {"X", "Y", "Z"}:
        return Gains(**value)
    by_rod: dict[str, Gains] = {}
    for name, entry in value.items():
        if isinstance(entry, Gains):
            by_rod[name] = entry
        elif isinstance(entry, Mapping) and set(entry) <= {"X", "Y", "Z"}:
            by_rod[name] = Gains(**entry)
        else:
            raise OptionError(f"{what}.{name} = {entry!r}; it must be a table with X, Y, Z")
    return by_rod


def one_of(kind: type[enum.Enum]) -> Reader:
    """A reader of a member of an enum, by its value."""

    def read(value: Any, what: str) -> Any:
        return value if isinstance(value, kind) else choice_from(what, kind, value)

    return read


# Of the laws of chapters 5 and 6.
OF_QUADRATIC_LAWS: Mapping[str, Reader] = {
    "decay_rate": as_it_is,
    "norm": norm,
    "translation": gains,
    "rotation": gains,
    "minimum_force_density": as_it_is,
    "maximum_force_density": as_it_is,
    "respect_limits": as_it_is,
    "water": one_of(KnownWater),
}
