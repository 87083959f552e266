"""Times as users write them: 0.5, 2.0833e-4, 1/4800. The one reader of them, and the range that digits leave open.

A number of three digits or more is taken as rounded: half a unit of its last digit is open, within which `fitted` moves
it such that steps divide what they must. Fewer digits (1e-3), whole numbers and quotients are meant as they stand.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from decimal import Decimal, InvalidOperation
from typing import Any

from tensegrity_mj.basics.toml_values import is_number

DIGITS = 3  # of a number that is taken as rounded: it is open by at most 0.5 % of itself
TRIED = 1000  # divisors near a step
AS_ONE = 1e-9  # relative: what counts as a multiple
EXAMPLE = 'a text such as "1/4800"'
PATTERN = r"^\s*[0-9.eE+-]+\s*(/\s*[0-9.eE+-]+\s*)?$"


class Rounded(float):
    """A time [s] as it was written, a float for all else.

    Attributes:
        open: [s] by how much its digits leave it open.
        text: as it was written.
    """

    open: float = 0.0
    text: str = ""


def read(value: Any) -> Any:
    """The time [s] that a text means; what is no text, and a text that means none, as it is."""
    if not isinstance(value, str) or not re.match(PATTERN, value):
        return value
    above, slash, below = value.partition("/")
    try:
        found = Rounded(float(above) / float(below) if slash else float(above))
        number = Decimal(above.strip()).normalize()
    except (ValueError, ZeroDivisionError, InvalidOperation):
        return value
    unit = number.as_tuple().exponent
    if not slash and isinstance(unit, int) and unit < 0 and len(number.as_tuple().digits) >= DIGITS:
        found.open = 0.5 * 10.0**unit
    found.text = value.strip()
    return found


def is_time(value: Any) -> bool:
    """Return whether a value from TOML is a number, or a text that means a time."""
    return is_number(value) or isinstance(read(value), Rounded)


def held(value: Any) -> Any:
    """Return a time from a file as it stands there, for `read`."""
    return value if isinstance(value, str) else float(value)


def is_multiple(time: float, step: float) -> bool:
    """Return whether a time is a whole number of steps, one at least."""
    return time >= 0.5 * step and abs(time / step - round(time / step)) <= AS_ONE * max(1.0, time / step)


def fitted(step: float, times: Mapping[str, float]) -> tuple[float, dict[str, float]]:
    """A step [s] and times [s] that are whole numbers of it, each moved within what is open; as given where none are.

    The step stays where it can; else it is one over a whole number, or the nearest that divides the first time.
    """
    plain = {what: float(time) for what, time in times.items()}
    if not all(is_multiple(time, step) for time in plain.values()):
        for one in _candidates(step, next(iter(plain.values()))):
            moved = {what: time if is_multiple(time, one) else one * round(time / one) for what, time in plain.items()}
            if all(_near(moved[what], time) for what, time in times.items()):
                return one, moved
    return float(step), plain


def _near(value: float, given: float) -> bool:
    return abs(value - given) <= getattr(given, "open", 0.0)


def _candidates(step: float, first: float) -> Iterator[float]:
    """Steps that may be meant, the likeliest first."""
    if getattr(step, "open", 0.0) and step < 1:
        yield from filter(lambda one: _near(one, step), [1 / round(1 / step)])
        near = (round(first / step) + sign * k for k in range(TRIED) for sign in (1, -1))
        yield from (first / count for count in near if count > 0 and _near(first / count, step))
    yield float(step)
