"""Numbers, vectors, texts and sequences as users give them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import LARGEST, MAGNITUDES, SMALLEST
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.errors import StructureError

if TYPE_CHECKING:
    from tensegrity_mj.model.structure import Structure


def array_of_shape(what: str, values: Any, shape: tuple[int, ...], broadcast: bool = True) -> Array:
    """The values as a finite float array of the given shape (-1: any length; scalars pass if `broadcast`).

    Raises:
        StructureError: naming what it is, the shape it has and the shape it must have.
    """
    try:
        array = np.array(values, float)
    except (TypeError, ValueError, OverflowError):
        raise StructureError(f"{what}: {values!r} is not an array of numbers of shape {shape}") from None
    fits = array.ndim == len(shape) and all(want in (-1, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits and not (broadcast and array.ndim == 0):
        raise StructureError(f"{what}: shape {array.shape}; it must be {shape}" + (" or a scalar" if broadcast else ""))
    if not np.all(np.isfinite(array)):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0]) if array.ndim else ()
        raise StructureError(f"{what}{list(where) if where else ''} = {array[where]}: every number must be finite")
    return array


def index_pairs(what: str, values: Any, count: int, allow_equal: bool = False) -> list[tuple[int, int]]:
    """The values as pairs of different node indices below `count`."""
    pairs = []
    for row, value in enumerate(sequence_of(what, values)):
        try:
            i, j = (int(x) for x in value)
        except (TypeError, ValueError, OverflowError):
            raise StructureError(f"{what}[{row}] = {value!r}: it must be a pair of node indices") from None
        whole = i == value[0] and j == value[1]
        if not whole:
            raise StructureError(f"{what}[{row}] = {list(value)}: node indices must be integers")
        if not (0 <= i < count and 0 <= j < count):
            raise StructureError(f"{what}[{row}] = ({i}, {j}): node indices run from 0 to {count - 1}")
        if i == j and not allow_equal:
            raise StructureError(f"{what}[{row}] = ({i}, {j}): it must join two different nodes")
        pairs.append((i, j))
    return pairs


def sequence_of(what: str, values: Any, error: type[Exception] = StructureError) -> tuple[Any, ...]:
    """The values as a tuple; raise `error` if they are a text, or no sequence at all."""
    if not isinstance(values, str):
        try:
            return tuple(values)
        except TypeError:
            pass
    raise error(f"{what} = {values!r}; it must be a sequence (a list or tuple, of one item too)")


def check_number(what: str, value: Any, allowed: str, test: Any, error: type[Exception] = StructureError) -> None:
    """Raise `error` unless the value is a finite number that passes the test; `allowed` says in words which do.

    It must be no further from zero than `LARGEST` and, where the test refuses zero, no nearer to it than `SMALLEST`.
    """
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    try:
        valid = number and np.isfinite(float(value)) and test(value)
    except OverflowError:  # an integer beyond the floats
        valid = False
    if not valid:
        raise error(f"{what} = {value_text(shown(value))}; it must be {allowed}")
    if abs(float(value)) > LARGEST or (abs(float(value)) < SMALLEST and not test(0.0)):
        raise error(f"{what} = {value_text(shown(value))}; it must be {allowed}, and {MAGNITUDES}")


def check_vector(what: str, value: Any, error: type[Exception] = StructureError, unit: str = "m") -> None:
    """Raise `error` unless the value is three finite numbers, none beyond `LARGEST`."""
    try:
        array = np.array(value, float)
    except (TypeError, ValueError, OverflowError):
        array = np.array([])
    if array.shape != (3,) or not np.all(np.abs(array) <= LARGEST):  # NaN is not
        raise error(
            f"{what} = {value_text(shown(value))}; it must be three finite numbers [{unit}] of at most {LARGEST:g}"
        )


def check_normal(what: str, plane: ArrayLike, error: type[Exception] = StructureError) -> Array:
    check_vector(f"{what}: plane normal", plane, error)
    if not 0.0 < distance(np.zeros(3), np.array(plane, float)) < np.inf:
        raise error(f"{what}: plane normal = {value_text(shown(plane))}; its length must be neither zero nor infinite")
    return unit_rows(np.array([plane], float))[0]


def check_text(what: str, value: Any, error: type[Exception]) -> None:
    try:
        value.encode()
    except (AttributeError, UnicodeEncodeError):
        raise error(f"{what} = {value_text(value)}; it must be a text that UTF-8 can hold") from None


def shown(value: Any) -> Any:
    """The value without NumPy's wrappers, for messages."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return type(value)(shown(x) for x in value) if type(value) in (list, tuple) else value


# Initial motions are accepted when they break a rigid constraint by less than this part of the structure's size
# (or of its fastest node): well above the round-off of 17 digits, well below anything that would be seen.
CONSTRAINT_TOLERANCE = 1e-9


def distance(a: Array, b: Array) -> float:
    with np.errstate(over="ignore"):  # infinite is what the caller checks for
        return float(np.linalg.norm(b - a))


def unit_rows(rows: Array) -> Array:
    return rows / np.where(np.linalg.norm(rows, axis=1) > 0, np.linalg.norm(rows, axis=1), 1.0)[:, None]


def size_of(structure: Structure) -> float:
    """What tolerances of lengths are relative to [m]: the extent, or for a single node its distance from 0, or 1."""
    positions = np.array(list(structure.nodes.values()), float).reshape(-1, 3)
    return float(np.ptp(positions, axis=0).max()) or float(np.abs(positions).max()) or 1.0
