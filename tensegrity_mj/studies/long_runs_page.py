"""The page of long runs: a table and a course of each quantity that should have stayed what it was."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.units import quantity
from tensegrity_mj.engines.reports import ENERGY_WARNING
from tensegrity_mj.pictures.figure import frame, new_figure
from tensegrity_mj.pictures.findings import Finding, Mark, opening_of
from tensegrity_mj.pictures.page import Picture, Section, Table, write_sections
from tensegrity_mj.runs.energy import DRIFT_WARNING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Data = Mapping[str, Any]
LEAST = 1e-17  # of a course that is drawn on a logarithmic axis


def write_long_runs_page(path: str | os.PathLike[str], data: Data) -> Path:
    """Write the page (.html) of the data of a study; returns its path."""
    setup = data["setup"]
    marks = [str(mark) for mark in setup["marks"]]
    heads = ["", *(f"{int(mark):,} steps" for mark in marks), "growth, power of time", ""]
    sections = []
    for name, meaning in QUANTITIES.items():
        table = [
            [row["method"], *(row[name].get(mark) for mark in marks), row["growth"].get(name), row["reason"]]
            for row in data["rows"]
        ]
        parts: list[Picture | Table] = [Picture(course_figure(data, name), meaning), Table("", heads, table)]
        sections.append(Section(meaning, [], parts))
    findings = list(_findings(data))
    kept = sum(one.mark is Mark.GOOD for one in findings)
    verdict = (
        f"{kept} of {len(findings)} methods keep energy and lengths over {setup['steps']:,} steps of "
        f"{quantity(setup['timestep'], 's')}: within {ENERGY_WARNING:.0%} of the energy exchanged, and bᵀb within "
        f"{DRIFT_WARNING:.1%} of 1."
    )
    introduction = (
        f"The scene {setup['scene']}, in motion, without law, dampers and loads (seed {setup['seed']}): nothing may "
        "change its energy. b is the direction of a rod, whose length is 1."
    )
    title = f"Long runs of {setup['scene']}"
    return write_sections(path, title, introduction, sections, opening=opening_of(verdict, findings))


def _findings(data: Data) -> Iterator[Finding]:
    """A method each, with how far energy and lengths went; what runs warn of is limited, or bad where rods stretch."""
    for row in data["rows"]:
        energy, length = (max(row[name].values(), default=0.0) for name in ("energy", "length"))
        mark = Mark.LIMITED if energy > ENERGY_WARNING else Mark.GOOD
        mark = Mark.BAD if row["reason"] or length > DRIFT_WARNING else mark
        text = f"{row['method']}: the energy changes by {energy:.2g} of all that was exchanged, bᵀb by {length:.2g}."
        yield Finding(mark, f"{row['method']}: {row['reason']}" if row["reason"] else text)


def course_figure(data: Data, name: str) -> Figure:
    """How a quantity grew over the steps, for each method that let it grow at all."""
    figure = new_figure(9.0, 4.5)
    axes = figure.add_subplot()
    for row in data["rows"]:
        course = row.get("course", {})
        if any(value > 0 for value in course.get(name, [])):
            axes.loglog(course["steps"], np.maximum(course[name], LEAST), label=row["method"])
    frame(axes, "", "steps", QUANTITIES[name])
    return figure


QUANTITIES = {
    "energy": "largest change of the energy, of all that was exchanged",
    "length": "largest change of bᵀb",
    "rate": "largest bᵀḃ [1/s]",
}
