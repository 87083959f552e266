"""Members, counts and numbers as the texts and tables of statics list them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import plain
from tensegrity_mj.model.members import Rod, String

SHOWN = 8  # names or numbers that a line lists


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: "1 state", "2 states"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def listed(names: Iterable[str], most: int = SHOWN) -> str:
    """The names, so many at most."""
    every = list(names)
    return ", ".join(every[:most]) + (f", ... ({len(every)} in all)" if len(every) > most else "")


def statistics(values: Array) -> dict[str, float]:
    """The least, the median and the largest; nothing of nothing."""
    if not len(values):
        return {}
    return {"min": float(values.min()), "median": float(np.median(values)), "max": float(values.max())}


def by_member(members: Sequence[Rod] | Sequence[String], columns: Mapping[str, Iterable[Any]]) -> Any:
    """Return each member's entries of the columns, by name, as plain values; None for numbers that are not finite."""
    return {
        member.name: {
            key: None if isinstance(shown := plain(x), float) and not np.isfinite(shown) else shown
            for key, x in zip(columns, row, strict=True)
        }
        for member, *row in zip(members, *columns.values(), strict=True)
    }
