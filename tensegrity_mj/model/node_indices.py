"""Arrays of numbers and pairs of node indices, of which a structure is made."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import sequence_of
from tensegrity_mj.errors import StructureError


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
    for row, value in enumerate(sequence_of(what, values, StructureError)):
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
