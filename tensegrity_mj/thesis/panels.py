"""Figures that are panels of curves over time, as `tables/figures.toml` has them, drawn of the rows' own expressions.

A figure's `panels` are rows of panels. A panel has `title`, `unit` (of what is drawn), `curves`, and where they apply
`of` (which of the figure's runs, from 0), `band` (the range of the thesis' axis) and `log`; one with `like` has the
rest from the table `[panels]` under that name. A curve has `y`, an expression of the run a, see `expression`, and where
they apply `of`, `colors` (of `NAMED`), `labels`, `marks` (false: the second engine is not drawn) and Matplotlib's `ls`
and `lw`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.pictures import palette
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis import drawing
from tensegrity_mj.thesis.drawing import NAMED, AllRuns, Figure
from tensegrity_mj.thesis.expression import evaluate
from tensegrity_mj.thesis.lookup import all_measures

Values = Mapping[str, Any]


def panels_of_curves(
    all_runs: AllRuns,
    names: Sequence[str],
    panels: Sequence[Sequence[Values]],
    note: str = drawing.BAND,
    height: float = drawing.PANEL[1],
) -> Figure:
    """A figure of such panels.

    Args:
        names: of its runs.
        note: below the panels, besides the engines.
        height: of a panel [inches].
    """
    figure, grid = drawing.panels(len(panels), len(panels[0]), height)
    for panel, values in zip(grid.ravel(), chain.from_iterable(panels), strict=True):
        for curve in values["curves"]:
            _draw(panel, all_runs, names[curve.get("of", values.get("of", 0))], curve)
        if "band" in values:
            drawing.thesis_axis(panel, *values["band"])
        if values.get("log"):
            panel.set_yscale("log")
        drawing.finish(panel, values["title"], values["unit"])
    drawing.engines_note(figure, all_runs, note)
    return figure


def _draw(panel: Any, all_runs: AllRuns, name: str, curve: Values) -> None:
    """One curve, or as many as its expression has columns."""

    def found(run: Trajectory) -> Array:
        values: Array = evaluate(curve["y"], all_measures(), [run])
        return values

    how = {key: value for key, value in curve.items() if key not in ("y", "of", "colors")}
    drawing.curves(
        panel, all_runs, name, found, [NAMED[one] for one in curve.get("colors", ())] or palette.CYCLE, **how
    )
