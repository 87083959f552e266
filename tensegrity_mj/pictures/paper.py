"""Figures for papers of two columns: the width of a column or of the page, the fonts and lines that journals want.

    with tmj.pictures.plots.paper(columns=1):
        tmj.pictures.plots.plot_run(run, "prism.pdf")

All figures made in such a block are 88 mm or 181 mm wide, with letters of 7 to 9 points like those of the text around
them, and 600 dots an inch where they are written as pixels.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTHS = {1: 88.0 / 25.4, 2: 181.0 / 25.4}  # inches, of one column and of both
DPI = 600
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


_PAPER: ContextVar[Paper | None] = ContextVar("paper", default=None)


@contextlib.contextmanager
def paper(columns: int = 2) -> Iterator[None]:
    """Make all figures within for papers: as wide as one column, panels below one another, or as both.

    Raises:
        OptionError: another number of columns.
    """
    before = _PAPER.set(Paper(columns))
    try:
        yield
    finally:
        _PAPER.reset(before)


def chosen() -> Paper | None:
    """Return the paper that figures are made for now; None for the screen."""
    return _PAPER.get()
