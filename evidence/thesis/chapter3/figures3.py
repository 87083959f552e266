"""The figures of chapter 3, drawn again: the rigid bar cable's amplitudes, frequencies and drift.

The thesis draws experiments and ABAQUS as well as its own model; their data are not in it. In their place stand both
starts (at rest in the lab frame and in the moving frame), between which the thesis leaves the choice open.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from evidence.thesis import drawing
from evidence.thesis.chapter3.measures3 import element_frequencies, swings
from evidence.thesis.chapter3.series import ELEMENTS, SHOWN
from evidence.thesis.drawing import BLUE, GREEN, RED, AllRuns, Figure
from evidence.thesis.experiments import TITLES
from tensegrity_mj.pictures.figure import GREY, new_figure

INPUT, NUMBER = "input frequency [Hz]", "number of elements"
FILLED = ("filled", "circles around them")  # how engines are drawn


def psd(all_runs: AllRuns) -> Figure:
    """Figure 3.3: of marker 10 in the plane, at 0.70 Hz, from both starts."""
    figure = new_figure(6.4, 3.6)
    panel: Any = figure.subplots()
    for name, color, label in (("in-line", RED, "lab frame"), ("in-line-moving", BLUE, "moving frame")):
        run = drawing.first_of(all_runs, name)
        number = int(np.argmin(np.abs(run.cases.frequencies - 0.7)))
        density = run.cases.densities[number, SHOWN.index(10), 0]
        panel.plot(run.cases.spectral_frequencies, density, color=color, lw=1.2, label=f"at rest in the {label}")
        for peak in run.peaks(10)[number]:
            panel.axvline(peak, color=color, lw=0.7, ls=":")
    panel.set_xlim(0.0, 1.2)
    panel.set_yscale("log")
    panel.set_ylim(1e-7, 3.0)
    title = "Marker 10, in-plane, in-line 0.70 Hz; dotted: the peaks that are picked"
    drawing.finish(panel, title, "PSD [m²/Hz]", "frequency [Hz]")
    drawing.note(figure, TITLES[drawing.versions_of(all_runs, "in-line")[0][0]])
    return figure


def responses(all_runs: AllRuns, names: Sequence[str], marker: int, axis: int, last_tick: float) -> Figure:
    """Figures 3.4 to 3.9: (a) relative amplitudes and (b) main peaks, over the frequency of the excitation."""
    figure, ((top,), (bottom,)) = drawing.panels(2, 1, height=2.9, width=6.4)
    drawing.thesis_axis(top, 0.0, last_tick)
    styles = ((names[1], BLUE, "s", 3.2, "moving frame"), (names[0], RED, "o", 4.0, "lab frame"))
    for name, color, mark, size, label in styles:
        for number, (_, run) in enumerate(drawing.versions_of(all_runs, name)):
            f = run.cases.frequencies
            if number == 0:
                top.plot(
                    f, swings(run, marker, axis), color=color, marker=mark, ms=size, lw=1.0, label=f"rest in {label}"
                )
            else:
                drawing.circles(top, f, swings(run, marker, axis), color=color, size=7)
            points = [(x, y) for x, row in zip(f, run.peaks(marker, axis), strict=True) for y in row]
            x, y = np.array(points).T
            if number == 0:
                bottom.plot(x, y, color=color, marker=mark, ms=size, ls="none", alpha=0.8)
            else:
                drawing.circles(bottom, x, y, color=color, size=7)
    plane = ("in-plane", "out-of-plane")[axis]
    drawing.finish(top, f"(a) Marker {marker}, {plane}: maximum response amplitude", "relative amplitude", INPUT)
    bottom.plot([0.0, 1.2], [0.0, 1.2], color=GREY, lw=0.6, ls="--")
    bottom.set_ylim(0.0, 1.25)
    drawing.finish(bottom, "(b) Main peaks of the PSD (dashed: output = input)", "output frequency [Hz]", INPUT)
    for panel in (top, bottom):
        panel.set_xlim(0.0, 1.25)
    drawing.engines_note(figure, all_runs, drawing.BAND, names, FILLED)
    return figure


def elements(all_runs: AllRuns) -> Figure:
    """Figure 3.11: frequencies of single elements."""
    figure = new_figure(6.4, 3.6)
    panel: Any = figure.subplots()
    found = np.array([element_frequencies(K) for K in ELEMENTS])
    labels = (("Fastening arrangement", RED), ("Cable elements", BLUE), ("Bottom load", GREEN))
    for column, (label, color) in enumerate(labels):
        panel.plot(ELEMENTS, found[:, column], color=color, marker="o", ms=4, lw=1.0, label=label)
    panel.set_xlim(0, 140)
    drawing.thesis_axis(panel, 1.0, 5.5)
    drawing.finish(panel, "Frequency of one element by itself, (3.28)", "frequency [Hz]", NUMBER)
    return figure
