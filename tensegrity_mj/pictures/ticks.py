"""Numbers on axes as people write them: 0.5, 1.0, 1.5 with "[kN]", where all of them would be 500, 1000, 1500 N.

All over a page forces have one prefix, and stresses: N next to kN is misread by a factor of a thousand.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

from matplotlib.axes import Axes
from matplotlib.ticker import Formatter, LogFormatterSciNotation, NullLocator, ScalarFormatter

from tensegrity_mj.basics.units import power_of, unit_with

MOST_DECADES = 4

UNIT = re.compile(r"\[([^\[\]]+)\]$")


class Prefixed(Formatter):
    """Ticks of a linear axis whose label ends in a unit; the unit gets the prefix that the axis' numbers want.

    Which one is known only when the figure is laid out: axes that share their scale, and with it this object, may
    still grow.
    """

    def __init__(self, unit: str) -> None:
        self._labels: dict[Any, str] = {}  # of all axes that share the scale, and their texts without a prefix
        self.unit = unit
        self.power: int | None = None  # of the page; by default the axis' own

    def add(self, label: Any) -> None:
        """Give this axis' label the prefix, too."""
        self._labels.setdefault(label, label.get_text())

    def __call__(self, value: float, pos: int | None = None) -> str:
        del pos
        return f"{value:g}"

    @property
    def reach(self) -> float:
        """The largest number on the axis, in the unit without a prefix."""
        return max(map(abs, self.axis.get_view_interval()))  # type: ignore[union-attr]

    def format_ticks(self, values: Sequence[float]) -> list[str]:
        """All ticks with the same number of decimals, and the unit in the axis' label."""
        low, high = sorted(self.axis.get_view_interval())  # type: ignore[union-attr]
        seen = [v for v in values if low <= v <= high] or list(values)
        power = power_of(max(map(abs, seen), default=0.0), self.unit) if self.power is None else self.power
        for label, text in self._labels.items():
            label.set_text(UNIT.sub(f"[{unit_with(power, self.unit)}]", text))
        scaled = [float(v) / 10.0**power for v in values]
        step = min((b - a for a, b in itertools.pairwise(scaled) if b > a), default=1.0)
        digits = next((d for d in range(8) if all(abs(round(v, d) - v) <= 1e-6 * step for v in scaled)), 8)
        return [f"{v:.{digits}f}".replace("-", "−") for v in scaled]


def prefixed_axes(figure: Any) -> list[Prefixed]:
    """The formatters of a figure's axes that may have a prefix."""
    axes = (axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis))
    return [one for axis in axes if isinstance(one := axis.get_major_formatter(), Prefixed)]


def prefix_ticks(panel: Axes) -> None:
    """Write linear axes whose labels end in a unit in brackets with its prefix, and short logarithmic ones in full."""
    for axis in (panel.xaxis, panel.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(Written(minor=False))
            axis.set_minor_formatter(Written(minor=True))
            low, high = axis.get_view_interval()
            if high > 10.0**MOST_DECADES * low:  # marks within decades run together, and take most of a figure's time
                axis.set_minor_locator(NullLocator())
        found = UNIT.search(axis.label.get_text())
        if found and isinstance(axis.get_major_formatter(), ScalarFormatter) and axis.get_scale() == "linear":
            axis.set_major_formatter(Prefixed(found.group(1)))
        if found and isinstance(one := axis.get_major_formatter(), Prefixed):
            one.add(axis.label)


class Written(LogFormatterSciNotation):
    """Numbers of a logarithmic axis in full, 1.4 and not 1.4 x 10^0, where it spans less than two decades near 1.

    Whether it does is known only when the figure is laid out: limits may still be set.
    """

    def __init__(self, minor: bool) -> None:
        super().__init__()
        self._minor = minor

    def format_ticks(self, values: list[float]) -> list[str]:
        low, high = sorted(self.axis.get_view_interval())  # type: ignore[union-attr]
        if low < 1e-3 or high > 1e4 or high >= 100.0 * low:
            return list(super().format_ticks(values))
        # Between 3 and 10 times the lowest, 6 to 9 stand too near one another.
        few = "" if high >= 10.0 * low else "23456789" if high < 3.0 * low else "235"
        return [f"{value:g}" if not self._minor or f"{value:e}"[0] in few else "" for value in values]


UNITS = ("N", "Pa")
HEAD = re.compile(r"\[(N|Pa)\]$")


def one_prefix(parts: Iterable[Any]) -> Callable[[Any], Any]:
    """Give the axes of a page's pictures the prefixes of its largest numbers; the function does so with a table."""
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
    axes = prefixed_axes(figure)
    for axis in axes:
        axis.power = power_of(max(other.reach for other in axes if other.unit == axis.unit), axis.unit)


def _units(table: Any) -> dict[int, str]:
    """The units of those columns of a table that have one prefix, by their numbers."""
    return {k: found[1] for k, head in enumerate(table.columns) if (found := HEAD.search(head))}


def _is_number(cell: object) -> bool:
    return isinstance(cell, (int, float)) and math.isfinite(cell)
