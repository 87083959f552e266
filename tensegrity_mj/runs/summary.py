"""A run or a comparison at a glance: some lines of text; of a run for notebooks also a table with a plot."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

from tensegrity_mj.basics import pictured
from tensegrity_mj.basics.texts import shortened
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import printable
from tensegrity_mj.runs.differences import DIFFERENCES

if TYPE_CHECKING:
    from tensegrity_mj.runs.comparison import Comparison
    from tensegrity_mj.runs.trajectory import Trajectory

MOST_LETTERS = 100  # of a line
# What a comparison's lines have.
GROUPS = {
    "motion": ("node_error", "velocity_error"),
    "forces": ("tension_error", "rod_force_error", "force_density_error"),
    "others": ("rest_length_error", "energy_error"),
}


def rows_of(run: Trajectory) -> list[tuple[str, str]]:
    """Rows (name, line) of a run's summary: scene, engine, time, status and errors."""
    structure = run.scene.structure
    size = f"{len(structure.nodes)} nodes, {len(structure.rods)} rods, {len(structure.strings)} strings"
    span = f"{run.time[0]:g} to {run.time[-1]:g} s, " if len(run.time) else ""
    warnings = run.reports.get("warnings", [])
    error = f"energy off by {run.energy_residual:.2g} J"
    if warnings:
        error += f"; {len(warnings)} warning{'s' * (len(warnings) > 1)}: {warnings[0]}"
    rows = [
        ("run of", f"{run.scene.name}: {size}"),
        ("engine", run.engine),
        ("time", f"{span}{len(run.time)} samples"),
        ("status", run.status.value + (f": {run.message}" if run.message else "")),
        ("errors", error),
    ]
    return [(name, shortened(printable(text), MOST_LETTERS)) for name, text in rows]


def rows_of_comparison(comparison: Comparison) -> list[tuple[str, str]]:
    """Rows (name, line) of a comparison: runs, times, largest differences in their units, and tolerances exceeded."""
    between = " and ".join(name or "a run" for name in (comparison.first, comparison.second))
    time = comparison.time
    rows = [("between", between), ("time", f"{time[0]:g} to {time[-1]:g} s, {len(time)} common times")]
    for group, names in GROUPS.items():
        found = [
            f"{DIFFERENCES[name].words.removesuffix(' error')} "
            f"{quantity(getattr(comparison, f'max_{name}'), DIFFERENCES[name].unit)}"
            for name in names
            if name in comparison.compared
        ]
        rows += [(group, ", ".join(found))] if found else []
    since = {DIFFERENCES[name].words: when for name, when in comparison.first_exceeded.items() if when is not None}
    beyond = ", ".join(f"{words} from {quantity(when, 's')}" for words, when in since.items())
    return rows + ([("beyond", beyond or "no tolerance")] if comparison.first_exceeded else [])


def html_of(run: Trajectory) -> str:
    """Summary of a run as a table, and below it a plot of the tensions, or of heights where nothing pulls."""
    cells = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in rows_of(run))
    plot = pictured.draw(run)
    shown = "" if plot is None else f'<img src="data:image/png;base64,{base64.b64encode(plot).decode()}">'
    return f"<table>{cells}</table>{shown}"
