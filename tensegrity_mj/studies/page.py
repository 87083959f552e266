"""One HTML page about a sweep: plots, every point, and what was held fixed; all in the one file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from tensegrity_mj.model.scene import Scene
from tensegrity_mj.pictures.page import Table, write_page
from tensegrity_mj.studies.axes import Together
from tensegrity_mj.studies.figures import figures
from tensegrity_mj.studies.many import Study
from tensegrity_mj.studies.measures import MEASURES, USUAL
from tensegrity_mj.studies.sweep import Sweep
from tensegrity_mj.studies.table import check_measures, counts, parameter_label, rows_of, shown

MOST_ROWS = 1000


def write_sweep_page(path: str | os.PathLike[str], sweep: Sweep, study: Study, measures: Sequence[str] = USUAL) -> Path:
    """Write the page of a finished sweep; returns its path.

    Args:
        measures: which to plot and to list.

    Raises:
        OptionError: a measure that there is not, a path that cannot be written.
    """
    measures = check_measures(measures)
    scene, rows = cast(Scene, sweep.scene), rows_of(study)
    several = [axis.axes[0] if isinstance(axis, Together) else axis for axis in sweep.axes]
    axes = [axis.parameter for axis in several if len(axis.values) > 1]
    drawn = [draw.parameter for draw in sweep.draws]
    ended = ", ".join(f"{count} {status}" for status, count in counts(rows).items())
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
    heads = ["", *map(parameter_label, sweep.parameters), "status", *(_head(name) for name in measures), "reason"]
    note = (
        f"The first {MOST_ROWS} of {len(rows)} points; the others are in result.json." if len(rows) > MOST_ROWS else ""
    )
    meanings = [[name, MEASURES[name].meaning, MEASURES[name].unit] for name in measures]
    return write_page(
        path,
        f"Sweep of {scene.name}",
        introduction=f"{len(rows)} points: {ended}. {scene.source}".strip(),
        pictures=list(figures(rows, axes, drawn, measures)),
        tables=[
            Table("Points", heads, lines, note),
            Table("What was kept", ["measure", "meaning", "unit"], meanings),
            Table("What was held fixed", ["", ""], _fixed(sweep, study)),
        ],
    )


def _head(name: str) -> str:
    unit = MEASURES[name].unit
    return name.replace("_", " ") + (f" [{unit}]" if unit else "")


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
