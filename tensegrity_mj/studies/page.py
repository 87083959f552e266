"""One HTML page about a sweep: plots, every point, and what was held fixed; all in the one file."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

from tensegrity_mj.basics.units import quantity
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures.findings import Finding, Mark, mark_of
from tensegrity_mj.pictures.page import Table, pictures_and_tables
from tensegrity_mj.studies.figures import figures
from tensegrity_mj.studies.many import Study
from tensegrity_mj.studies.measures import MEASURES, USUAL
from tensegrity_mj.studies.report import Page
from tensegrity_mj.studies.sweep import Sweep
from tensegrity_mj.studies.table import (
    Row,
    as_number,
    check_measures,
    counts,
    measure_label,
    parameter_label,
    rows_of,
    shown,
)

MOST_ROWS = 1000
LONG = 12  # rows beyond which the table is folded


def write_sweep_page(path: str | os.PathLike[str], sweep: Sweep, study: Study, measures: Sequence[str] = USUAL) -> Path:
    """Write the page of a finished sweep; returns its path.

    Args:
        measures: which to plot and to list.

    Raises:
        OptionError: a measure that there is not, a path that cannot be written.
    """
    measures = check_measures(measures)
    scene, rows = cast(Scene, sweep.scene), rows_of(study)
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
    meanings = [[name, MEASURES[name].meaning, MEASURES[name].unit] for name in measures]
    tables = [
        Table("Points", heads, lines, note, folded=len(lines) > LONG),
        Table("What was kept", ["measure", "meaning", "unit"], meanings, folded=True),
        Table("What was held fixed", ["", ""], _fixed(sweep, study), folded=True),
    ]
    sections = pictures_and_tables(figures(rows, axes, drawn, measures), tables)
    findings = _findings(rows, several, measures)
    return Page(f"Sweep of {scene.name}", scene.source, _verdict(scene.name, rows), findings, sections).write(path)


def _verdict(name: str, rows: Sequence[Row]) -> str:
    """How the points ended."""
    ended = counts(rows)
    done = ended.get("completed", 0)
    if done == len(rows):
        return f"All {len(rows)} points of {name} ran to their end."
    others = ", ".join(f"{count} {status}" for status, count in ended.items() if status != "completed")
    return f"{done} of {len(rows)} points of {name} ran to their end; {others}."


def _findings(rows: Sequence[Row], axes: Sequence[Any], measures: Sequence[str]) -> Iterator[Finding]:
    """How points ended, and the range of each measure with where its ends are."""
    done = counts(rows).get("completed", 0)
    if done < len(rows):
        reason = next((row.reason for row in rows if row.reason), "")
        yield Finding(
            mark_of(done, len(rows)), f"{len(rows) - done} points ended early, the first: {reason or 'see the table'}."
        )
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
        mark = Mark.GOOD if len(found) == len(rows) else Mark.LIMITED
        text = f"{head}: {low} everywhere." if low == high else ""
        yield Finding(mark, text or f"{head}: from {low}{at[0]} to {high}{at[1]}.")


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
