"""Values of parameters, and paths in parts: read, or refused with what is allowed."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import Any

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.checks import finite
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.members import Vector

AXES = ("x", "y", "z")
_PART = re.compile(r"[^.\[\]]+(\[.*\])?")


@value("Scaled", OptionError)
class Scaled:
    """A value that is `factor` times what the parameter was."""

    factor: float = field(kinds.finite())

    def __str__(self) -> str:
        return f"*{self.factor!r}"


def encoded(value: Any) -> Any:
    """A value as points hold it: `Scaled(0.8)` is the text *0.8."""
    return str(value) if isinstance(value, Scaled) else value


def decoded(value: Any) -> Any:
    """The value that a point holds.

    Raises:
        OptionError: where no number follows a *.
    """
    if isinstance(value, str) and value.startswith("*"):
        try:
            return Scaled(float(value[1:]))
        except ValueError:
            raise OptionError(f"{value!r}: after * there must be a number, such as *0.8") from None
    return value


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
    """The component that the last parts of a path name, 0 to 2, or None for all.

    Raises:
        OptionError: if they name none.
    """
    if not others:
        return None
    if len(others) > 1 or others[0] not in AXES:
        raise OptionError(f"{path}: {unknown(others[0], AXES, 'component')}")
    return AXES.index(others[0])


def no_more(which: str | None, others: Sequence[str], path: str) -> None:
    """Raise OptionError where a path goes on with a member in brackets, or with parts, and nothing has any there."""
    if which is not None or others:
        raise OptionError(f"{path}: it has no parts '{which or others[0]}'; leave them out")


def vector_from(path: str, value: Any, axis: int | None, now: Sequence[float]) -> Vector:
    """What a vector (3,) becomes: all of it, or the component `axis`, set to the value or scaled by it.

    Raises:
        OptionError: for a value that is neither three finite numbers nor, of a component, one.
    """
    row = [float(x) for x in now]
    if isinstance(value, Scaled):
        row = [x * value.factor if axis in (None, i) else x for i, x in enumerate(row)]
    elif axis is not None:
        row[axis] = finite(path, value)
    elif not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise OptionError(f"{path} = {value!r}; it must be a list of three numbers, or add .x, .y or .z")
    else:
        row = [finite(path, x) for x in value]
    x, y, z = row
    return (x, y, z)


def number_from(path: str, value: Any, now: Any) -> float:
    """What a number becomes that is `now`: the value, or scaled by it.

    Raises:
        OptionError: where that is no finite number.
    """
    return scaled(path, value, now) if isinstance(value, Scaled) else finite(path, value)


def scaled(path: str, scale: Scaled, now: Any) -> float:
    """What a parameter becomes that is `now`; OptionError where that is no finite number."""
    if not isinstance(now, (int, float)) or isinstance(now, bool) or not math.isfinite(now):
        what = "it has no value" if now is None or now is dataclasses.MISSING else f"{now!r} is no number"
        raise OptionError(f"{path} = {scale}: {what} that could be scaled; give one")
    return float(now) * scale.factor
