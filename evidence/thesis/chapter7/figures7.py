"""The figures of chapter 7, drawn again: the tower's form, how it bends in waves, and the trend over nine cases."""

from __future__ import annotations

from typing import Any

import numpy as np

from evidence.families.in_waves import tower_in_waves
from evidence.families.thesis_towers import PRESTRESS_MEASURES, STIFFNESSES
from evidence.thesis import drawing
from evidence.thesis.appendix_c.beams import STUDIES, BeamRun
from evidence.thesis.chapter7.measures7 import FIRST, FORMED, SHOWN, SOFT, STAGES, grid
from evidence.thesis.drawing import AllRuns, Figure
from evidence.thesis.experiments import TITLES
from tensegrity_mj.library.tower import Topology
from tensegrity_mj.model.elements.water import sea_of
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import common_legend, equal_scales, new_figure
from tensegrity_mj.runs.deformation import centres, distances_from_line, interconnections

STUDY = "waves"
MARGIN = 1.5  # m, of the surface beyond the tower's ends


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


def _side(panel: Any, run: BeamRun, label: str, moment: int) -> None:
    """The tower from its side, as it was then, and the surface above y = 0."""
    nodes, time = run.of(label, "nodes")[moment], float(run.of(label, "times")[moment])
    drawing.members(panel, nodes[:, [0, 2]], run.of(label, "rods"), run.of(label, "strings"))
    x = np.linspace(nodes[:, 0].min() - MARGIN, nodes[:, 0].max() + MARGIN, 200)
    sea = sea_of(tower_in_waves(**STUDIES[STUDY].points[label]["tower"]))
    panel.plot(x, sea.elevation(time, x, 0.0 * x), color=palette.CYCLE[0], lw=1.2)
    panel.set_title(f"{time:.2f} s", fontsize=8.5)
    panel.set_aspect("equal")
    panel.set_ylabel("z [m]", fontsize=8.5)


def measure(all_runs: AllRuns) -> Figure:
    """Figure 7.7: the line between the ends, the centres, and the largest D of the softest case."""
    run = drawing.first_of(all_runs, STUDY)
    scene = tower_in_waves(**STUDIES[STUDY].points[SOFT]["tower"])
    points = centres(run.of(SOFT, "nodes")[0], interconnections(scene.structure))
    D = distances_from_line(points)
    way, most = points[-1] - points[0], int(D.argmax())
    foot = points[0] + way * ((points[most] - points[0]) @ way) / (way @ way)
    figure = new_figure(8.0, 3.4)
    panel: Any = figure.add_subplot()
    _side(panel, run, SOFT, 0)
    for places, style in ((points[[0, -1]], "--"), (points, "o-")):
        panel.plot(places[:, 0], places[:, 2], style, color=palette.CYCLE[1], lw=1.0, ms=3.5)
    ends = np.array([points[most], foot])
    panel.plot(ends[:, 0], ends[:, 2], color=palette.CYCLE[2], lw=2.0)
    panel.set_title(f"D({most + 1}, {float(run.of(SOFT, 'times')[0]):.2f} s) = {D[most]:.2f} m", fontsize=9)
    panel.set_xlabel("x [m]", fontsize=8.5)
    drawing.note(figure, f"{SOFT}; seen along y, where D has a part along the view too")
    return figure


def snapshots(all_runs: AllRuns) -> Figure:
    """Figure 7.8: three moments of the last period."""
    run, figure = drawing.first_of(all_runs, STUDY), new_figure(8.0, 6.0)
    panels: Any = figure.subplots(3, 1, sharex=True, sharey=True)
    for number, panel in enumerate(panels, start=1):
        _side(panel, run, SHOWN, number)
    panels[-1].set_xlabel("x [m]", fontsize=8.5)
    drawing.note(figure, f"{SHOWN}; the tower's base is where x = 0 at first, and it drifts")
    return figure


def trend(all_runs: AllRuns) -> Figure:
    """Figure 7.9: surfaces of the largest D, of the run and after 30 s."""
    run = drawing.first_of(all_runs, STUDY)
    figure = new_figure(9.2, 4.2)
    k, p = np.meshgrid(np.array(STIFFNESSES) / 1e3, PRESTRESS_MEASURES, indexing="ij")
    for number, (name, title) in enumerate((("largest", "of the run"), ("steady", "after 30 s")), start=1):
        panel: Any = figure.add_subplot(1, 2, number, projection="3d")
        panel.plot_surface(k, p, grid(run, name), cmap="viridis", alpha=0.75, edgecolor="k", linewidth=0.5)
        for engine, runs in list(all_runs.items())[1:2]:
            if STUDY in runs:
                D = grid(runs[STUDY], name)
                panel.scatter(k, p, D, s=28, facecolors="none", edgecolors="k", label=TITLES[engine])
        panel.set_title(f"largest D {title}", fontsize=9.5)
        panel.set_xlabel("string stiffness [kN/m]", fontsize=8)
        panel.set_ylabel("prestress measure [m]", fontsize=8)
        panel.set_zlabel("D [m]", fontsize=8)
        panel.view_init(22, 50)
        panel.set_box_aspect(None, zoom=0.86)  # room for the label of the upright axis
        panel.tick_params(labelsize=7.5)
    common_legend(figure, figure.axes)
    return figure
