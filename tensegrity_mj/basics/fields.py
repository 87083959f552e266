"""Value classes, of which scenes are made: each of their fields has a kind.

    @value("wave")
    class Wave:
        amplitude: float = field(not_negative("m"))
        direction: float = field(finite("rad"), default=0.0)

A value is checked and made plain when it is made: by its fields, then by its `__attrs_post_init__`, where it has one.
What is wrong is an error that begins with the item: "wave: amplitude = -1.0; it must be >= 0 m". A value is immutable,
compared by its fields, and hashable where these are. `model.text.codec` reads and writes it by the same ones. Where a
field is no `field`, its kind follows from its type (`typed`). `function_of` makes functions of many parameters of them.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, ParamSpec, TypeVar, dataclass_transform, get_origin, get_type_hints

import attrs
import numpy as np

from tensegrity_mj.basics.dependencies import installed, load
from tensegrity_mj.basics.hints import typed
from tensegrity_mj.basics.kinds import Kind, Wrong, or_none
from tensegrity_mj.errors import SceneError, TensegrityError

T = TypeVar("T")

SAME_ARRAY = attrs.cmp_using(eq=np.array_equal)  # for `eq` of a field


class Key(NamedTuple):
    """A field that stands in files: its name, its kind, and its default (`attrs.NOTHING`: a value needs it)."""

    name: str
    kind: Kind
    default: Any


class Item(NamedTuple):
    """Description of a value class, in its attribute `__item__`.

    Attributes:
        label, error, whole: as `value` was given.
        title: the field by which messages call a value ("name" in "rod {name!r}"), or "".
        keys: the fields that stand in files, by their keys there.
    """

    label: str
    error: type[TensegrityError]
    whole: bool
    title: str
    keys: dict[str, Key]


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
        kind: kind of its value; None for a value that is not checked, and stands in no file.
        default: its value where none is given.
        factory: makes the default, where each value needs its own.
        none: meaning of None, for a field that may be None, for messages ("None for deep water").
        key: its name in files and messages, if that is not the field's own.
        eq: whether it counts in comparisons of values; or a function that gives what is compared, or `attrs.cmp_using`.
    """
    options: dict[str, Any] = {"default": default} if factory is None else {"factory": factory}
    if kind is None:
        return attrs.field(**options, eq=eq)
    kind = or_none(kind) if none else kind
    plain = kind.plain
    usual: list[Any] = []  # the default as it is once it is plain

    def convert(given: Any, item: Any, itself: attrs.Attribute[Any]) -> Any:
        if usual and given is default:
            return usual[0]
        try:
            found = plain(given)
        except Wrong as wrong:
            text = f"{key or itself.name}{wrong}{none and f', or {none}'}"
            raise refused(item, text, {itself.name: given}) from None
        if given is default:
            usual.append(found)
        return found

    converter = attrs.Converter(convert, takes_self=True, takes_field=True)
    return attrs.field(**options, eq=eq, converter=converter, metadata={"kind": kind, "key": key})


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def value(
    item: str = "",
    error: type[TensegrityError] = SceneError,
    *,
    whole: bool = False,
    positional: int | None = None,
    **options: Any,
) -> Callable[[type[T]], type[T]]:
    """Make a class a value class.

    Args:
        item: its name in messages; fields in braces are filled in ("rod {name!r}"). "" for nothing.
        error: class of its errors.
        whole: whether files hold its fields where they are at their defaults, too, but for None.
        positional: how many fields may be given without their names; all of them by default.
        options: further ones of `attrs.define`.
    """

    def by_name(cls: type, fields: list[attrs.Attribute[Any]]) -> list[attrs.Attribute[Any]]:
        return [one if positional is None else one.evolve(kw_only=n >= positional) for n, one in enumerate(fields)]

    def made(cls: type[T]) -> type[T]:
        for name, kind in _typed_fields(cls):
            setattr(cls, name, field(kind, default=vars(cls).get(name, attrs.NOTHING)))
        attrs.define(cls, frozen=True, slots=False, field_transformer=by_name, **options)
        fields = attrs.fields_dict(cls)  # type: ignore[arg-type]
        for name, one in fields.items():
            if one.default is not attrs.NOTHING and not hasattr(one.default, "factory"):
                setattr(cls, name, one.default)
        keys = {
            one.metadata["key"] or name: Key(name, one.metadata["kind"], one.default)
            for name, one in fields.items()
            if "kind" in one.metadata
        }
        title = re.search(r"{(\w+)", item)
        cls.__item__ = Item(item, error, whole, title[1] if title else "", keys)  # type: ignore[attr-defined]
        # So that dataclasses.replace, fields and asdict take it.
        return dataclasses.dataclass(init=False, repr=False, eq=False, match_args=False)(cls)

    return made


