"""Figures that are panels of curves, as `tables/figures.toml` has them, drawn of the rows' own expressions.

A figure's `panels` are rows of panels. A panel has `title`, `unit` (of what is drawn), `curves`, and where they apply
`of` (which of the figure's runs, from 0), `x` (an expression of what curves are over in place of time) and `over` (its
label), `xlim`, `ylim` (or its lower end alone), `band` (the range of the thesis' axis), `log`, and `beyond`: an
expression of where what `beyond_text` says begins. One with `like` has the rest from the table `[panels]` under that
name. A curve has `y`, an expression of the run a, see `expression`, and where they apply `of`, `x`, `colors` (of
`NAMED`), `labels`, `marks` (false: the second engine is not drawn) and Matplotlib's own for lines, such as `marker`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

from evidence.thesis import drawing
from evidence.thesis.drawing import NAMED, AllRuns, Figure
from evidence.thesis.expression import evaluate
from evidence.thesis.lookup import all_measures
from tensegrity_mj.pictures import palette

Values = Mapping[str, Any]


def panels_of_curves(
    all_runs: AllRuns,
    names: Sequence[str],
    panels: Sequence[Sequence[Values]],
    note: str = drawing.BAND,
    height: float = drawing.PANEL[1],
    width: float = drawing.PANEL[0],
) -> Figure:
    """A figure of such panels.

    Args:
        names: of its runs.
        note: below the panels, in addition to the engines that have one of the runs.
        height, width: of a panel [inches].
    """
    figure, grid = drawing.panels(len(panels), len(panels[0]), height, width)
    for panel, values in zip(grid.ravel(), chain.from_iterable(panels), strict=True):
        for curve in values["curves"]:
            own = {key: values[key] for key in ("of", "x") if key in values} | curve
            _draw(panel, all_runs, names[own.get("of", 0)], own)
        if "band" in values:
            drawing.thesis_axis(panel, *values["band"])
        if values.get("log"):
            panel.set_yscale("log")
        if "xlim" in values:
            panel.set_xlim(*values["xlim"])
        drawing.finish(panel, values["title"], values["unit"], values.get("over", drawing.TIME))
        if "ylim" in values:
            panel.set_ylim(*values["ylim"])
        if "beyond" in values:
            _shade(panel, _value(values["beyond"], drawing.first_of(all_runs, names[0])), values["beyond_text"])
    drawing.engines_note(figure, all_runs, note, names)
    return figure


def _value(text: str, run: Any) -> Any:
    return evaluate(text, all_measures(), [run])


def _draw(panel: Any, all_runs: AllRuns, name: str, curve: Values) -> None:
    """Draw one curve, or as many as its expression has columns."""
    how = {key: value for key, value in curve.items() if key not in ("y", "x", "of", "colors")}
    if "x" in curve:
        how["over"] = partial(_value, curve["x"])
    colors = [NAMED[one] for one in curve.get("colors", ())] or palette.CYCLE
    drawing.curves(panel, all_runs, name, partial(_value, curve["y"]), colors, **how)


def _shade(panel: Any, start: float, text: str) -> None:
    """Say of all that is beyond a place what it is; NaN for nothing."""
    if not math.isnan(start):
        panel.axvspan(start, panel.get_xlim()[1], color=drawing.RED, alpha=0.08, lw=0)
        panel.text(0.97, 0.06, text, transform=panel.transAxes, ha="right", fontsize=8, color=drawing.RED)
