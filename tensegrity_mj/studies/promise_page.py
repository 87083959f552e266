"""The data and the page of the promise's study."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.files import write_text
from tensegrity_mj.basics.jsontext import to_json
from tensegrity_mj.pictures.figure import frame, new_figure
from tensegrity_mj.pictures.findings import Finding, opening_of
from tensegrity_mj.pictures.page import Picture, Table, pictures_and_tables, write_sections
from tensegrity_mj.studies.promise import DATA, PAGE, Promise

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def write_promise(folder: str | os.PathLike[str], found: Promise) -> Path:
    """Write promise.json and promise.html; returns the page's path."""
    place = Path(folder)
    write_text(place / DATA, to_json(found.to_dict(), indent=1) + "\n")
    which = ("number", "broken", "experiment", "engine")
    failures = [[*(row.get(name, "") for name in which), *_why(row)] for row in found.failures]
    silent = [[row["number"], row["outcome"], row.get("cause", "")] for row in found.rows if row.get("cause")]
    broken = ["", "which", "experiment", "engine", "requested, true [m]", "cost", "why"]
    pictures = [
        Picture(_errors(found), "True error and estimate against what was requested."),
        Picture(_costs(found), "Evaluations of all runs, over those of the cheapest adequate setting."),
    ]
    tables = [
        Table("The promise", ["", ""], [line[:2] for line in found.summary]),
        Table("Promises broken", broken, failures),
        Table("Not measured", ["", "outcome", "cause"], silent),
        Table.of("All experiments", COLUMNS, found.rows, folded=True),
    ]
    kept, cost = found.fractions["within_if_met"], found.fractions["cost"]["median"]
    verdict = (
        f"{kept['count']} of {kept['of']} accuracies reported as met were met, at a median of {cost:.3g} times "
        "the evaluations of the cheapest setting that would have done."
    )
    opening = opening_of(verdict, [Finding(mark, f"{name}: {text}") for name, text, mark in found.summary if mark])
    title, introduction = "What an accuracy promises, measured", f"Experiments drawn with seed {found.seed}."
    sections = pictures_and_tables(pictures, [table for table in tables if table.rows])
    return write_sections(place / PAGE, title, introduction, sections, opening=opening)


def _why(row: dict[str, Any]) -> list[Any]:
    if "error" not in row:
        return ["", "", row.get("cause", "")]
    return [f"{row['requested']:.1e}, {row['error']:.1e}", row.get("cost_ratio"), row["reason"]]


def _errors(found: Promise) -> Figure:
    figure = new_figure(6.5, 4.5)
    axes = figure.add_subplot()
    for settled, colour, label in ((True, "tab:blue", "settled"), (False, "tab:red", "not settled")):
        rows = [row for row in found.rows if row["outcome"] == "measured" and row["settled"] is settled]
        requested = [row["requested"] for row in rows]
        axes.loglog(requested, [row["error"] or 1e-17 for row in rows], "o", color=colour, ms=4, label=f"true, {label}")
        axes.loglog(requested, [row["estimate"] for row in rows], "_", color=colour, ms=7, label=f"estimate, {label}")
    ends = [1e-10, 1e-2]
    axes.loglog(ends, ends, "k-", lw=0.8, label="requested")
    axes.loglog(ends, [3 * end for end in ends], "k:", lw=0.8, label="three times that")
    frame(axes, "", "requested [m]", "largest node error [m]")
    return figure


def _costs(found: Promise) -> Figure:
    figure = new_figure(6.5, 4.0)
    axes = figure.add_subplot()
    for engine in sorted({row["engine"] for row in found.rows if "engine" in row}):
        rows = [row for row in found.rows if row.get("engine") == engine and "cost_ratio" in row and row["met"]]
        axes.loglog([row["requested"] for row in rows], [row["cost_ratio"] for row in rows], "o", ms=4, label=engine)
    frame(axes, "", "requested [m]", "cost over the cheapest")
    return figure
