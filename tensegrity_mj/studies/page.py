"""One HTML page about a sweep: plots, every point, and what was held fixed; all in the one file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import COLUMN, GREY, MAX_LEGEND, Figure, frame, line_style, new_figure
from tensegrity_mj.pictures.findings import Finding, Judgement, Mark, mark_of
from tensegrity_mj.pictures.page import PathLike, Picture, Table, pictures_and_tables
from tensegrity_mj.studies import sweep as sweeps
from tensegrity_mj.studies.many import Study
from tensegrity_mj.studies.report import Page
from tensegrity_mj.studies.sweep import MEASURES, Row, Sweep, as_number, counts, measure_label, parameter_label, shown

MOST_ROWS = 1000
LONG = 12  # rows beyond which the table is folded
WIDE = 100.0  # ratio of the largest to the smallest value beyond which a scale is logarithmic


def write_sweep_page(path: PathLike, sweep: Sweep, study: Study, measures: Sequence[str] = sweeps.USUAL) -> Path:
    """Write the page of a finished sweep; returns its path.

    Args:
        measures: which to plot and to list.

    Raises:
        OptionError: a measure that there is not, a path that cannot be written.
    """
    wanted = sweeps.check_measures(measures)
    scene, rows = cast(Scene, sweep.scene), sweeps.rows_of(study)
    measures = [name for name in wanted if any(row.values.get(name) is not None for row in rows)]
    several = [axis.axes[0] for axis in sweep.axes]
    axes = [axis.parameter for axis in several if len(axis.values) > 1]
    drawn = [draw.parameter for draw in sweep.draws]
    lines: list[list[object]] = [
        [
            number,
            *(shown(row.parameters[name]) for name in sweep.parameters),
            row.status,
            *(row.values.get(name) for name in measures),
            row.reason,
        ]
        for number, row in enumerate(rows[:MOST_ROWS])
    ]
    heads = ["", *map(parameter_label, sweep.parameters), "status", *map(measure_label, measures), "reason"]
    note = (
        f"The first {MOST_ROWS} of {len(rows)} points; the others are in result.json." if len(rows) > MOST_ROWS else ""
    )
    if without := ", ".join(measure_label(name) for name in wanted if name not in measures):
        note = f"{note} No point has a value of: {without}.".strip()
    meanings = [[name, MEASURES[name].meaning, MEASURES[name].unit] for name in wanted]
    tables = [
        Table("Points", heads, lines, note, folded=len(lines) > LONG),
        Table("Measures", ["measure", "meaning", "unit"], meanings, folded=True),
        Table("Settings held fixed", ["", ""], _fixed(sweep, study), folded=True),
    ]
    sections = pictures_and_tables(figures(rows, axes, drawn, measures), tables)
    return Page(f"Sweep of {scene.name}", scene.source, judgement_of(sweep, study, measures), sections).write(path)


def judgement_of(sweep: Sweep, study: Study, measures: Sequence[str] = sweeps.USUAL) -> Judgement:
    """The verdict and the findings of a finished sweep."""
    rows, several = sweeps.rows_of(study), [axis.axes[0] for axis in sweep.axes]
    return Judgement(_verdict(cast(Scene, sweep.scene).name, rows), tuple(_findings(rows, several, measures)))


def _verdict(name: str, rows: Sequence[Row]) -> str:
    """Return a sentence on how the points ended."""
    ended = counts(rows)
    done = ended.get("completed", 0)
    if done == len(rows):
        return f"All {len(rows)} points of {name} completed without a doubt."
    others = ", ".join(f"{count} {status}" for status, count in ended.items() if status != "completed")
    return f"{done} of {len(rows)} points of {name} completed without a doubt; {others}."


def _findings(rows: Sequence[Row], axes: Sequence[Any], measures: Sequence[str]) -> Iterator[Finding]:
    """Yield findings on how points ended, and on the range of each measure with the points at its ends."""
    done = counts(rows).get("completed", 0)
    if done < len(rows):
        reason = next((row.reason for row in rows if row.reason), "")
        left = len(rows) - done
        text = f"{left} point{'s' * (left > 1)} ended early or {'are' if left > 1 else 'is'} in doubt"
        text += f", {'the first' if left > 1 else 'by'}: {reason or 'see the table'}."
        yield Finding(mark_of(done, len(rows)), text)
    names = [axis.parameter for axis in axes]
    for measure in measures:
        found = [(value, row) for row in rows if (value := as_number(row.values.get(measure))) is not None]
        found = [(value, row) for value, row in found if math.isfinite(value)]
        if len(found) < 2:
            continue
        ends = [min(found, key=lambda one: one[0]), max(found, key=lambda one: one[0])]
        unit, head = MEASURES[measure].unit, measure.replace("_", " ").capitalize()
        low, high = (quantity(value, "" if unit.startswith("as ") else unit) for value, _ in ends)
        where = [
            ", ".join(f"{parameter_label(name)} = {shown(row.parameters[name])}" for name in names) for _, row in ends
        ]
        at = [f" ({place})" if place else "" for place in where]
        text = f"{head}: {low} everywhere." if low == high else ""
        yield Finding(Mark.UNJUDGED, text or f"{head}: from {low}{at[0]} to {high}{at[1]}.")


def _fixed(sweep: Sweep, study: Study) -> list[list[Any]]:
    common = study.common
    control = cast(Scene, sweep.scene).control
    varied = set(sweep.parameters)
    single = {name: shown(value) for name, value in study.points[0]["parameters"].items() if name not in varied}
    return [
        ["scene", cast(Scene, sweep.scene).name],
        ["engine", common["engine"]["name"]],
        ["options of the engine", common["engine"]["options"] or "its defaults"],
        ["law", common["law"] or (control.law if control else "none")],
        ["options of the law", dict(control.options) if control and not common["law"] else {}],
        ["actuation", common["actuation"]["mode"]],
        ["set", single],
        ["samples and seed", [sweep.samples, sweep.seed] if sweep.draws else "nothing is drawn"],
        ["versions", study.identity["versions"]],
    ]


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
            figure = _curves(rows, numeric[:1], [*numeric[1:], *other], measure)
            yield Picture(figure, _caption(measure, numeric[:1]))
        elif over := [name for name in drawn if _is_numeric(rows, name)][:3]:
            yield Picture(_curves(rows, over, other, measure, drawn=True), _caption(measure, over))


def _caption(measure: str, over: Sequence[str]) -> str:
    names = " and ".join(parameter_label(name) for name in over)
    return f"{MEASURES[measure].meaning[0].upper()}{MEASURES[measure].meaning[1:]} against {names}"


def _curves(
    rows: Sequence[Row], over: Sequence[str], other: Sequence[str], measure: str, *, drawn: bool = False
) -> Figure:
    """The measure over each parameter, for each combination of the others a line of the medians of samples, and dots.

    Of parameters that are `drawn` there are dots alone.
    """
    width, height = (max(1.6, len(over)), 1.0) if drawn else (2.2, 1.15)
    figure = new_figure(width * COLUMN, height * COLUMN)
    panels = np.atleast_1d(figure.subplots(1, len(over), sharey=True))
    groups = _grouped(rows, other)
    for panel, name in zip(panels, over, strict=True):
        for number, (label, members) in enumerate(groups.items()):
            x, y = _numbers(members, name, measure)
            look: Any = {"color": palette.color_of(number), "ms": 4, "marker": "o", "label": figure_text(label) or None}
            places = np.unique(x)
            if drawn:
                panel.plot(x, y, lw=0, alpha=0.8, **look)
            else:  # lines that coincide stay visible
                middle = [float(np.median(y[x == place])) for place in places]
                panel.plot(places, middle, ls=line_style(number), lw=1.4, **look)
            if not drawn and len(x) > len(places):
                panel.plot(x, y, color=look["color"], lw=0, marker=".", ms=3, alpha=0.5)
        for index, axis in enumerate("xy"):  # logarithmic where the numbers span much
            lines = [np.asarray(line.get_data()[index], float) for line in panel.get_lines()]
            values = np.concatenate(lines) if lines else np.array([])
            if values.size and values.min() > 0 and values.max() > WIDE * values.min():
                getattr(panel, f"set_{axis}scale")("log")
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

    from tensegrity_mj.pictures.ticks import prefix_ticks

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
    prefix_ticks(bar.ax)
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
