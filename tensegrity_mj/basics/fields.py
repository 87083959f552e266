"""Value classes: what a scene is made of, each field of a kind.

    @value("wave")
    class Wave:
        amplitude: float = field(not_negative("m"))
        direction: float = field(finite("rad"), default=0.0)

A value is checked and made plain when it is made: by its fields, then by its `__attrs_post_init__`, where it has one.
What is wrong is an error that begins with the item: "wave: amplitude = -1.0; it must be >= 0 m". A value is immutable,
compared by its fields, and hashable where these are. `model.text.codec` reads and writes it by the same ones.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar, dataclass_transform

import attrs

from tensegrity_mj.basics.kinds import Kind, Wrong, or_none
from tensegrity_mj.errors import SceneError, TensegrityError

T = TypeVar("T")


class Item(NamedTuple):
    """What is known of a value class, as its attribute `__item__`.

    Attributes:
        label, error, whole: as `value` was given.
        title: the field by which messages call a value ("name" in "rod {name!r}"), or "".
        keys: the fields that stand in files, by their keys there.
    """

    label: str
    error: type[TensegrityError]
    whole: bool
    title: str
    keys: dict[str, attrs.Attribute[Any]]


def field(
    kind: Kind | None,
    *,
    default: Any = attrs.NOTHING,
    factory: Callable[[], Any] | None = None,
    none: str = "",
    key: str = "",
    eq: Any = True,
) -> Any:
    """A field of a value class.

    Args:
        kind: of its value; None for what is taken as it is, and stands in no file.
        default: what it is where it is not given.
        factory: makes the default, where each value needs its own.
        none: what None means, of a field that may be None, for messages ("None for deep water").
        key: what files and messages call it, if not by its own name.
        eq: whether values that differ in it differ; or a function of what is compared, or `attrs.cmp_using`.
    """
    options: dict[str, Any] = {"default": default} if factory is None else {"factory": factory}
    if kind is None:
        return attrs.field(**options, eq=eq)
    kind = or_none(kind) if none else kind
    plain = kind.plain

    def convert(given: Any, item: Any, itself: attrs.Attribute[Any]) -> Any:
        try:
            return plain(given)
        except Wrong as wrong:
            text = f"{key or itself.name}{wrong}{none and f', or {none}'}"
            raise refused(item, text, {itself.name: given}) from None

    converter = attrs.Converter(convert, takes_self=True, takes_field=True)
    return attrs.field(**options, eq=eq, converter=converter, metadata={"kind": kind, "key": key})


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def value(
    item: str = "", error: type[TensegrityError] = SceneError, *, whole: bool = False, **options: Any
) -> Callable[[type[T]], type[T]]:
    """Make a class a value class.

    Args:
        item: what messages call it; fields in braces are shown as they are ("rod {name!r}"). "" for nothing.
        error: of what is wrong with it.
        whole: whether files hold its fields where they are at their defaults, too, but for None.
        options: further ones of `attrs.define`.
    """

    def made(cls: type[T]) -> type[T]:
        attrs.define(cls, frozen=True, slots=False, **options)
        fields = attrs.fields_dict(cls)  # type: ignore[arg-type]
        for name, one in fields.items():
            if one.default is not attrs.NOTHING and not hasattr(one.default, "factory"):
                setattr(cls, name, one.default)
        keys = {one.metadata["key"] or name: one for name, one in fields.items() if "kind" in one.metadata}
        title = re.search(r"{(\w+)", item)
        cls.__item__ = Item(item, error, whole, title[1] if title else "", keys)  # type: ignore[attr-defined]
        # So that dataclasses.replace, fields and asdict take it.
        return dataclasses.dataclass(init=False, repr=False, eq=False, match_args=False)(cls)

    return made


def item_of(cls: type) -> Item:
    return cls.__item__  # type: ignore[attr-defined]


def refused(item: Any, text: str, given: Mapping[str, Any] | None = None) -> TensegrityError:
    """The error of an item that is wrong, for a check of several of its fields; `given` are those not yet set."""
    of = item_of(type(item))
    known = {of.title: None, **vars(item), **(given or {})}
    return of.error(f"{of.label.format_map(known)}: {text}" if of.label else text)


def without_item(cls: type, values: Mapping[str, Any], error: TensegrityError) -> str:
    """The message of an error that was raised by making a value, less the item in front."""
    of = item_of(cls)
    return str(error).removeprefix(f"{of.label.format_map({of.title: None, **values})}: ")
