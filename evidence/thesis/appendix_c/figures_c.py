"""The figures of appendix C, drawn again: the beam and its stiffness (C.1), and how much beams swing in waves (C.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from evidence.families.thesis_towers import TABLE_C2
from evidence.thesis import drawing
from evidence.thesis.appendix_c.beams import BY_PRESTRESS, BY_STIFFNESS, HEIGHTS, BeamRun, wave_label
from evidence.thesis.appendix_c.measures_c import amplitude, buckling, initial, stiffness
from evidence.thesis.drawing import AllRuns, Figure
from evidence.thesis.experiments import EngineName
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import GREY, new_figure

SHOWN = "TB1"  # the beam of figure C.2
STARS = "TB6*, TB7*: springs of 1600 and 2000 kN/m for the printed 1200; dotted: as printed"
PANELS = (
    (BY_STIFFNESS, "(a) similar prestress, varying spring stiffness"),
    (BY_PRESTRESS, "(b) varying prestress, constant spring stiffness"),
)
CROSSES = 6.5  # size of MuJoCo's marks
AXES = ((0.0, 9.0), (0.0, 3.0))  # m, of figure C.8
READINGS = (
    ("beam-waves", HEIGHTS, "(a) half of a beam, waves as in the text"),
    ("beam-waves-doubled", tuple(2 * height for height in HEIGHTS), "(b) clamped beam, waves twice as high"),
)


def _curve(panel: Any, run: BeamRun, label: str, color: Any, text: str | None, style: str = "-") -> None:
    panel.plot(run.of(label, "w"), stiffness(run, label), color=color, lw=1.3, ls=style, label=text)


def stiffness_over(
    all_runs: AllRuns, names: Sequence[str], ends: Sequence[float], ticks: Sequence[Sequence[float]], axis: int
) -> Figure:
    """Figures C.3, C.6 and C.7: stiffness over deformation; ends of the deformation, and ranges of the thesis' axes."""
    figure, ((left, right),) = drawing.panels(1, 2, height=3.6, width=4.4)
    run = drawing.first_of(all_runs, names[0])
    suffix = {0: "", 1: " y", 2: " z"}[axis]
    confirmed = all_runs.get(EngineName.MUJOCO, {}).get("beams")
    for panel, (beams, title), band in zip((left, right), PANELS, ticks, strict=True):
        drawing.thesis_axis(panel, *band)
        for number, beam in enumerate(beams):
            color = palette.CYCLE[number]
            _curve(panel, run, beam + suffix, color, beam)
            if beam.endswith("*"):
                _curve(panel, run, beam.rstrip("*") + suffix, color, None, ":")
            if confirmed is not None and beam in confirmed.values:
                drawing.circles(panel, [0.0], [initial(confirmed, beam, axis)], color=color, size=CROSSES, width=1.0)
        _finish(panel, title, ends)
    extra = "; circles: MuJoCo at zero load" if confirmed is not None else ""
    drawing.note(figure, f"statics with elastic rods{extra}; {drawing.BAND}\n{STARS}", 7.5)
    return figure


def _finish(panel: Any, title: str, ends: Sequence[float]) -> None:
    drawing.finish(panel, title, "stiffness [kN/m]", "deformation [m]")
    panel.set_xlim(*ends)


def compression(all_runs: AllRuns) -> Figure:
    """Figure C.4: stiffness of beams that are pushed, perfect ones and others."""
    figure, ((left, right),) = drawing.panels(1, 2, height=3.9, width=4.4)
    perfect, imperfect = drawing.first_of(all_runs, "compression"), drawing.first_of(all_runs, "imperfect")
    for panel, (beams, title) in zip((left, right), PANELS, strict=True):
        drawing.thesis_axis(panel, 0.0, 40.0)
        for number, beam in enumerate(beams):
            color = palette.CYCLE[number]
            _curve(panel, perfect, beam, color, None, "--")
            K = np.where(imperfect.of(beam, "turned"), np.nan, stiffness(imperfect, beam))
            panel.plot(imperfect.of(beam, "w"), K, color=color, lw=1.5, label=beam)
            at = buckling(imperfect, beam).deformation
            panel.plot([at], [np.interp(at, perfect.of(beam, "w"), stiffness(perfect, beam))], color=color, marker="v")
        panel.axhline(0.0, color=GREY, lw=0.6)
        panel.set_ylim(-10.0, 42.0)
        _finish(panel, title, (0.0, 3.5))
    text = "solid: with 100 N across the middle; triangles: it buckles; dashed: the perfect beam, straight beyond\n"
    drawing.note(figure, f"{text}{drawing.BAND}; TB6*, TB7*: springs of 1600 and 2000 kN/m", 7.5)
    return figure


def configuration(all_runs: AllRuns) -> Figure:
    """Figure C.2: (a), (b) rods across the beam, (c), (d) the beam from its side, before and after form-finding."""
    run = drawing.first_of(all_runs, "beams")
    figure = new_figure(9.0, 4.6)
    panels: Any = figure.subplots(2, 2, width_ratios=[1, 4.2])
    rods, strings = run.of(SHOWN, "rods"), run.of(SHOWN, "strings")
    for (cross, side), name, text in zip(panels, ("before", "nodes"), ("prior to", "after"), strict=True):
        nodes = run.of(SHOWN, name)
        drawing.members(cross, nodes[:, 1:], rods, ())
        drawing.members(side, nodes[:, [0, 2]], rods, strings)
        letters = ("ac", "bd")[name == "nodes"]
        for panel, letter, what, names in (
            (cross, letters[0], "cross section", "yz"),
            (side, letters[1], "beam", "xz"),
        ):
            drawing.finish(panel, f"({letter}) {what} {text} form-finding", f"{names[1]} [m]", f"{names[0]} [m]")
            panel.set_aspect("equal")
        cross.set_xlim(-0.8, 0.8)
        cross.set_ylim(-0.8, 0.8)
        side.set_xlim(-0.5, 30.5)
        side.set_ylim(-2.0, 2.0)
    drawing.note(figure, f"{SHOWN}; statics with elastic rods; rods black, strings green")
    return figure


def oscillation(all_runs: AllRuns) -> Figure:
    """Figure C.8 in two readings: how much beams swing, over the wave height."""
    figure, (panels,) = drawing.panels(1, 2, height=3.6, width=4.4)
    confirmed = False
    for panel, (study, heights, title) in zip(panels, READINGS, strict=True):
        drawing.thesis_axis(panel, *AXES[1])
        runs = [found[study] for found in all_runs.values() if study in found][:2]
        for color, beam in zip(palette.CYCLE, BY_PRESTRESS, strict=False):
            name = f"{beam}, {TABLE_C2[beam].stress / 1e6:g} MPa"
            swings = [amplitude(runs[0], beam, height) for height in heights]
            panel.plot(heights, swings, color=color, lw=1.3, marker=".", label=name)
            for run in runs[1:]:
                there = [height for height in heights if wave_label(beam, height) in run.values]
                confirmed = confirmed or bool(there)
                swings = [amplitude(run, beam, height) for height in there]
                drawing.circles(panel, there, swings, color=color, size=CROSSES, width=1.0)
        drawing.finish(panel, title, "oscillation amplitude [m]", "wave height [m]")
        panel.set_xlim(*AXES[0])
        panel.set_ylim(bottom=0.0)
    circles = "; circles: the other engine" if confirmed else ""
    drawing.note(figure, f"the stage that swings most{circles}; pale: the thesis' axis")
    return figure
