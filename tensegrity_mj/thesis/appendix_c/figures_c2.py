"""Figure C.8 of appendix C.2, drawn again in two readings: how much beams swing in waves."""

from __future__ import annotations

from tensegrity_mj.library.thesis_towers import TABLE_C2
from tensegrity_mj.pictures import palette
from tensegrity_mj.thesis import drawing
from tensegrity_mj.thesis.appendix_c.beams import BY_PRESTRESS, HEIGHTS, wave_label
from tensegrity_mj.thesis.appendix_c.measures_c2 import amplitude
from tensegrity_mj.thesis.drawing import AllRuns, Figure

AXES = ((0.0, 9.0), (0.0, 3.0))  # m, of the thesis
READINGS = (
    ("beam-waves", HEIGHTS, "(a) half of a beam, waves as in the text"),
    ("beam-waves-doubled", tuple(2 * height for height in HEIGHTS), "(b) clamped beam, waves twice as high"),
)


def oscillation(all_runs: AllRuns) -> Figure:
    """Figure C.8: how much beams swing, over the wave height."""
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
                drawing.circles(panel, there, swings, color=color, size=6.5, width=1.0)
        drawing.finish(panel, title, "oscillation amplitude [m]", "wave height [m]")
        panel.set_xlim(*AXES[0])
        panel.set_ylim(bottom=0.0)
    circles = "; circles: the other engine" if confirmed else ""
    drawing.note(figure, f"the stage that swings most{circles}; pale: the thesis' axis")
    return figure
