"""The figures of chapter 5, drawn again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tensegrity_mj.thesis import drawing
from tensegrity_mj.thesis.drawing import BLUE, GREEN, RED, AllRuns, ThesisFigure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _landscape(all_runs: AllRuns) -> Figure:
    from tensegrity_mj.controllers.scenes import from_scene
    from tensegrity_mj.thesis.experiments import experiment_of

    law = from_scene(experiment_of("pinned-fast").load())
    return drawing.landscape(all_runs, "pinned-fast", "Lyapunov law, δ = 0.20, p = 2", law)


def _paths(all_runs: AllRuns) -> Figure:
    names, labels = ("pinned", "pinned-p1", "pinned-pinf"), ("p = 2", "p = 1", "p = ∞")
    return drawing.space_paths(all_runs, names, (BLUE, GREEN, RED), labels, "Pinned rod, δ = 0.15; rod at 60 s")


def _panels(all_runs: AllRuns) -> Figure:
    lines = (("pinned", "(a) p = 2"), ("pinned-p1", "(b) p = 1, sampled"), ("pinned-pinf", "(c) p = ∞, sampled"))
    return drawing.rows_of_panels(all_runs, lines)


def _prism_paths(all_runs: AllRuns) -> Figure:
    return drawing.space_paths(all_runs, ("prism",), (BLUE,), ("",), "Prism, Lyapunov law; rods at 10 s")


def _prism_panels(all_runs: AllRuns) -> Figure:
    return drawing.prism_panels(all_runs, "prism")


_PINNED = ("pinned", "pinned-p1", "pinned-pinf")

FIGURES: tuple[ThesisFigure, ...] = (
    ThesisFigure(
        "5.1", 110, "V of (5.9) over φ and φ̇, and the pinned rod's way, δ = 0.20", ("pinned-fast",), _landscape
    ),
    ThesisFigure("5.3", 120, "Paths of the pinned rod's tip for p = 2 (blue), 1 (green) and ∞ (red)", _PINNED, _paths),
    ThesisFigure("5.4", 121, "Pinned rod: b, controls and λ for p = 2, 1 and ∞", _PINNED, _panels),
    ThesisFigure("5.6", 125, "Paths of the prism's nodes", ("prism",), _prism_paths),
    ThesisFigure("5.7", 126, "Prism: errors, controls and λ", ("prism",), _prism_panels),
)
