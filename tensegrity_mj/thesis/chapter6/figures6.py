"""The figures of chapter 6, drawn again."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any

from tensegrity_mj.thesis import drawing
from tensegrity_mj.thesis.drawing import BLACK, BLUE, GREEN, RED, AllRuns, ThesisFigure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _law(name: str) -> Any:
    from tensegrity_mj.controllers.scenes import from_scene
    from tensegrity_mj.thesis.experiments import experiment_of

    experiment = experiment_of(name)
    return from_scene(experiment.load(), experiment.law, **experiment.options)


def _landscape_b(all_runs: AllRuns) -> Figure:
    return drawing.landscape(all_runs, "projection", "Projection onto $b^\\perp$, δ = 0.15", _law("projection"))


def _landscape_bd(all_runs: AllRuns) -> Figure:
    return drawing.landscape(all_runs, "mirror-bd", "Projection onto $b_d^\\perp$, δ = 0.15", _law("mirror-bd"))


def _paths(all_runs: AllRuns) -> Figure:
    names = ("projection", "pinned", "pinned-fast")
    labels = ("onto $b^\\perp$, δ = 0.15", "Lyapunov, δ = 0.15", "Lyapunov, δ = 0.20")
    return drawing.space_paths(all_runs, names, (BLUE, GREEN, RED), labels, "Pinned rod; rod at 60 s")


def _panels(all_runs: AllRuns) -> Figure:
    lines = (
        ("projection", "(a) onto $b^\\perp$, δ = 0.15"),
        ("pinned", "(b) Lyapunov, δ = 0.15"),
        ("pinned-fast", "(c) Lyapunov, δ = 0.20"),
    )
    return drawing.rows_of_panels(all_runs, lines)


def _mirror_paths(all_runs: AllRuns) -> Figure:
    labels = ("Lyapunov, δ = 0.20", "onto $b^\\perp$", "onto $b_d^\\perp$")
    names = ("mirror-lyapunov", "mirror-b", "mirror-bd")
    title = "Second start; the rod of $b_d^\\perp$ at 60 s"
    return drawing.space_paths(all_runs, names, (RED, BLUE, BLACK), labels, title)


def _parts(all_runs: AllRuns) -> Figure:
    figure, grid = drawing.panels(1, 2, height=3.0)
    for panel, name, title in zip(grid[0], ("mirror-b", "mirror-bd"), ("$V_2$", "$V_3$"), strict=True):
        for quantity, color, label in (
            ("lyapunov_error", RED, "orientation"), ("lyapunov_velocity", GREEN, "velocity"), ("lyapunov", BLUE, "sum"),
        ):  # fmt: skip
            drawing.curves(panel, all_runs, name, operator.attrgetter(quantity), (color,), labels=(label,))
        drawing.finish(panel, title, "[1]")
    drawing.engines_note(figure, all_runs)
    return figure


def _prism_paths(all_runs: AllRuns) -> Figure:
    return drawing.space_paths(all_runs, ("prism-projection",), (BLUE,), ("",), "Prism, projection; rods at 10 s")


def _prism_panels(all_runs: AllRuns) -> Figure:
    return drawing.prism_panels(all_runs, "prism-projection")


_THREE = ("projection", "pinned", "pinned-fast")
_MIRROR = ("mirror-lyapunov", "mirror-b", "mirror-bd")

FIGURES: tuple[ThesisFigure, ...] = (
    ThesisFigure("6.2", 131, "V of (6.11) over φ and φ̇, projection onto b⊥", ("projection",), _landscape_b),
    ThesisFigure("6.3", 133, "Paths of the tip: projection (blue), Lyapunov δ = 0.15 and 0.20", _THREE, _paths),
    ThesisFigure("6.4", 134, "Pinned rod: b, controls and λ of the three laws", _THREE, _panels),
    ThesisFigure(
        "6.5",
        135,
        "Paths from the second start: Lyapunov (red), onto b⊥ (blue), onto b_d⊥ (black), as in the caption",
        _MIRROR,
        _mirror_paths,
    ),
    ThesisFigure("6.6", 136, "V₂ and V₃: orientation (red), velocity (green), sum (blue)", _MIRROR[1:], _parts),
    ThesisFigure("6.7", 137, "V₃ of (6.23) over φ and φ̇, projection onto b_d⊥", ("mirror-bd",), _landscape_bd),
    ThesisFigure("6.8", 138, "Paths of the prism's nodes, projection", ("prism-projection",), _prism_paths),
    ThesisFigure("6.9", 139, "Prism, projection: errors, controls and λ", ("prism-projection",), _prism_panels),
)
