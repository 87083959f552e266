"""The page of the promise's study."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensegrity_mj.pictures.figure import frame, new_figure
from tensegrity_mj.pictures.findings import Finding, opening_of
from tensegrity_mj.pictures.page import Picture, Table, pictures_and_tables, write_sections
from tensegrity_mj.studies.promise import Promise

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Data = dict[str, Any]
Rows = Sequence[Data]
COLUMNS = {
    "number": "",
    "experiment": "experiment",
    "engine": "engine",
    "requested": "requested [m]",
    "estimate": "estimate [m]",
    "error": "true error [m]",
    "settled": "settled",
    "cost_ratio": "evaluations over the cheapest adequate",
    "lucky_ratio": "even by chance",
    "outcome": "outcome",
}


def write_promise_page(path: str | os.PathLike[str], data: Data) -> Path:
    """Write the page (.html) of the data of a study; returns its path."""
    found, rows = Promise(data), data["rows"]
    which = ("number", "broken", "experiment", "engine")
    failures = [[*(row.get(name, "") for name in which), *_why(row)] for row in found.failures]
    silent = [[row["number"], row["outcome"], row.get("cause", "")] for row in rows if row.get("cause")]
    broken = ["", "which", "experiment", "engine", "requested, true [m]", "cost", "why"]
    pictures = [
        Picture(_errors(rows), "True error and estimate against what was requested."),
        Picture(_costs(rows), "Evaluations of all runs, over those of the cheapest adequate setting."),
    ]
    tables = [
        Table("The promise", ["", ""], [line[:2] for line in found.summary]),
        Table("Promises broken", broken, failures),
        Table("Not measured", ["", "outcome", "cause"], silent),
        Table.of("All experiments", COLUMNS, rows, folded=True),
    ]
    kept, cost = data["fractions"]["within_if_met"], data["fractions"]["cost"]["median"]
    verdict = (
        f"{kept['count']} of {kept['of']} accuracies reported as met were met, at a median of {cost:.3g} times "
        "the evaluations of the cheapest setting that would have done."
    )
    if not kept["of"]:
        verdict = f"None of {len(rows)} experiments reported its accuracy as met."
    opening = opening_of(verdict, [Finding(mark, f"{name}: {text}") for name, text, mark in found.summary if mark])
    title, introduction = "What an accuracy promises, measured", f"Experiments drawn with seed {data['seed']}."
    sections = pictures_and_tables(pictures, [table for table in tables if table.rows])
    return write_sections(path, title, introduction, sections, opening=opening)


def _why(row: dict[str, Any]) -> list[Any]:
    if "error" not in row:
        return ["", "", row.get("cause", "")]
    return [f"{row['requested']:.1e}, {row['error']:.1e}", row.get("cost_ratio"), row["reason"]]


def _errors(all_rows: Rows) -> Figure:
    figure = new_figure(6.5, 4.5)
    axes = figure.add_subplot()
    for settled, colour, label in ((True, "tab:blue", "settled"), (False, "tab:red", "not settled")):
        rows = [row for row in all_rows if row["outcome"] == "measured" and row["settled"] is settled]
        requested = [row["requested"] for row in rows]
        axes.loglog(requested, [row["error"] or 1e-17 for row in rows], "o", color=colour, ms=4, label=f"true, {label}")
        axes.loglog(requested, [row["estimate"] for row in rows], "_", color=colour, ms=7, label=f"estimate, {label}")
    ends = [1e-10, 1e-2]
    axes.loglog(ends, ends, "k-", lw=0.8, label="requested")
    axes.loglog(ends, [3 * end for end in ends], "k:", lw=0.8, label="three times that")
    frame(axes, "", "requested [m]", "largest node error [m]")
    return figure


def _costs(all_rows: Rows) -> Figure:
    figure = new_figure(6.5, 4.0)
    axes = figure.add_subplot()
    for engine in sorted({row["engine"] for row in all_rows if "engine" in row}):
        rows = [row for row in all_rows if row.get("engine") == engine and "cost_ratio" in row and row["met"]]
        axes.loglog([row["requested"] for row in rows], [row["cost_ratio"] for row in rows], "o", ms=4, label=engine)
    frame(axes, "", "requested [m]", "cost over the cheapest")
    return figure
