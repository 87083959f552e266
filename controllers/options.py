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
    if isinstance(value, Mapping) and not set(value) <= {"X", "Y", "Z"}:
        return {name: _gains(entry, f"{what}.{name}") for name, entry in value.items()}
    return _gains(value, what, ", or one by rod name")


def _gains(value: Any, what: str, more: str = "") -> Gains:
    if isinstance(value, Mapping) and set(value) <= {"X", "Y", "Z"}:
        return Gains(**value)
    if not isinstance(value, Gains):
        raise OptionError(f"{what} = {value!r}; it must be a table with X, Y, Z{more}")
    return value


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
