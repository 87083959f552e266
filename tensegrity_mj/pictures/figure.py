"""The one frame of all figures: how they are made, labelled, scaled and written.

Figures are made without pyplot: nothing global is touched, no window opens, and they can be made in any thread.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.pictures import palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PathLike = str | os.PathLike[str]

SUFFIXES = (".png", ".pdf", ".svg")
DPI = 130
ROW, COLUMN = 2.5, 3.9  # inches, a panel
MAX_LEGEND = 8  # entries
RUN_STYLES = ("-", "--", ":", "-.")
GREY = (0.45, 0.47, 0.5)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as MatplotlibFigure

    figure = MatplotlibFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def grid_of_panels(count: int, columns: int, width: float, height: float, room: float = 0.0) -> tuple[Figure, Any]:
    """A figure with `count` panels of that size [inches] in rows of at most `columns`, and `room` below; the panels."""
    columns = min(columns, count)
    rows = -(-count // columns)
    figure = new_figure(columns * width, rows * height + room)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[count:]:
        panel.set_visible(False)
    return figure, panels[:count]


def frame(panel: Axes, title: str = "", x: str = "", y: str = "", *, legend: bool = True, small: float = 0.0) -> None:
    """Title, axes, grid and legend (where there are handles) in one style; `small`: points less for all texts."""
    if title:
        panel.set_title(title, fontsize=10 - small)
    if x:
        panel.set_xlabel(x, fontsize=9 - small)
    if y:
        panel.set_ylabel(y, fontsize=9 - small)
    panel.grid(True, color=palette.GRID, lw=0.7)
    panel.set_axisbelow(True)
    panel.tick_params(labelsize=8 - small, color=GREY)
    for side in panel.spines.values():
        side.set_color(GREY)
        side.set_linewidth(0.7)
    handles, labels = panel.get_legend_handles_labels()
    if handles and legend:
        columns = 2 if len(handles) > 4 else 1
        panel.legend(handles, labels, fontsize=7.5 - small, framealpha=0.75, edgecolor="none", ncols=columns)


def common_legend(figure: Figure, panels: Iterable[Axes]) -> None:
    """One legend below the panels, each label once."""
    used: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            used.setdefault(label, handle)
    figure.legend(used.values(), used.keys(), loc="outside lower center", ncols=len(used), fontsize=8, frameon=False)


def note(panel: Axes, text: str) -> None:
    """A text in the middle of a panel that has nothing to show."""
    panel.text(0.5, 0.5, text, transform=panel.transAxes, ha="center", va="center", color=GREY, fontsize=9)


def equal_scales(axes: Any, points: Array) -> None:
    """The same scale on all three axes round points (n, 3) [m], with nothing cut off."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.max(high - low)) or 1.0
    half = np.maximum(0.5 * (high - low), 0.15 * size) * 1.05
    middle = 0.5 * (low + high)
    for name, m, h in zip("xyz", middle, half, strict=True):
        getattr(axes, f"set_{name}lim")(m - h, m + h)
        getattr(axes, f"set_{name}label")(f"{name} [m]", fontsize=9)
    axes.set_box_aspect(half)
    axes.tick_params(labelsize=7)
    axes.view_init(elev=22.0, azim=-55.0)


def line_style(number: int) -> str:
    """The style of the run of that number; curves that coincide stay visible."""
    return RUN_STYLES[number % len(RUN_STYLES)]


def save_figure(figure: Figure, path: PathLike) -> Path:
    """Write a figure as .png, .pdf or .svg, as a whole or not at all; returns the path.

    Raises:
        OptionError: a path that cannot be written.
    """
    destination = checked(path, SUFFIXES, "plot")
    with replacing(destination) as part:
        # Without dates the same figure gives the same file.
        metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(destination.suffix.lower(), {})
        figure.savefig(part, dpi=DPI, metadata=metadata)
    return destination


def saved(figure: Figure, path: PathLike | None) -> Figure:
    """The figure, written where a path is given."""
    if path is not None:
        save_figure(figure, path)
    return figure
