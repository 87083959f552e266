"""The kinds of values that type hints stand for, for classes and functions that name no kinds of their own."""

from __future__ import annotations

import contextlib
import enum
import inspect
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.kinds import Kind, Wrong
from tensegrity_mj.errors import OptionError, TensegrityError

PLAIN_TYPES: dict[Any, Kind] = {
    float: kinds.finite(),
    int: kinds.whole(-(2**63), 2**63 - 1),
    bool: kinds.flag(),
    str: kinds.text(),
    tuple[float, float, float]: kinds.vector(""),
    tuple[float, ...]: kinds.rows(),
    tuple[str, ...]: kinds.many(kinds.text(), "a list of texts in quotes"),
    tuple[tuple[float, float, float], ...]: kinds.rows(3),
}


def fitted(what: str, value: Any, hint: Any, error: type[TensegrityError] = OptionError) -> Any:
    """Convert an argument to the kind of its type hint; return it unchanged where the hint has no such kind.

    Raises:
        TensegrityError: of that class, for a value of another type.
    """
    try:
        kind = typed(hint)
    except Wrong:
        return value
    return checked(what, value, kind, error)


def hints_of(called: Any) -> dict[str, Any]:
    """The type hints of a function's arguments, or of a class' and its fields, by name; none that cannot be read."""
    of = [called]
    if isinstance(called, type):
        of.append(inspect.getattr_static(called, "__init__"))
    hints: dict[str, Any] = {}
    for one in of:
        with contextlib.suppress(Exception):  # an annotation may be anything
            hints |= get_type_hints(one, include_extras=True)
    hints.pop("return", None)
    return hints


def typed(hint: Any) -> Kind:
    """Return the kind of a type hint, which refuses values of other types and nothing more.

    `Annotated[type, kind]` is of that kind.
    """
    inner = get_args(hint)
    if get_origin(hint) is Annotated:
        return next((one for one in inner[1:] if isinstance(one, Kind)), None) or typed(inner[0])
    if type(None) in inner and len(inner) == 2:
        return kinds.or_none(typed(next(one for one in inner if one is not type(None))))
    if hint in PLAIN_TYPES:
        return PLAIN_TYPES[hint]
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return kinds.choice(hint)
    if hasattr(hint, "__item__"):
        return kinds.part(hint)
    if get_origin(hint) is tuple and len(inner) == 2 and inner[1] is ... and hasattr(inner[0], "__item__"):
        return kinds.parts(inner[0])
    raise Wrong(
        f" is of type {hint}; a file can hold float, int, bool, str, enums, value classes, tuples of three floats, "
        "tuples of any number of these, of floats, of texts or of values, and each of them or None"
    )
