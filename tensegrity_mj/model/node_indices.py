"""Pairs of node indices, of which a structure is made, and rods that hang together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tensegrity_mj.basics.checks import sequence_of
from tensegrity_mj.errors import StructureError


def index_pairs(what: str, values: Any, count: int, more: bool = False) -> list[tuple[int, ...]]:
    """The values as pairs (with `more`, paths of two or more) of node indices below `count`."""
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
