"""The one frame of all figures: how they are made, labelled, scaled, dressed for papers and written.

Figures are made without pyplot: nothing global is touched, no window opens, and they can be made in any thread.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures import palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:
    Axes = Figure = Any  # in annotations of all that draw, which need no matplotlib

PathLike = str | os.PathLike[str]

SUFFIXES = (".png", ".pdf", ".svg")
DPI = 130
ROW, COLUMN = 2.5, 3.9  # inches, a panel
MAX_LEGEND = 8  # entries
BELOW = 33.0  # points, from a panel to the legend below its ticks and label
RUN_STYLES = ("-", "--", ":", "-.")
ZOOM = 1.15  # of a box in space, which matplotlib draws small
GREY = (0.45, 0.47, 0.5)


WIDTHS = {1: 88.0 / 25.4, 2: 181.0 / 25.4}  # inches, of one column and of both
PAPER_DPI = 600
FONTS = ["STIXGeneral", "DejaVu Sans"]  # like Times; matplotlib brings both
SMALLEST, LARGEST = 7.0, 9.0  # points
SHRINK = 0.8  # of a letter on the screen
THINNER = 0.75
TALLER = 1.15  # letters shrink less than panels


@dataclass(frozen=True)
class Paper:
    """A figure as wide as so many columns of a page, 1 or 2."""

    columns: int = 2

    def __post_init__(self) -> None:
        if self.columns not in WIDTHS or isinstance(self.columns, bool):
            raise OptionError(f"paper: columns={self.columns!r}; it must be 1 (88 mm) or 2 (181 mm)")

    def fit(self, width: float, height: float) -> tuple[float, float]:
        """The size [inches] of a figure that has this size on the screen."""
        return WIDTHS[self.columns], height * TALLER * WIDTHS[self.columns] / width

    def dress(self, figure: Figure) -> None:
        """Set fonts and lines of a finished figure; a second time changes nothing."""
        from matplotlib.lines import Line2D
        from matplotlib.text import Text

        if getattr(figure, "_in_paper", False):
            return
        figure._in_paper = True  # type: ignore[attr-defined]
        for text in figure.findobj(Text):
            text.set_fontfamily(FONTS)
            text.set_math_fontfamily("stix")
            text.set_fontsize(min(LARGEST, max(SMALLEST, SHRINK * float(text.get_fontsize()))))
        for line in figure.findobj(Line2D):
            line.set_linewidth(THINNER * line.get_linewidth())
            line.set_markersize(THINNER * line.get_markersize())
        for panel in figure.findobj(lambda artist: hasattr(artist, "tick_params")):
            panel.tick_params(labelsize=SMALLEST, labelfontfamily=FONTS, width=0.5, length=2.5)  # type: ignore[attr-defined]
            panel.tick_params(which="minor", labelsize=SMALLEST, labelfontfamily=FONTS)  # type: ignore[attr-defined]


_PAPER: ContextVar[Paper | None] = ContextVar("paper", default=None)  # that figures are made for; None: the screen


@contextlib.contextmanager
def paper(columns: int = 2) -> Iterator[None]:
    """Make all figures within for papers: as wide as one column, panels below one another, or as both.

    They are 88 mm or 181 mm wide, with letters of 7 to 9 points like those of the text around them, and 600 dots an
    inch where they are written as pixels.

        with tmj.pictures.plots.paper(columns=1):
            tmj.pictures.plots.plot_run(run, "prism.pdf")

    Raises:
        OptionError: another number of columns.
    """
    before = _PAPER.set(Paper(columns))
    try:
        yield
    finally:
        _PAPER.reset(before)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches; of the width of a paper's columns within `paper`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as MatplotlibFigure

    wanted = _PAPER.get()
    size = (width, height) if wanted is None else wanted.fit(width, height)

    class Canvas(FigureCanvasAgg):
        """Canvas that is not drawn before it is written: axes that share a scale in subfigures need not redraw all."""

        def draw_idle(self, *_: Any, **__: Any) -> None:
            """Do not draw."""

    class Shown(MatplotlibFigure):
        """A figure that a notebook shows: those of pyplot alone it would know."""

        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            print_png(self, stream, DPI)
            return stream.getvalue()

    figure = Shown(figsize=size, layout="constrained")
    Canvas(figure)
    return figure


def grid_of_panels(count: int, columns: int, width: float, height: float, room: float = 0.0) -> tuple[Figure, Any]:
    """A figure with `count` panels of that size [inches] in rows of at most `columns`, and `room` below; the panels."""
    columns = min(panels_in_a_row(columns), count)
    rows = -(-count // columns)
    figure = new_figure(columns * width, rows * height + room)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[count:]:
        panel.set_visible(False)
    return figure, panels[:count]


def panels_in_a_row(columns: int) -> int:
    """Return the number of panels in a row: one in a paper's column."""
    wanted = _PAPER.get()
    return columns if wanted is None or wanted.columns == 2 else 1


