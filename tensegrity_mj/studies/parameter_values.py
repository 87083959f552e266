"""Values of parameters, and paths in parts: read, refused with what is allowed, and set by the names of fields.

Axes of a sweep are values of parameters, several together, and seeded random draws.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass, replace
from typing import Any

import numpy as np
from attrs import NOTHING

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import choice_from, finite
from tensegrity_mj.basics.fields import field, item_of, kind_of, refused, value
from tensegrity_mj.basics.kinds import Kind, Wrong
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.members import Vector
from tensegrity_mj.studies.plain import plain

AXES = ("x", "y", "z")
_PART = re.compile(r"[^.\[\]]+(\[.*\])?")
MEMBER = re.compile(r"(?P<name>\w+)(\[(?P<which>.+)\])?")


@value("Scaled", OptionError)
class Scaled:
    """A value that is `factor` times what the parameter was."""

    factor: float = field(kinds.finite())

    def __str__(self) -> str:
        return f"*{self.factor!r}"

    def of(self, now: float) -> float:
        return now * self.factor


@value("Noted", OptionError)
class Noted(Scaled):
    """A factor that notes what it was applied to."""

    found: list[float] = field(None, factory=list)

    def of(self, now: float) -> float:
        self.found.append(now)
        return super().of(now)


def encoded(value: Any) -> Any:
    """A value as points hold it: `Scaled(0.8)` is the text *0.8."""
    return str(value) if isinstance(value, Scaled) else value


def decoded(value: Any) -> Any:
    """Return the value that a point holds; raise OptionError where no number follows a *."""
    if isinstance(value, str) and value.startswith("*"):
        try:
            return Scaled(float(value[1:]))
        except ValueError:
            raise OptionError(f"{value!r}: after * there must be a number, such as *0.8") from None
    return value


def once(paths: Sequence[str]) -> None:
    """Raise OptionError where a parameter is given twice."""
    for path in paths:
        if paths.count(path) > 1:
            raise OptionError(f"{path}: it is given twice; give each parameter once")


def parts_of(rest: str, path: str) -> list[str]:
    """The parts between dots; names in brackets may hold dots, and brackets in pairs.

    Raises:
        OptionError: where brackets have no partner, or a part has no name.
    """
    parts, depth = [""], 0
    for letter in rest:
        depth += (letter == "[") - (letter == "]")
        if letter == "." and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
        if depth < 0:
            break
    if depth or not all(_PART.fullmatch(part) for part in parts):
        raise OptionError(f"{path}: it is no parameter; write it like structure.rods[rod1].mass")
    return parts


def axis_of(others: Sequence[str], path: str) -> int | None:
    """Return the component, 0 to 2, that the last parts of a path name; None for all; OptionError if they name none."""
    if not others:
        return None
    if len(others) > 1 or others[0] not in AXES:
        raise OptionError(f"{path}: {unknown(others[0], AXES, 'component')}")
    return AXES.index(others[0])


def no_more(which: str | None, others: Sequence[str], path: str) -> None:
    """Raise OptionError where a path goes on with a member in brackets, or with parts, and nothing has any there."""
    if which is not None or others:
        raise OptionError(f"{path}: it has no parts '{which or others[0]}'; leave them out")


def vector_from(path: str, value: Any, axis: int | None, now: Sequence[float] | None) -> Vector:
    """Return a vector (3,) with all of it, or the component `axis`, set to the value or scaled by it.

    Other rows of numbers keep how many they have.

    Raises:
        OptionError: for a value that is neither as many finite numbers nor, of a component, one; where there is nothing
            that could be scaled, or have a component.
    """
    if now is None and (axis is not None or isinstance(value, Scaled)):
        raise OptionError(f"{path} = {value}: it has no value of which this could be a part; give all of it")
    row = [float(x) for x in now or (0.0, 0.0, 0.0)]
    size = "three" if len(row) == 3 else str(len(row))
    if isinstance(value, Scaled):
        row = [value.of(x) if axis in (None, i) else x for i, x in enumerate(row)]
    elif axis is not None:
        row[axis] = finite(path, value)
    elif not isinstance(value, Sequence) or isinstance(value, str) or len(value) != len(row):
        raise OptionError(f"{path} = {value!r}; it must be a list of {size} numbers, or add .x, .y or .z")
    else:
        row = [finite(path, x) for x in value]
    return tuple(row)  # type: ignore[return-value]


def number_from(path: str, value: Any, now: Any) -> float:
    """Return the value, or the present number `now` scaled by it; raise OptionError where that is not finite."""
    return scaled(path, value, now) if isinstance(value, Scaled) else finite(path, value)


def scaled(path: str, scale: Scaled, now: Any) -> float:
    """Return the parameter's present value `now`, scaled; raise OptionError where that is no finite number."""
    if not isinstance(now, (int, float)) or isinstance(now, bool) or not math.isfinite(now):
        what = "it has no value" if now is None or now is dataclasses.MISSING else f"{now!r} is no number"
        raise OptionError(f"{path} = {scale}: {what} that could be scaled; give one")
    return scale.of(float(now))


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
    """Return the new value of a number, a truth value or a member of an enum."""
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
    names = [_names_of(item, place) for place, item in enumerate(items)]
    known = dict.fromkeys(word for some in names for word in some)
    if which is not None and which not in known:
        raise OptionError(f"{path}: {unknown(which, known, f'member of {name}')}")
    return {place for place, some in enumerate(names) if which is None or which in some}


