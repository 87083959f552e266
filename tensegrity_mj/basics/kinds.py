"""Kinds of values: conversion of arguments to plain values, allowed values, and their form in files.

A kind knows no names. What is wrong is a `Wrong`, the end of a sentence (" = -1.0; it must be > 0 m"); whoever knows
what the value is of puts that in front: the number of a list's item, the field, the item, the file.
"""

from __future__ import annotations

import enum
import math
import numbers
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics import seconds
from tensegrity_mj.basics.texts import closest, value_text
from tensegrity_mj.basics.toml_values import is_list, is_number, is_row, is_table, is_text

# Magnitudes of numbers, other than zero, that a scene or an option may have: the product of any three of them is a
# float with all its digits (1e±300; floats end at 1.8e308, and have fewer digits below 2.2e-308).
SMALLEST, LARGEST = 1e-100, 1e100
MAGNITUDES = f"of a magnitude from {SMALLEST:g} to {LARGEST:g}"


class Wrong(Exception):
    """Error of a value, whose text is the end of a sentence about it."""


class Kind(NamedTuple):
    """Kind of a value: how it is checked, and how it stands in files.

    Attributes:
        plain: the value as plain Python (floats, texts, tuples of them), or raises `Wrong`.
        need: description of the value that a file must hold.
        fits: check that a file's value is one.
        load: conversion of a file's value to an argument of `plain`.
        part: the class of a value with fields of its own, which is a table in a file; None for all others.
        many: whether it is a tuple of such values, an array of tables.
        single: whether it is one number, truth value or member of an enum, which a sweep may set.
        row: whether it is a row of numbers, three of most, which a sweep may set, too, or one of.
        schema: JSON Schema of the value that a file must hold.
    """

    plain: Callable[[Any], Any]
    need: str = "a value"
    fits: Callable[[Any], bool] = lambda value: True
    load: Callable[[Any], Any] = lambda value: value
    part: type | None = None
    many: bool = False
    single: bool = False
    row: bool = False
    schema: Mapping[str, Any] = MappingProxyType({})


def list_schema(items: Mapping[str, Any], size: int | None = None, more: bool = False) -> dict[str, Any]:
    """The JSON Schema of a list, of so many items (with `more`, at least) or any number of them."""
    found = {"type": "array", "items": dict(items)} | ({} if size is None else {"minItems": size})
    return found if size is None or more else found | {"maxItems": size}


NUMBER: dict[str, Any] = {"type": "number"}  # JSON Schema
TEXT: dict[str, Any] = {"type": "string"}


def not_allowed(value: Any, allowed: str) -> Wrong:
    return Wrong(f" = {value_text(shown(value))}; it must be {allowed}")


