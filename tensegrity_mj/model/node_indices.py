"""Arrays of numbers and pairs of node indices, of which a structure is made."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
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


def index_pairs(
    what: str, values: Any, count: int, allow_equal: bool = False, more: bool = False
) -> list[tuple[int, ...]]:
    """The values as pairs (with `more`, paths of two or more) of different node indices below `count`."""
    found = []
    for row, value in enumerate(sequence_of(what, values, StructureError)):
        try:
            path = tuple(int(x) for x in value)
            if len(path) < 2 or (len(path) > 2 and not more):
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            need = "a pair of node indices" + ", or more" * more
            raise StructureError(f"{what}[{row}] = {value!r}: it must be {need}") from None
        if any(i != x for i, x in zip(path, value, strict=True)):
            raise StructureError(f"{what}[{row}] = {list(value)}: node indices must be integers")
        if not all(0 <= i < count for i in path):
            raise StructureError(f"{what}[{row}] = {path}: node indices run from 0 to {count - 1}")
        if not allow_equal and any(i == j for i, j in itertools.pairwise(path)):
            raise StructureError(f"{what}[{row}] = {path}: it must join two different nodes")
        found.append(path)
    return found


def joined_rods(ends: Sequence[tuple[str, str]], rods_at: Mapping[str, tuple[int, ...]]) -> tuple[tuple[int, ...], ...]:
    """See `Structure.clusters`."""
    seen: set[int] = set()
    left = dict(rods_at)  # each node is looked at once, however many rods it has
    found = []
    for first in range(len(ends)):
        if first in seen:
            continue
        cluster, todo = {first}, [first]
        while todo:
            for name in ends[todo.pop()]:
                new = [row for row in left.pop(name, ()) if row not in cluster]
                cluster.update(new)
                todo.extend(new)
        seen |= cluster
        found.append(tuple(sorted(cluster)))
    return tuple(found)
