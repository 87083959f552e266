"""Figures of the study, from its data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import COLUMN, common_legend, frame, grid_of_panels
from tensegrity_mj.studies.engine_names import NAMES, TITLES
from tensegrity_mj.studies.stability.cases import AXES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Data = Mapping[str, Any]


COLORS = dict(zip(NAMES, palette.CYCLE, strict=True))
MARKERS = dict(zip(NAMES, "osD^vPX", strict=True))
WITH_ZERO = ("damping", "prestress")


def pictures(data: Data) -> dict[str, tuple[Figure, str]]:
    """All figures that the data has, by name, with their captions."""
    found = {}
    if data.get("maps") and _mapped(data):
        found["maps"] = (
            maps(data),
            "Lines: predicted. Marks: measured. The largest stable step over 2/ω of each structure. A line without "
            "marks: stable at all steps that were tried, up to 300 of 2/ω for discrete and 100 for the others.",
        )
        found["heat"] = (heat(data), "The predicted limit over 2/ω of every engine and map, as a colour.")
    if data.get("random") and any(row["values"] for row in data["random"]["rows"]):
        found["random"] = (
            scatter(data),
            "Random taut structures: predicted against measured limits, and their differences.",
        )
    return found


def maps(data: Data) -> Figure:
    """A panel an axis: predicted lines and measured marks over the property varied."""
    axes = _mapped(data)
    figure, panels = grid_of_panels(len(axes), 3, 1.15 * COLUMN, 0.95 * COLUMN, 0.4)
    for panel, axis in zip(panels, axes, strict=True):
        rows = [row for row in data["maps"] if row["axis"] == axis and row["values"] is not None]
        for order, name in enumerate(_engines(data)):
            # The first ones broader: limits that coincide stay visible.
            _line(panel, axis, rows, name, 4.0 - 0.9 * min(order, 3))
        frame(panel, "", AXES[axis][0], "limit / (2/ω)", legend=False)
    common_legend(figure, panels)
    return figure


def _mapped(data: Data) -> list[str]:
    """The axes that have points with values."""
    return [axis for axis in AXES if any(row["axis"] == axis and row["values"] is not None for row in data["maps"])]


def _engines(data: Data) -> list[str]:
    """Those that some point of the maps has."""
    return [name for name in NAMES if any(row["values"] and name in row["values"]["engines"] for row in data["maps"])]


def _over(rows: Sequence[Data], name: str, key: str) -> Array:
    """(T,) limits of an engine over 2/ω: ∞ for none, NaN in rows that do not have the engine."""
    found = []
    for row in rows:
        one = row["values"]["engines"].get(name) if row["values"] else None
        found.append(math.nan if one is None else math.inf if one[key] is None else one[key] * one["omega"] / 2)
    return np.array(found)


def _line(panel: Axes, axis: str, rows: Any, name: str, width: float) -> None:
    x = np.array([row["value"] for row in rows])
    color = COLORS[name]
    panel.plot(x, _over(rows, name, "predicted"), color=color, lw=width, alpha=0.75, label=TITLES[name])
    panel.plot(x, _over(rows, name, "measured"), MARKERS[name], color=color, ms=3 + width, mfc="none", mew=1.2)
    if axis in WITH_ZERO and x.max() > 0:
        panel.set_xscale("symlog", linthresh=x[x > 0].min())
    else:
        panel.set_xscale("log")
    panel.set_yscale("log")


def heat(data: Data) -> Figure:
    """A panel an axis: engines down, values across, the predicted limit over 2/ω as a colour."""
    from matplotlib.colors import LogNorm

    axes, names = _mapped(data), _engines(data)
    figure, panels = grid_of_panels(len(axes), 3, 1.15 * COLUMN, 0.62 * COLUMN, 0.3)
    image = None
    for panel, axis in zip(panels, axes, strict=True):
        rows = [row for row in data["maps"] if row["axis"] == axis and row["values"] is not None]
        table = np.array([_over(rows, name, "predicted") for name in names])
        image = panel.imshow(np.minimum(table, 300.0), aspect="auto", norm=LogNorm(0.01, 300.0), cmap="cividis")
        panel.set_yticks(range(len(names)), [TITLES[name] for name in names], fontsize=7)
        every = max(1, len(rows) // 5)
        ticks = list(range(0, len(rows), every))
        panel.set_xticks(ticks, [_written(rows[k]["value"]) for k in ticks], fontsize=7)
        panel.set_xlabel(AXES[axis][0], fontsize=8)
    if image is not None:
        bar = figure.colorbar(image, ax=panels.tolist(), shrink=0.8)
        bar.set_label("limit / (2/ω), 300 and none alike", fontsize=8)
    return figure


def _written(value: float) -> str:
    """A number in full, 500, or as a power of ten where that is long."""
    if value == 0.0 or 1e-3 < abs(value) < 1e4:
        return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
    factor, power = f"{value:.1e}".split("e")
    times = "" if float(factor) == 1.0 else rf"{float(factor):g} \cdot "
    return f"${times}10^{{{int(power)}}}$"


def scatter(data: Data) -> Figure:
    """Predicted against measured, and the distribution of their differences."""
    figure, (left, right) = grid_of_panels(2, 2, 1.2 * COLUMN, 1.05 * COLUMN, 0.4)
    rows, allowed = data["random"]["rows"], data["random"]["summary"]["allowed"]
    for name in data["engines"]:
        x, y = (_over(rows, name, key) for key in ("measured", "predicted"))
        known = np.isfinite(x) & np.isfinite(y)
        left.loglog(x[known], y[known], MARKERS[name], color=COLORS[name], ms=4, mfc="none", label=TITLES[name])
        parts = np.sort(np.abs(y[known] / x[known] - 1))
        if len(parts):
            share = (np.arange(len(parts)) + 1) / len(parts)
            right.step(np.maximum(parts, 1e-5), share, where="post", color=COLORS[name], lw=1.3, label=TITLES[name])
    span = left.get_xlim()
    left.plot(span, span, color=palette.GUIDE, lw=0.8, zorder=0)
    right.axvline(allowed, color=palette.WARNING, lw=0.9, ls="--", label="largest difference allowed")
    right.set_xscale("log")
    frame(left, "", "measured limit / (2/ω)", "predicted limit / (2/ω)", legend=False)
    frame(right, "", "|predicted / measured - 1|", "part of the structures", legend=False)
    common_legend(figure, (left, right), 4, 7.5)
    return figure
