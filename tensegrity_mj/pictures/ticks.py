"""Numbers on axes as people write them: 0.5, 1.0, 1.5 with "[kN]", where all of them would be 500, 1000, 1500 N."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from matplotlib.ticker import Formatter, FuncFormatter, NullFormatter, NullLocator, ScalarFormatter

from tensegrity_mj.basics.units import power_of, unit_with

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_DECADES = 4

UNIT = re.compile(r"\[([^\[\]]+)\]$")


class Prefixed(Formatter):
    """Ticks of a linear axis whose label ends in a unit; the unit gets the prefix that the axis' numbers want.

    Which one is known only when the figure is laid out: axes that share their scale may still grow.
    """

    def __init__(self, label: Any, unit: str) -> None:
        self._label, self._text = label, label.get_text()
        self.unit = unit
        self.power: int | None = None  # of the page; by default the axis' own

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
        self._label.set_text(UNIT.sub(f"[{unit_with(power, self.unit)}]", self._text))
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
            _write_out(axis)
        found = UNIT.search(axis.label.get_text())
        if found and isinstance(axis.get_major_formatter(), ScalarFormatter) and axis.get_scale() == "linear":
            axis.set_major_formatter(Prefixed(axis.label, found.group(1)))


def _write_out(axis: Any) -> None:
    """Numbers of a logarithmic axis in full, 1.4 and not 1.4 x 10^0, where it spans less than two decades near 1.

    Beyond `MOST_DECADES` it has no marks within decades: they run together, and take most of a figure's time.
    """
    low, high = axis.get_view_interval()
    if high > 10.0**MOST_DECADES * low:
        axis.set_minor_locator(NullLocator())
    if low >= 1e-3 and high <= 1e4 and high < 100.0 * low:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        # Between 3 and 10 times the lowest, 6 to 9 stand too near one another.
        written = "23456789" if high < 3.0 * low else "235"
        few = FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in written else "")
        axis.set_minor_formatter(few if high < 10.0 * low else NullFormatter())
