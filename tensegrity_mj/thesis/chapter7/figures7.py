"""The figures of chapter 7, drawn again: so far the tower before and after form-finding."""

from __future__ import annotations

from typing import Any

from tensegrity_mj.library.tower import Topology
from tensegrity_mj.pictures.figure import equal_scales, new_figure
from tensegrity_mj.thesis import drawing
from tensegrity_mj.thesis.appendix_c.beams import BeamRun
from tensegrity_mj.thesis.chapter7.measures7 import FIRST, FORMED, STAGES
from tensegrity_mj.thesis.drawing import AllRuns, Figure


def close_view(all_runs: AllRuns) -> Figure:
    """Figure 7.6: three stages, in space."""
    run: BeamRun = drawing.first_of(all_runs, "tower-form")
    chosen = range(6 * (FIRST - 1), 6 * (FIRST - 1 + STAGES))  # six nodes a stage
    members = [[pair for pair in run.of(FORMED, kind) if set(pair) <= set(chosen)] for kind in ("rods", "strings")]
    rods, strings = members
    figure = new_figure(9.0, 3.9)
    for number, (name, text) in enumerate((("before", "before"), ("nodes", "after")), start=1):
        panel: Any = figure.add_subplot(1, 2, number, projection="3d")
        nodes = run.of(FORMED, name)
        drawing.members(panel, nodes, rods, strings)
        equal_scales(panel, nodes[list(chosen)])
        panel.set_title(f"Structure geometry {text} form-finding", fontsize=9.5)
    stages = f"stages {FIRST} to {FIRST + STAGES - 1} of 15"
    drawing.note(figure, f"{stages}; statics with rigid rods; {Topology.FULL.value} topology, 10 kN/m, 0.10 m")
    return figure
