"""The figures of chapter 4, drawn again. The thesis' y is our z."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.pictures import palette
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis import drawing, measures
from tensegrity_mj.thesis.drawing import BLACK, BLUE, GREEN, RED, AllRuns, ThesisFigure
from tensegrity_mj.thesis.experiments import BEAM_CELLS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CROSS = (("cross-1.2", 1.2), ("cross-0.4", 0.4), ("cross-0", 0.0))
ONE_SUM = (("beam-1960", 1960.0), ("beam-980", 980.0), ("beam-0", 0.0))
BY_CELLS = (("beam-cells-60", 60.0), ("beam-cells-30", 30.0), ("beam-0", 0.0))


def _planar(panel: Any, run: Trajectory, time: float, color: Any = "black", width: float = 2.0) -> None:
    """The structure in its plane at a time: rods thick, strings green."""
    nodes, structure = measures.at(run, time, run.nodes), run.scene.structure
    for i, j in structure.string_nodes:
        panel.plot(nodes[[i, j], 0], nodes[[i, j], 2], color=palette.TARGET, lw=0.7)
    for i, j in structure.rod_nodes:
        panel.plot(nodes[[i, j], 0], nodes[[i, j], 2], color=color, lw=width, solid_capstyle="round")


def _snapshots(
    all_runs: AllRuns, name: str, times: tuple[float, ...], axes: tuple[float, float, float, float], height: float
) -> Figure:
    """The first engine's structure, with the second engine's nodes as circles; axes in x and in y [m], from and to."""
    width = height * (axes[1] - axes[0]) / (axes[3] - axes[2])
    figure, grid = drawing.panels(len(times) // 2, 2, height=height, width=width)
    for panel, time in zip(grid.ravel(), times, strict=True):
        for number, (_, run) in enumerate(drawing.versions_of(all_runs, name)):
            if number == 0:
                _planar(panel, run, time, width=1.2 if len(run.scene.structure.rods) > 4 else 2.2)
            else:
                nodes = measures.at(run, time, run.nodes)
                panel.plot(nodes[:, 0], nodes[:, 2], ls="none", marker="o", ms=3.5, mfc="none", mec=RED, mew=0.6)
        panel.set_xlim(*axes[:2])
        panel.set_ylim(*axes[2:])
        panel.set_aspect("equal")
        drawing.finish(panel, f"t = {time:.2f} s", "y [m]", time=False)
        panel.set_xlabel("x [m]", fontsize=8.5)
    drawing.engines_note(figure, all_runs)
    return figure


def _cross_configurations(all_runs: AllRuns) -> Figure:
    return _snapshots(all_runs, "cross-1.2", (0.0, 10.0), (-0.1, 1.6, -0.1, 1.6), 3.4)


def _references(run: Trajectory) -> Array:
    return measures.cross_coordinates(run, measures.aims(run))


def _of_columns(quantity: Callable[[Trajectory], Array], columns: slice) -> Callable[[Trajectory], Array]:
    return lambda run: quantity(run)[:, columns]


def _cross_motion(all_runs: AllRuns) -> Figure:
    figure, grid = drawing.panels(2, 2)
    for row, name, title in zip(grid, ("cross-1.2", "cross-set-point"), ("Tracking", "Set-point"), strict=True):
        for panel, columns, what, unit in (
            (row[0], slice(1, 3), "$\\theta_1$, $\\theta_2$", "angle [deg]"), (row[1], slice(0, 1), "$y_1$", "y [m]"),
        ):  # fmt: skip
            actual, reference = _of_columns(measures.cross_coordinates, columns), _of_columns(_references, columns)
            drawing.curves(panel, all_runs, name, actual, (BLUE,), labels=("actual",))
            drawing.curves(panel, all_runs, name, reference, (RED,), ls=":", labels=("reference",), marks=False)
            drawing.finish(panel, f"{title}: {what}", unit)
    drawing.engines_note(figure, all_runs)
    return figure


def _control_panels(
    all_runs: AllRuns,
    cases: tuple[tuple[str, float], ...],
    colors: tuple[Any, ...],
    top: float,
    total: float,
    sum_of: str,
) -> Figure:
    """Figures 4.4, 4.9 and 4.10: controls of three cases, and their sums in blue, red and green."""
    figure, grid = drawing.panels(2, 2)
    for panel, (name, bound) in zip(grid.ravel()[:3], cases, strict=True):
        drawing.curves(panel, all_runs, name, lambda run: run.force_densities, colors, lw=0.9)
        drawing.thesis_axis(panel, 0.0, top)
        drawing.finish(panel, f"{sum_of} = {bound:g} N/m", "force density [N/m]")
    _sums(grid[1, 1], all_runs, cases, total)
    drawing.engines_note(figure, all_runs, "the pale band is the range of the thesis' axis")
    return figure


def _sums(panel: Any, all_runs: AllRuns, cases: tuple[tuple[str, float], ...], total: float) -> None:
    for (name, bound), color in zip(cases, (BLUE, RED, GREEN), strict=True):
        drawing.curves(panel, all_runs, name, measures.sums, (color,), labels=(f"{bound:g} N/m",))
    drawing.thesis_axis(panel, 0.0, total)
    drawing.finish(panel, "Sum of controls", "force density [N/m]")


def _cross_controls(all_runs: AllRuns) -> Figure:
    # Blue, red, green and black: the left, lower, right and upper string.
    return _control_panels(all_runs, CROSS, (BLUE, RED, GREEN, BLACK), 0.5, 1.5, "$u_{sum}$")


def _beam_parameters(all_runs: AllRuns) -> Figure:
    name = "beam-1960"
    figure, grid = drawing.panels(1, 3, height=3.0)
    angle, radius, length = grid[0]
    drawing.curves(angle, all_runs, name, lambda run: np.degrees(measures.sector_angle(run)))
    drawing.finish(angle, "Sector angle $\\varphi$", "angle [deg]")
    drawing.curves(radius, all_runs, name, measures.radii, (BLUE, RED), labels=("$r_i$", "$r_o$"))
    radius.set_yscale("log")
    drawing.finish(radius, "Radii", "radius [m]")
    labels = ("outer, odd", "outer, even", "inner, odd", "inner, even", "crossing, odd", "crossing, even")
    drawing.curves(length, all_runs, name, measures.describing_lengths, labels=labels)
    drawing.finish(length, "Six string lengths", "length [m]")
    drawing.engines_note(figure, all_runs)
    return figure


def _beam_snapshots(all_runs: AllRuns) -> Figure:
    return _snapshots(all_runs, "beam-1960", (0.0, 20.0, 40.0, 60.0), (-5.0, 15.0, -8.0, 2.0), 2.8)


def _one_sum(all_runs: AllRuns) -> Figure:
    return _control_panels(all_runs, ONE_SUM, palette.CYCLE, 80.0, 2500.0, "$u_{sum}$")


def _by_cells(all_runs: AllRuns) -> Figure:
    return _control_panels(all_runs, BY_CELLS, palette.CYCLE, 100.0, 3500.0, "$u_{sum}$ of a cell")


def _cells(all_runs: AllRuns) -> Figure:
    figure, grid = drawing.panels(2, 2)
    # Green: cells 1 and 39; blue: 2, 4 ... 38; red: 3, 5 ... 37.
    colors = [GREEN if k in (0, BEAM_CELLS - 1) else BLUE if k % 2 else RED for k in range(BEAM_CELLS)]
    for panel, (name, bound) in zip(grid.ravel()[:3], BY_CELLS, strict=True):
        drawing.curves(panel, all_runs, name, measures.cell_sums, colors, lw=0.9)
        drawing.thesis_axis(panel, 0.0, 150.0)
        drawing.finish(panel, f"Sum in each cell, $u_{{sum}}$ = {bound:g} N/m", "force density [N/m]")
    _sums(grid[1, 1], all_runs, BY_CELLS, 3500.0)
    drawing.engines_note(figure, all_runs, "green: end cells, blue: even, red: odd; the pale band is the thesis' axis")
    return figure


_CROSS = tuple(name for name, _ in CROSS)
_ONE = tuple(name for name, _ in ONE_SUM)
_CELLS = tuple(name for name, _ in BY_CELLS)

FIGURES: tuple[ThesisFigure, ...] = (
    ThesisFigure("4.2", 96, "Cross: initial and final configuration", ("cross-1.2",), _cross_configurations),
    ThesisFigure("4.3", 97, "Cross: references and coordinates", ("cross-1.2", "cross-set-point"), _cross_motion),
    ThesisFigure("4.4", 98, "Cross: left (blue), lower (red), right (green), upper (black)", _CROSS, _cross_controls),
    ThesisFigure("4.7", 100, "Beam: describing parameters", ("beam-1960",), _beam_parameters),
    ThesisFigure("4.8", 101, "Beam: configuration at four times", ("beam-1960",), _beam_snapshots),
    ThesisFigure("4.9", 102, "Beam: controls, one sum over all strings", _ONE, _one_sum),
    ThesisFigure("4.10", 103, "Beam: controls, a sum in each cell", _CELLS, _by_cells),
    ThesisFigure("4.11", 104, "Beam: sum of controls in each cell", _CELLS, _cells),
)
