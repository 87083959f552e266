"""Changes of values by the names of their fields: contact.friction, water.waves[0].amplitude, loads[n1].force.x."""

from __future__ import annotations

import enum
import re
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass, replace
from functools import partial
from typing import Any

from tensegrity_mj.basics.checks import choice_from
from tensegrity_mj.basics.fields import Key, item_of, kind_of
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import OptionError
from tensegrity_mj.studies.parameter_values import Scaled, axis_of, no_more, number_from, scaled, vector_from

MEMBER = re.compile(r"(?P<name>\w+)(\[(?P<which>.+)\])?")

# A value of a value class, and what one of its numbers is set to or scaled by, in; another such value out.
Setter = Callable[[Any, Any], Any]


def setter(now: Any, parts: Sequence[str], path: str, what: str) -> Setter:
    """How a value takes another one of what the parts of a path name.

    Args:
        now: the value, as it is before any change.
        parts: what is left of the path.
        path: all of it, for messages.
        what: what messages call the value.

    Raises:
        OptionError: if they name nothing that could be set.
    """
    if not is_dataclass(now):
        raise OptionError(f"{path}: {what} is of class {type(now).__name__}, which has no fields that could be set")
    match = MEMBER.fullmatch(parts[0]) if parts else None
    keys = {
        key: one for key, one in item_of(type(now)).keys.items() if one.kind.single or one.kind.row or one.kind.part
    }
    if match is None or match["name"] not in keys:
        given = match["name"] if match else "".join(parts[:1])
        raise OptionError(f"{path}: {unknown(given, keys, f'part of {what}')}")
    name, which, others = match["name"], match["which"], parts[1:]
    one = keys[name]
    if one.kind.many:
        items = getattr(now, one.name)
        if callable(items) or not items:
            raise OptionError(f"{path}: {what} has no {name}")
        chosen = _chosen(items, which, path, name)
        setters = {place: setter(item, others, path, f"a member of {name}") for place, item in chosen.items()}
        return partial(_set_some, one, setters)
    no_more(which, (), path)
    if one.kind.part is not None:
        held = getattr(now, one.name)
        # A part that there is not begins with its defaults, where it has some for all.
        return partial(_set_part, one, setter(one.kind.part() if held is None else held, others, path, name))
    if not one.kind.row:
        no_more(None, others, path)
    return partial(_set, one, path, axis_of(others, path) if one.kind.row else None)


def _chosen(items: Sequence[Any], which: str | None, path: str, name: str) -> dict[int, Any]:
    """Places of the items that are meant: all, those of a name or of a registered kind, or the one at a place."""
    words = [_words(item, place) for place, item in enumerate(items)]
    known = dict.fromkeys(word for some in words for word in some)
    if which is not None and which not in known:
        raise OptionError(f"{path}: {unknown(which, known, f'member of {name}')}")
    return {place: item for place, item in enumerate(items) if which is None or which in words[place]}


def _words(item: Any, place: int) -> list[str]:
    """What an item may be called by: its name, where it has one; or else its kind, and its place."""
    title = item_of(type(item)).title if is_dataclass(item) else ""
    kind = kind_of(type(item))
    return [str(getattr(item, title))] if title else [*([kind] if kind else []), str(place)]


def _set_some(one: Key, setters: dict[int, Setter], held: Any, value: Any) -> Any:
    items = getattr(held, one.name)
    new = (setters[place](item, value) if place in setters else item for place, item in enumerate(items))
    return replace(held, **{one.name: tuple(new)})


def _set_part(one: Key, inside: Setter, held: Any, value: Any) -> Any:
    now = getattr(held, one.name)
    assert one.kind.part is not None
    return replace(held, **{one.name: inside(one.kind.part() if now is None else now, value)})


def _set(one: Key, path: str, axis: int | None, held: Any, value: Any) -> Any:
    now, kind = getattr(held, one.name), one.kind
    if kind.row:
        new: Any = vector_from(path, value, axis, now)
    elif isinstance(value, Scaled):
        new = scaled(path, value, now)
    elif isinstance(kind.load, type) and issubclass(kind.load, enum.Enum):
        new = choice_from(path, kind.load, value)
    elif kind.load is float:
        new = number_from(path, value)
    elif not kind.fits(value):
        raise OptionError(f"{path} = {value!r}; it must be {kind.need}")
    else:
        new = value
    return replace(held, **{one.name: new})