def frame(
    panel: Axes,
    title: str = "",
    x: str = "",
    y: str = "",
    *,
    legend: bool = True,
    small: float = 0.0,
) -> None:
    """Title, axes, grid and, below the panel where it hides no curve, the legend (where there are handles).

    Args:
        x, y: the axes' labels; the unit at the end, in brackets, gets the prefix that the numbers want.
        small: points less for all texts.
    """
    from tensegrity_mj.pictures.ticks import prefix_ticks

    if title:
        panel.set_title(title, fontsize=10 - small)
    if x:
        panel.set_xlabel(x, fontsize=9 - small)
    if y:
        panel.set_ylabel(y, fontsize=9 - small)
    prefix_ticks(panel)
    panel.grid(True, color=palette.GRID, lw=0.7)
    panel.set_axisbelow(True)
    panel.tick_params(which="both", labelsize=8 - small, color=GREY)
    for side in panel.spines.values():
        side.set_color(GREY)
        side.set_linewidth(0.7)
    handles, labels = panel.get_legend_handles_labels()
    if handles and legend:
        _legend_below(panel, handles, labels, 7.5 - small)


def _legend_below(panel: Axes, handles: list[Any], labels: list[str], size: float) -> None:
    """A legend under the panel's axis and its label, in as many columns as have room."""
    from matplotlib.transforms import ScaledTranslation

    figure: Any = panel.figure
    place = panel.get_subplotspec()
    width = figure.bbox.width / figure.dpi / (place.get_geometry()[1] if place else 1)
    longest = max(5 if label.startswith("$") else len(label) for label in labels)  # a formula is short
    smaller = 1.0 if _PAPER.get() is None else SHRINK
    letters = 72.0 * width / (0.56 * max(smaller * size, SMALLEST))
    columns = max(1, min(4, len(handles), int(letters / (6 + longest))))
    below = panel.transAxes + ScaledTranslation(0.0, -smaller * BELOW / 72.0, figure.dpi_scale_trans)
    look: dict[str, Any] = {"frameon": False, "ncols": columns, "columnspacing": 1.2, "borderaxespad": 0.0}
    look |= {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "bbox_transform": below}
    panel.legend(handles, labels, fontsize=size, **look)


def common_legend(figure: Figure, panels: Iterable[Axes], most: int = 99, size: float = 8.0) -> None:
    """One legend below the panels, each label once, at most so many in a row, in letters of that size."""
    used: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            used.setdefault(label, handle)
    look: dict[str, Any] = {"ncols": min(most, len(used)), "fontsize": size, "frameon": False}
    if used:
        figure.legend(used.values(), used.keys(), loc="outside lower center", **look)


def note(panel: Axes, text: str) -> None:
    """A text in the middle of a panel that has nothing to show."""
    panel.text(0.5, 0.5, text, transform=panel.transAxes, ha="center", va="center", color=GREY, fontsize=9)


def equal_scales(axes: Any, points: Array) -> None:
    """Set the same scale on all three axes round points (n, 3) [m], with nothing cut off."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.max(high - low)) or 1.0
    half = np.maximum(0.5 * (high - low), 0.15 * size) * 1.05
    middle = 0.5 * (low + high)
    from matplotlib.ticker import MaxNLocator

    for name, m, h in zip("xyz", middle, half, strict=True):
        getattr(axes, f"set_{name}lim")(m - h, m + h)
        getattr(axes, f"set_{name}label")(f"{name} [m]", fontsize=9)
        # A short axis has room for few numbers.
        getattr(axes, f"{name}axis").set_major_locator(
            MaxNLocator(max(1, round(6 * h / float(half.max()))), steps=[1, 2, 5, 10])
        )
    axes.set_box_aspect(half, zoom=ZOOM)
    axes.tick_params(labelsize=7)
    axes.view_init(elev=22.0, azim=-55.0)


def line_style(number: int) -> str:
    """The style of the run of that number; curves that coincide stay visible."""
    return RUN_STYLES[number % len(RUN_STYLES)]


def save_figure(figure: Figure, path: PathLike, dpi: float | None = None) -> Path:
    """Write a figure as .png, .pdf or .svg, as a whole or not at all; returns the path.

    Args:
        dpi: dots an inch; by default what the screen, or a paper, wants.

    Raises:
        OptionError: a path that cannot be written.
    """
    from matplotlib import rc_context

    destination = checked(path, SUFFIXES, "plot")
    with replacing(destination) as part:
        # Without dates the same figure gives the same file.
        metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(destination.suffix.lower(), {})
        wanted = _PAPER.get()
        if wanted is not None:
            wanted.dress(figure)
        dpi = dpi or (DPI if wanted is None else PAPER_DPI)
        if destination.suffix.lower() == ".png":
            print_png(figure, part, dpi)
            return destination
        with rc_context({"pdf.fonttype": 42}):  # TrueType, the kind that journals want
            figure.savefig(part, dpi=dpi, metadata=metadata)
    return destination


def print_png(figure: Figure, to: PathLike | io.BytesIO, dpi: float) -> None:
    """Write pixels as `Figure.savefig` does, which draws a figure with a layout twice, if its canvas can."""
    if not hasattr(figure.canvas, "print_png"):
        figure.savefig(to, format="png", dpi=dpi)
        return
    before, figure.dpi = figure.dpi, dpi
    try:
        figure.canvas.print_png(to)
    finally:
        figure.dpi = before


def saved(figure: Figure, path: PathLike | None) -> Figure:
    """The figure, written where a path is given."""
    if path is not None:
        save_figure(figure, path)
    return figure
