"""The page of long runs: a table and a course of each quantity that should have stayed what it was."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.pictures.figure import frame, new_figure
from tensegrity_mj.pictures.page import Picture, Section, Table, write_sections

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
    introduction = (
        f"{setup['steps']:,} steps of {setup['timestep']:.4g} s of the scene {setup['scene']} without law, dampers "
        f"and loads, in motion (seed {setup['seed']})."
    )
    return write_sections(path, f"Long runs of {setup['scene']}", introduction, sections)


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