def shown(value: Any) -> Any:
    """The value without NumPy's wrappers, for messages."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return type(value)(shown(x) for x in value) if type(value) in (list, tuple) else value


def number_in(value: Any, allowed: str, test: Callable[[float], bool]) -> float:
    """The value as a float that passes the test; numbers of any library do, bools and texts do not.

    It must be no further from zero than `LARGEST` and, where the test refuses zero, no nearer to it than `SMALLEST`.
    """
    number = math.nan
    if type(value) is float or (isinstance(value, numbers.Real) and not isinstance(value, (bool, np.bool_))):
        try:
            number = float(value)
        except OverflowError:  # an integer beyond the floats
            number = math.inf
    if not (math.isfinite(number) and test(number)):
        raise not_allowed(value, allowed)
    if abs(number) > LARGEST or (abs(number) < SMALLEST and not test(0.0)):
        raise not_allowed(value, f"{allowed}, and {MAGNITUDES}")
    return value if type(value) is seconds.Rounded else number


def number(allowed: str, test: Callable[[float], bool], **limits: float | bool) -> Kind:
    """A finite number that passes a test; `allowed` says in words which do, and `limits` in words of JSON Schema.

    Numbers of seconds may be texts such as "1/4800", too (see `seconds`).
    """
    schema = {**NUMBER, "description": allowed, **limits}
    if allowed.endswith(" s"):
        plain = partial(number_in, allowed=f"{allowed}, or {seconds.EXAMPLE}", test=test)
        either = {"anyOf": [schema, {**TEXT, "pattern": seconds.PATTERN}]}
        need = f"a number, or {seconds.EXAMPLE}"
        return Kind(
            lambda value: plain(seconds.read(value)), need, seconds.is_time, seconds.held, single=True, schema=either
        )
    return Kind(lambda value: number_in(value, allowed, test), "a number", is_number, float, single=True, schema=schema)


def positive(unit: str = "") -> Kind:
    return number(f"> 0 {unit}".rstrip(), lambda x: x > 0, minimum=0, exclusiveMinimum=True)


def not_negative(unit: str = "") -> Kind:
    return number(f">= 0 {unit}".rstrip(), lambda x: x >= 0, minimum=0)


def finite(unit: str = "") -> Kind:
    return number(f"a finite number{unit and f' [{unit}]'}", lambda x: True)


def within(low: float, high: float, unit: str = "") -> Kind:
    allowed = f"within [{low:g}, {high:g}]{unit and f' [{unit}]'}"
    return number(allowed, lambda x: low <= x <= high, minimum=low, maximum=high)


def whole(least: int, most: int | None = None) -> Kind:
    """An integer within limits."""
    allowed = f"an integer >= {least}" if most is None else f"an integer from {least} to {most}"

    def plain(value: Any) -> int:
        fits = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        if not (fits and value >= least and (most is None or value <= most)):
            raise not_allowed(value, allowed)
        return int(value)

    schema = {"type": "integer", "minimum": least} | ({} if most is None else {"maximum": most})
    return Kind(plain, "an integer", lambda value: type(value) is int, single=True, schema=schema)


def flag() -> Kind:
    def plain(value: Any) -> bool:
        if not isinstance(value, (bool, np.bool_)):
            raise not_allowed(value, "True or False")
        return bool(value)

    return Kind(plain, "true or false", lambda value: isinstance(value, bool), single=True, schema={"type": "boolean"})


def text() -> Kind:
    def plain(value: Any) -> str:
        try:
            str.encode(value)
        except (TypeError, UnicodeEncodeError):
            raise not_allowed(value, "a text that UTF-8 can hold") from None
        return str(value)

    return Kind(plain, "a text in quotes", is_text, schema=TEXT)


def printable_name(what: str = "a non-empty string of printable characters") -> Kind:
    """A name. Printable: names go into TOML, MJCF and NetCDF, and XML cannot hold control characters."""

    def plain(value: Any) -> str:
        if not isinstance(value, str) or not value or not value.isprintable():
            raise not_allowed(value, what)
        return str(value)

    return Kind(plain, "a text in quotes", is_text, schema={**TEXT, "minLength": 1})


def member_of(of: type[enum.Enum], text: str) -> Any:
    """The member of an enum with that text as its value, in which - may stand for spaces; None where there is none."""
    members = {str(member.value): member for member in of}
    return members.get(text, members.get(text.replace("-", " ")))


def choice(of: type[enum.Enum]) -> Kind:
    """A member of an enum, or the text of its value, as in a file."""
    values = [member.value for member in of]

    def plain(value: Any) -> enum.Enum:
        member = member_of(of, value) if isinstance(value, str) else value
        if isinstance(member, of):
            return member
        meant = closest(value, map(str, values)) if isinstance(value, str) else ""
        members, texts = (", ".join(map(str, some)) for some in (of, values))
        raise Wrong(f" = {value_text(value)}{meant}; it must be one of {members}, or its text ({texts})")

    need = " or ".join(f'"{item}"' for item in values)
    return Kind(plain, need, lambda value: is_text(value) and value in values, of, single=True, schema={"enum": values})


def vector(unit: str = "m") -> Kind:
    """Three finite numbers, of a unit or of none ("")."""

    def plain(value: Any) -> tuple[float, ...]:
        try:
            row = tuple(number_in(item, "", lambda x: True) for item in value)
            if len(row) == 3:
                return row
        except (TypeError, Wrong):
            pass
        raise not_allowed(value, f"three finite numbers{unit and f' [{unit}]'} of at most {LARGEST:g}")

    schema = {**list_schema(NUMBER, 3), "description": f"[x, y, z]{unit and f' in {unit}'}"}
    return Kind(plain, "three numbers [x, y, z]", is_row, row=True, schema=schema)


def direction() -> Kind:
    """A vector of any length but zero."""
    any_vector = vector("")

    def plain(value: Any) -> tuple[float, ...]:
        row: tuple[float, ...] = any_vector.plain(value)
        if math.hypot(*row) < SMALLEST:
            raise Wrong(f" = {value_text(shown(value))}; its length must not be zero, and at least {SMALLEST:g}")
        return row

    return any_vector._replace(plain=plain)


def rows(width: int = 0, need: str = "") -> Kind:
    """Kind of a tuple of finite numbers, or of vectors of that width, converted at once."""
    allowed = f"finite vectors, (T, {width})" if width else "finite numbers, (T,)"

    def plain(value: Any) -> tuple[Any, ...]:
        try:
            given = np.array(value)
            array = given.astype(float) if given.dtype.kind in "iuf" else np.array(np.nan)
        except (TypeError, ValueError, OverflowError):
            array = np.array(np.nan)
        if array.shape in ((0,), (0, width)):
            return ()
        fits = array.ndim == 2 and array.shape[1] == width if width else array.ndim == 1
        if not fits or not np.all(np.abs(array) <= LARGEST):  # NaN is not
            raise not_allowed(value, f"a sequence of {allowed}, of at most {LARGEST:g}")
        return tuple(map(tuple, array.tolist())) if width else tuple(array.tolist())

    need = need or ("rows of three numbers" if width else "a list of numbers")
    schema = list_schema(list_schema(NUMBER, width) if width else NUMBER)
    row = partial(is_row, width=width) if width else is_number
    return Kind(plain, need, lambda value: is_list(value, row), schema=schema)


def each(need: str, **of: Kind) -> Kind:
    """Kind of a tuple with one value for each of the kinds `of`, whose names are for messages."""

    def plain(value: Any) -> tuple[Any, ...]:
        try:
            given = sequence(value)
        except Wrong:
            raise not_allowed(value, need) from None
        if len(given) != len(of):
            raise not_allowed(value, need)
        found = []
        for (name, kind), item in zip(of.items(), given, strict=True):
            try:
                found.append(kind.plain(item))
            except Wrong as wrong:
                raise Wrong(f": {name}{wrong}") from None
        return tuple(found)

    fits = partial(is_list, valid=is_number)
    return Kind(plain, need, lambda value: fits(value) and len(value) == len(of), schema=list_schema(NUMBER, len(of)))


def function(arguments: str) -> Kind:
    """A function of these arguments, which no file can hold."""

    def plain(value: Any) -> Any:
        if not callable(value):
            raise not_allowed(value, f"a function ({arguments})")
        return value

    return Kind(plain)


def array(shape: str) -> Kind:
    """A read-only array of floats, whose shape and numbers are for others to check."""

    def plain(value: Any) -> Any:
        try:
            found = np.array(value, float, order="C")  # compiled code reads it row by row
        except (TypeError, ValueError, OverflowError):
            raise not_allowed(value, f"an array of numbers, {shape}") from None
        found.flags.writeable = False
        return found

    return Kind(plain)


def names(of: str) -> Kind:
    """Kind of a tuple of names of members or nodes."""
    return many(printable_name(f"the name of a {of}")._replace(schema=TEXT), "a list of names in quotes")


def pair(of: str, more: bool = False) -> Kind:
    """Two names of members or nodes, with `more` two at least."""
    some = names(of)
    or_more = " or more" if more else ""

    def fits(value: Any) -> bool:
        return some.fits(value) and (len(value) == 2 or (more and len(value) > 2))

    def plain(value: Any) -> tuple[str, ...]:
        try:
            given = () if isinstance(value, (dict, set, frozenset)) else sequence(value)  # of no order
        except Wrong:
            given = ()
        if len(given) < 2 or (len(given) > 2 and not more):
            raise Wrong(f" = {value_text(shown(value))}; it must name two{or_more} {of}s")
        found: tuple[str, ...] = some.plain(given)
        return found

    return Kind(plain, f"a list of two{or_more} names in quotes", fits, schema=list_schema(TEXT, 2, more))


def many(kind: Kind, need: str) -> Kind:
    """Kind of a tuple of values of one kind, without fields."""
    return Kind(
        lambda value: tuple_of(kind.plain, value),
        need,
        partial(is_list, valid=kind.fits),
        lambda value: [kind.load(item) for item in value],
        schema=list_schema(kind.schema),
    )


def mapping(name: Kind, of: Kind, need: str, item: str, least: int = 0) -> Kind:
    """A map of names to values of a kind, `least` in files; `item` is what messages call one."""

    def plain(value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise not_allowed(value, need)
        found = {}
        for key, one in value.items():
            try:
                found[name.plain(key)] = of.plain(one)
            except Wrong as wrong:
                raise Wrong(f": {item} {key!r}{wrong}") from None
        return found

    schema: dict[str, Any] = {"type": "object"} | ({"additionalProperties": dict(of.schema)} if of.schema else {})
    schema |= {"minProperties": least} if least else {}
    return Kind(plain, need, lambda value: is_table(value) and all(map(of.fits, value.values())), schema=schema)


def part(of: type, use: str = "") -> Kind:
    """A value of a value class; `use` says how to make one."""
    return Kind(lambda value: instance(value, of, use), "a table", is_table, part=of)


def parts(of: type, use: str = "") -> Kind:
    """Kind of a tuple of values of a value class."""
    return Kind(
        lambda value: tuple_of(lambda item: instance(item, of, use), value),
        "an array of tables",
        part=of,
        many=True,
    )


def instance(value: Any, of: type, use: str = "") -> Any:
    """The value, which must be of a class."""
    if not isinstance(value, of):
        example = f"{of.__name__}({', '.join(name for name in of.__annotations__ if name[0] != '_')})"
        raise Wrong(f" = {value_text(value)}; use {use or example}")
    return value


def tuple_of(plain: Callable[[Any], Any], value: Any) -> tuple[Any, ...]:
    """The items of a sequence, each made plain; what is wrong with one is said with its number."""
    found = []
    for place, item in enumerate(sequence(value)):
        try:
            found.append(plain(item))
        except Wrong as wrong:
            raise Wrong(f"[{place}]{wrong}") from None
    return tuple(found)


def sequence(value: Any) -> tuple[Any, ...]:
    """The value as a tuple, unless it is a text, or no sequence at all."""
    if not isinstance(value, (str, bytes)):
        try:
            return tuple(value)
        except TypeError:
            pass
    raise not_allowed(value, "a sequence (a list or tuple, of one item too)")


def or_none(kind: Kind) -> Kind:
    """Kind that allows None as well, for which a file has no key."""
    return kind._replace(plain=lambda value: None if value is None else kind.plain(value))
