"""Figures of a sweep: a measure against one parameter, or over two."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import COLUMN, GREY, MAX_LEGEND, frame, line_style, new_figure
from tensegrity_mj.pictures.page import Picture
from tensegrity_mj.studies.measures import MEASURES
from tensegrity_mj.studies.table import Row, as_number, measure_label, parameter_label, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDE = 100.0  # ratio of the largest to the smallest value beyond which a scale is logarithmic


def figures(
    rows: Sequence[Row], axes: Sequence[str], drawn: Sequence[str], measures: Sequence[str]
) -> Iterator[Picture]:
    """A figure for every measure that is a number somewhere.

    Args:
        axes: parameters that take several values, one of each that go together.
        drawn: parameters that are drawn.

    With one axis of numbers it is a line over it, with two a map; where only draws vary, dots over the first few.
    """
    numeric = [name for name in axes if _is_numeric(rows, name)]
    other = [name for name in axes if name not in numeric]
    for measure in measures:
        if not any(as_number(row.values.get(measure)) is not None for row in rows):
            continue
        if len(numeric) == 2:
            yield Picture(_maps(rows, numeric, other, measure), _caption(measure, numeric))
        elif numeric:
            yield Picture(_lines(rows, numeric[0], [*numeric[1:], *other], measure), _caption(measure, numeric[:1]))
        else:
            over = [name for name in drawn if _is_numeric(rows, name)][:3]
            if over:
                yield Picture(_dots(rows, over, other, measure), _caption(measure, over))


def _caption(measure: str, over: Sequence[str]) -> str:
    names = " and ".join(parameter_label(name) for name in over)
    return f"{MEASURES[measure].meaning[0].upper()}{MEASURES[measure].meaning[1:]} against {names}"


def _lines(rows: Sequence[Row], name: str, other: Sequence[str], measure: str) -> Figure:
    """The measure over one parameter, a line for each combination of the others: the median of its samples."""
    figure = new_figure(2.2 * COLUMN, 1.15 * COLUMN)
    panel = figure.subplots()
    groups = _grouped(rows, other)
    for number, (label, members) in enumerate(groups.items()):
        x, y = _numbers(members, name, measure)
        color = palette.color_of(number)
        places = np.unique(x)
        middle = [float(np.median(y[x == place])) for place in places]
        style = line_style(number)  # lines that coincide stay visible
        panel.plot(places, middle, color=color, ls=style, lw=1.4, marker="o", ms=4, label=figure_text(label) or None)
        if len(x) > len(places):
            panel.plot(x, y, color=color, lw=0, marker=".", ms=3, alpha=0.5)
    _scales(panel)
    frame(panel, "", _axis(rows, name), measure_label(measure), legend=1 < len(groups) <= MAX_LEGEND)
    return figure


def _dots(rows: Sequence[Row], over: Sequence[str], other: Sequence[str], measure: str) -> Figure:
    """The measure over each drawn parameter."""
    figure = new_figure(max(1.6, len(over)) * COLUMN, COLUMN)
    panels = np.atleast_1d(figure.subplots(1, len(over), sharey=True))
    groups = _grouped(rows, other)
    for panel, name in zip(panels, over, strict=True):
        for number, (label, members) in enumerate(groups.items()):
            x, y = _numbers(members, name, measure)
            color = palette.color_of(number)
            panel.plot(x, y, color=color, lw=0, marker="o", ms=4, alpha=0.8, label=figure_text(label) or None)
        _scales(panel)
        unit = measure_label(measure) if panel is panels[0] else ""
        frame(panel, "", _axis(rows, name), unit, legend=1 < len(groups) <= MAX_LEGEND)
    return figure


def _maps(rows: Sequence[Row], names: Sequence[str], other: Sequence[str], measure: str) -> Figure:
    """The measure over two parameters, a map for each combination of the others (at most four): medians of samples."""
    groups = list(_grouped(rows, other).items())[:4]
    figure = new_figure(max(1.5, 1.35 * len(groups)) * COLUMN, 1.15 * COLUMN)
    panels = np.atleast_1d(figure.subplots(1, len(groups)))
    places = [np.unique([as_number(row.parameters[name]) for row in rows]) for name in names]
    cells = []
    for _, members in groups:
        (x, values), (y, _) = (_numbers(members, name, measure) for name in names)
        found = [[values[(x == across) & (y == up)] for across in places[0]] for up in places[1]]
        cells.append(np.array([[np.median(one) if len(one) else np.nan for one in line] for line in found]))
    everything = np.concatenate([cell[np.isfinite(cell)] for cell in cells])
    from matplotlib.colors import LogNorm, Normalize

    low, high = (float(everything.min()), float(everything.max())) if everything.size else (0.0, 1.0)
    norm = LogNorm(low, high) if low > 0 and high > WIDE * low else Normalize(low, high)
    mesh: Any = None
    for number, (label, _) in enumerate(groups):
        panel = panels[number]
        mesh = panel.imshow(cells[number], origin="lower", aspect="auto", cmap="viridis", norm=norm)
        for axis, values in zip((panel.xaxis, panel.yaxis), places, strict=True):
            marked = np.unique(np.linspace(0, len(values) - 1, min(len(values), 9)).astype(int))
            axis.set_ticks(marked, [f"{values[i]:.4g}" for i in marked])
        panel.set_xlabel(_axis(rows, names[0]), fontsize=9)
        panel.set_ylabel(_axis(rows, names[1]) if number == 0 else "", fontsize=9)
        panel.set_title(figure_text(label), fontsize=9)
        panel.tick_params(labelsize=8, color=GREY)
    bar = figure.colorbar(mesh, ax=list(panels))
    bar.set_label(measure_label(measure), fontsize=9)
    bar.ax.tick_params(labelsize=8)
    return figure


def _is_numeric(rows: Sequence[Row], name: str) -> bool:
    return all(as_number(row.parameters.get(name)) is not None for row in rows)


def _numbers(rows: Sequence[Row], name: str, measure: str) -> tuple[Any, Any]:
    pairs = [(as_number(row.parameters[name]), as_number(row.values.get(measure))) for row in rows]
    known = [(x, y) for x, y in pairs if x is not None and y is not None and math.isfinite(y)]
    return np.array([x for x, _ in known], float), np.array([y for _, y in known], float)


def _grouped(rows: Sequence[Row], names: Sequence[str]) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        label = ", ".join(f"{parameter_label(name)} = {shown(row.parameters[name])}" for name in names)
        groups.setdefault(label, []).append(row)
    return groups


def _axis(rows: Sequence[Row], name: str) -> str:
    scaled = any(str(row.parameters[name]).startswith("*") for row in rows)
    return figure_text(parameter_label(name)) + (" (factor)" if scaled else "")


def _scales(panel: Axes) -> None:
    """Logarithmic where the numbers span much."""
    for index, axis in enumerate("xy"):
        lines = [np.asarray(line.get_data()[index], float) for line in panel.get_lines()]
        values = np.concatenate(lines) if lines else np.array([])
        if values.size and values.min() > 0 and values.max() > WIDE * values.min():
            getattr(panel, f"set_{axis}scale")("log")
