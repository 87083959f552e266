"""One prefix all over a page for forces and for stresses: N next to kN is misread by a factor of a thousand."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from tensegrity_mj.basics.units import power_of, unit_with

UNITS = ("N", "Pa")
HEAD = re.compile(r"\[(N|Pa)\]$")


def one_prefix(parts: Iterable[Any]) -> Callable[[Any], Any]:
    """Give the axes of a page's pictures the prefixes of its largest numbers; the function does so with a table."""
    from tensegrity_mj.pictures.ticks import prefixed_axes  # matplotlib, which pages without pictures do not need

    reach: dict[str, list[float]] = {unit: [0.0] for unit in UNITS}
    axes = []
    for part in parts:
        if hasattr(part, "columns"):
            for k, unit in _units(part).items():
                reach[unit] += [abs(row[k]) for row in part.rows if _is_number(row[k])]
        elif hasattr(getattr(part, "figure", None), "axes"):
            axes += [axis for axis in prefixed_axes(part.figure) if axis.unit in UNITS]
    for axis in axes:
        reach[axis.unit].append(axis.reach)
    powers = {unit: power_of(max(found), unit) for unit, found in reach.items()}
    for axis in axes:
        axis.power = powers[axis.unit]

    def in_units(part: Any) -> Any:
        units = _units(part) if hasattr(part, "columns") else {}
        if not units:
            return part
        heads = [HEAD.sub(lambda found: f"[{unit_with(powers[found[1]], found[1])}]", head) for head in part.columns]
        scales = [10.0 ** powers[units[k]] if k in units else None for k in range(len(heads))]
        rows = [
            [cell / scale if scale and _is_number(cell) else cell for cell, scale in zip(row, scales, strict=True)]
            for row in part.rows
        ]
        return replace(part, columns=heads, rows=rows)

    return in_units


def alike(figure: Any) -> None:
    """Give the axes of a figure of one quantity the same prefix for the same unit."""
    from tensegrity_mj.pictures.ticks import prefixed_axes

    axes = prefixed_axes(figure)
    for axis in axes:
        axis.power = power_of(max(other.reach for other in axes if other.unit == axis.unit), axis.unit)


def _units(table: Any) -> dict[int, str]:
    """The units of those columns of a table that have one prefix, by their numbers."""
    return {k: found[1] for k, head in enumerate(table.columns) if (found := HEAD.search(head))}


def _is_number(cell: object) -> bool:
    return isinstance(cell, (int, float)) and math.isfinite(cell)
