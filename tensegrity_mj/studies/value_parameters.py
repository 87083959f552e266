"""Changes of values by the names of their fields: contact.friction, water.waves[0].amplitude, loads[n1].force.x."""

from __future__ import annotations

import enum
import re
from collections.abc import Sequence
from dataclasses import is_dataclass, replace
from typing import Any

from attrs import NOTHING

from tensegrity_mj.basics.checks import choice_from, finite
from tensegrity_mj.basics.fields import item_of, kind_of
from tensegrity_mj.basics.kinds import Kind
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import OptionError
from tensegrity_mj.studies.parameter_values import Scaled, axis_of, no_more, scaled, vector_from

MEMBER = re.compile(r"(?P<name>\w+)(\[(?P<which>.+)\])?")


def changed(now: Any, parts: Sequence[str], path: str, what: str, value: Any) -> Any:
    """A value with another one of what the parts of a path name, set or scaled.

    Args:
        now: the value, of a value class.
        parts: what is left of the path.
        path: all of it, for messages.
        what: what messages call the value.
        value: what the part becomes, or what it is scaled by.

    Raises:
        OptionError: if they name nothing that could be set.
    """
    if not is_dataclass(now) or isinstance(now, type):
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
    held, kind = getattr(now, one.name), one.kind
    new: Any
    if kind.many:
        if callable(held) or not held:
            raise OptionError(f"{path}: {what} has no {name}")
        chosen = _chosen(held, which, path, name)
        new = tuple(
            changed(item, others, path, f"a member of {name}", value) if place in chosen else item
            for place, item in enumerate(held)
        )
        return replace(now, **{one.name: new})
    no_more(which, (), path)
    if kind.part is not None:
        # A part that there is not begins with its defaults, where it has some for all.
        plain = is_dataclass(kind.part)  # of no kind that a file would have to name
        if held is None and not (plain and all(one.default is not NOTHING for one in item_of(kind.part).keys.values())):
            raise OptionError(f"{path}: {what} has no {name}")
        new = changed(kind.part() if held is None else held, others, path, name, value)
    elif kind.row:
        new = vector_from(path, value, axis_of(others, path), held)
    else:
        no_more(None, others, path)
        new = single(kind, path, value, held)
    return replace(now, **{one.name: new})


def single(kind: Kind, path: str, value: Any, now: Any) -> Any:
    """What a number, a truth value or a member of an enum becomes."""
    if isinstance(value, Scaled):
        return scaled(path, value, now)
    if isinstance(kind.load, type) and issubclass(kind.load, enum.Enum):
        return choice_from(path, kind.load, value)
    if kind.load is float:
        return finite(path, value)
    if not kind.fits(value):
        raise OptionError(f"{path} = {value!r}; it must be {kind.need}")
    return value


def _chosen(items: Sequence[Any], which: str | None, path: str, name: str) -> set[int]:
    """Places of the items that are meant: all, those of a name or of a registered kind, or the one at a place."""
    words = [_words(item, place) for place, item in enumerate(items)]
    known = dict.fromkeys(word for some in words for word in some)
    if which is not None and which not in known:
        raise OptionError(f"{path}: {unknown(which, known, f'member of {name}')}")
    return {place for place, some in enumerate(words) if which is None or which in some}


def _words(item: Any, place: int) -> list[str]:
    """What an item may be called by: its name, where it has one; or else its kind, and its place."""
    title = item_of(type(item)).title if is_dataclass(item) else ""
    kind = kind_of(type(item))
    return [str(getattr(item, title))] if title else [*([kind] if kind else []), str(place)]