def _typed_fields(cls: type) -> list[tuple[str, Kind]]:
    """The fields of a class, not of what it inherits from, that are no `field`, and the kinds of their types."""
    own = [name for name in vars(cls).get("__annotations__", {}) if not hasattr(vars(cls).get(name), "metadata")]
    hints = get_type_hints(cls) if own else {}
    found = []
    for name in own:
        if get_origin(hints[name]) is not ClassVar and hints[name] is not ClassVar:
            try:
                found.append((name, typed(hints[name])))
            except Wrong as wrong:
                raise SceneError(f"{cls.__name__}: {name}{wrong}") from None
    return found


def item_of(cls: type) -> Item:
    """Return the description of a value class, or of a dataclass, whose annotations then give the kinds."""
    if "__item__" not in vars(cls):
        given = {one.name: one for one in dataclasses.fields(cls)}
        needed = dataclasses.MISSING
        keys = {
            name: Key(name, kind, attrs.NOTHING if given[name].default is needed else given[name].default)
            for name, kind in _typed_fields(cls)
        }
        cls.__item__ = Item("", SceneError, False, "", keys)  # type: ignore[attr-defined]
    item: Item = vars(cls)["__item__"]
    return item


def refused(item: Any, text: str, given: Mapping[str, Any] | None = None) -> TensegrityError:
    """Make the error of an invalid item, for a check of several fields; `given` are values that are not set yet."""
    of = item_of(type(item))
    return of.error(_label(of, {**vars(item), **(given or {})}) + text)


def without_item(cls: type, values: Mapping[str, Any], error: TensegrityError) -> str:
    """Return the message of an error raised by making a value, without the item in front."""
    of = item_of(cls)
    return str(error).removeprefix(_label(of, values))


def _label(of: Item, values: Mapping[str, Any]) -> str:
    """Return the beginning of messages about an item; only its kind if it has no name yet."""
    called = values.get(of.title)
    if of.title and not (isinstance(called, str) and called):
        return of.label.partition(" {")[0] + ": "
    return of.label.format_map(values) + ": " if of.label else ""


_KINDS: dict[str, type] = {}


def register(kind: str, cls: type) -> None:
    """Give a class the name by which files know it: the key `kind` of a table that stands for a subclass of its base.

    A package that is installed does so by an entry point of that name, in the group "tensegrity_mj.elements" for
    subclasses of `Element`. A file runs no code: what it names is known before.

    Args:
        kind: the name.
        cls: a value class (`value`), or a frozen dataclass whose fields are of types that a file can hold.

    Raises:
        SceneError: if the name is another class's, or the class is not such a one.
    """
    if not isinstance(kind, str) or not kind.isprintable() or not kind:
        raise SceneError(f"register: kind = {kind!r}; it must be a non-empty string of printable characters")
    if not isinstance(cls, type) or not dataclasses.is_dataclass(cls):
        raise SceneError(f"register: {cls!r}; it must be a class of values: decorate it with @dataclass(frozen=True)")
    other = _KINDS.get(kind, cls)
    if (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):  # a cell that is run again is not
        raise SceneError(f"register: kind '{kind}' is {other.__qualname__} already; give {cls.__qualname__} another")
    item_of(cls)
    _KINDS[kind] = cls


def registered(base: type) -> dict[str, type]:
    """The classes that are registered for a base class, by their names."""
    for name, point in installed(f"{base.__name__.lower()}s").items():
        if name not in _KINDS:
            register(name, load(point))
    return {kind: cls for kind, cls in _KINDS.items() if issubclass(cls, base)}


def kind_of(cls: type) -> str:
    """The name of a class that is registered, or ""."""
    return next((kind for kind, one in _KINDS.items() if one is cls), "")


P = ParamSpec("P")
R = TypeVar("R")


def function_of(parameters: Callable[P, Callable[[], R]]) -> Callable[P, R]:
    """The function that takes a class' fields and returns what its instance returns: Tower(3, radius=0.4)()."""

    @functools.wraps(parameters, updated=())
    def function(*args: P.args, **options: P.kwargs) -> R:
        return parameters(*args, **options)()

    # With the types of the fields, which converters hide.
    own, types = inspect.signature(parameters), getattr(parameters, "__annotations__", {})
    shown = [one.replace(annotation=types.get(name, one.annotation)) for name, one in own.parameters.items()]
    returned = vars(parameters)["__call__"].__annotations__["return"]
    function.__signature__ = own.replace(parameters=shown, return_annotation=returned)  # type: ignore[attr-defined]
    return function