def _names_of(item: Any, place: int) -> list[str]:
    """Return the names by which an item may be called: its name, where it has one; or else its kind, and its place."""
    title = item_of(type(item)).title if is_dataclass(item) else ""
    kind = kind_of(type(item))
    return [str(getattr(item, title))] if title else [*([kind] if kind else []), str(place)]


PATH = kinds.printable_name("a text, such as law.decay_rate")


def _values(value: Any) -> tuple[Any, ...]:
    try:
        given = kinds.sequence("" if isinstance(value, (Mapping, Scaled)) else value)
    except Wrong:
        raise Wrong(f" = {value!r}; give a list of them") from None
    listed = tuple(one if isinstance(one, Scaled) else plain(one, "values") for one in given)
    if not listed:
        raise Wrong(": give at least one value")
    return listed


class Axis:
    """A parameter and its values, or several that go together."""


@value("Vary {parameter}", OptionError)
class Vary(Axis):
    """A parameter and the values that it takes.

    Attributes:
        parameter: its path (see `parameters`).
        values: plain values, or `Scaled(factor)`.
    """

    parameter: str = field(PATH)
    values: Sequence[Any] = field(Kind(_values))

    @property
    def axes(self) -> tuple[Vary]:
        """This axis alone, as `Together` has several."""
        return (self,)


@value("Together", OptionError)
class Together(Axis):
    """Parameters that go through their values together, the first of each, the second of each, ..."""

    axes: Sequence[Vary] = field(kinds.parts(Vary, "a list of Vary(parameter, values)"))

    def __attrs_post_init__(self) -> None:
        if not self.axes:
            raise refused(self, "axes = (); give a list of Vary(parameter, values)")
        lengths = {axis.parameter: len(axis.values) for axis in self.axes}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{name}: {count}" for name, count in lengths.items())
            raise refused(self, f"parameters that go together need as many values each ({counts})")


@value("Uniform", OptionError)
class Uniform:
    """Uniform distribution between low and high."""

    low: float = field(kinds.finite())
    high: float = field(kinds.finite())

    def __attrs_post_init__(self) -> None:
        if self.low > self.high:
            raise refused(self, f"low = {self.low:g} is above high = {self.high:g}; give the lower one first")

    def sample(self, generator: np.random.Generator) -> Any:
        return float(generator.uniform(self.low, self.high))


@value("LogUniform", OptionError)
class LogUniform(Uniform):
    """Distribution between low and high, both > 0, whose logarithm is uniform."""

    low: float = field(kinds.positive())
    high: float = field(kinds.positive())

    def sample(self, generator: np.random.Generator) -> Any:
        value = math.exp(generator.uniform(math.log(self.low), math.log(self.high)))
        return min(max(value, self.low), self.high)


@value("Normal", OptionError)
class Normal:
    """Normal distribution."""

    mean: float = field(kinds.finite())
    deviation: float = field(kinds.positive())

    def sample(self, generator: np.random.Generator) -> Any:
        return float(generator.normal(self.mean, self.deviation))


@value("Choice", OptionError)
class Choice:
    """Choice of one of some values, each as likely."""

    values: Sequence[Any] = field(Kind(_values))

    def sample(self, generator: np.random.Generator) -> Any:
        return self.values[int(generator.integers(len(self.values)))]


Distribution = Uniform | Normal | Choice


def _distribution(value: Any) -> Distribution:
    if not isinstance(value, Distribution):
        raise Wrong(f" = {value!r}; use Uniform, LogUniform, Normal or Choice")
    return value


@value("Draw {parameter}", OptionError)
class Draw:
    """A parameter and the distribution that it is drawn from.

    Attributes:
        parameter: its path; with [*] for the members, such as structure.rods[*].mass, a draw for each of them.
        distribution: `Uniform`, `LogUniform`, `Normal` or `Choice`.
        scaled: whether what is drawn is a factor on what the parameter was.
    """

    parameter: str = field(PATH)
    distribution: Distribution = field(Kind(_distribution))
    scaled: bool = field(kinds.flag(), default=False)

    def sample(self, generator: np.random.Generator) -> Any:
        """Draw one value, as points hold it."""
        value = self.distribution.sample(generator)
        return encoded(Scaled(value)) if self.scaled else encoded(value)
