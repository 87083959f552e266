"""The kinds of values that type hints stand for, for classes and functions that name no kinds of their own."""

from __future__ import annotations

import enum
from typing import Any, get_args, get_origin

from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.kinds import (
    Kind,
    Wrong,
    choice,
    finite,
    flag,
    many,
    or_none,
    part,
    parts,
    rows,
    text,
    vector,
    whole,
)
from tensegrity_mj.errors import OptionError, TensegrityError

PLAIN_TYPES: dict[Any, Kind] = {
    float: finite(),
    int: whole(-(2**63), 2**63 - 1),
    bool: flag(),
    str: text(),
    tuple[float, float, float]: vector(""),
    tuple[float, ...]: rows(),
    tuple[str, ...]: many(text(), "a list of texts in quotes"),
    tuple[tuple[float, float, float], ...]: rows(3),
}


def fitted(what: str, value: Any, hint: Any, error: type[TensegrityError] = OptionError) -> Any:
    """The value of an argument as its type hint has it; as it is, where that is none, or of what no file can hold.

    Raises:
        TensegrityError: of that class, for a value of another type.
    """
    try:
        kind = typed(hint)
    except Wrong:
        return value
    return checked(what, value, kind, error)


def typed(hint: Any) -> Kind:
    """The kind of values of a type, as a type hint has it: what is not of it is refused, and no more."""
    inner = get_args(hint)
    if type(None) in inner and len(inner) == 2:
        return or_none(typed(next(one for one in inner if one is not type(None))))
    if hint in PLAIN_TYPES:
        return PLAIN_TYPES[hint]
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return choice(hint)
    if hasattr(hint, "__item__"):
        return part(hint)
    if get_origin(hint) is tuple and len(inner) == 2 and inner[1] is ... and hasattr(inner[0], "__item__"):
        return parts(inner[0])
    raise Wrong(
        f" is of type {hint}; a file can hold float, int, bool, str, enums, value classes, tuples of three floats, "
        "tuples of any number of these, of floats, of texts or of values, and each of them or None"
    )
