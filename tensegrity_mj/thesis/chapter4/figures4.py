"""The figures of chapter 4, drawn again. The thesis' y is our z."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.pictures import palette
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis import drawing, measures
from tensegrity_mj.thesis.drawing import BLUE, GREEN, NAMED, RED, AllRuns, Figure
from tensegrity_mj.thesis.experiments import BEAM_CELLS


def snapshots(
    all_runs: AllRuns, names: Sequence[str], times: Sequence[float], axes: Sequence[float], height: float
) -> Figure:
    """Figures 4.2 and 4.8: the first engine's structure at some times, with the second engine's nodes as circles.

    Args:
        axes: in x and in y [m], from and to.
    """
    (name,) = names
    broad = height * (axes[1] - axes[0]) / (axes[3] - axes[2])
    figure, grid = drawing.panels(len(times) // 2, 2, height=height, width=broad)
    for panel, time in zip(grid.ravel(), times, strict=True):
        for number, (_, run) in enumerate(drawing.versions_of(all_runs, name)):
            nodes, structure = measures.at(run, time, run.nodes)[:, [0, 2]], run.scene.structure
            if number == 0:
                width = 1.2 if len(structure.rods) > 4 else 2.2
                drawing.members(panel, nodes, structure.rod_nodes, structure.string_nodes, width, 0.7)
            else:
                drawing.circles(panel, *nodes.T, color=RED, size=3.5, width=0.6)
        panel.set_xlim(*axes[:2])
        panel.set_ylim(*axes[2:])
        panel.set_aspect("equal")
        drawing.finish(panel, f"t = {time:.2f} s", "y [m]", "x [m]")
    drawing.engines_note(figure, all_runs)
    return figure


def _references(run: Trajectory) -> Array:
    return measures.cross_coordinates(run, measures.aims(run))


def _of_columns(quantity: Callable[[Trajectory], Array], columns: slice) -> Callable[[Trajectory], Array]:
    return lambda run: quantity(run)[:, columns]


def cross_motion(all_runs: AllRuns, names: Sequence[str]) -> Figure:
    """Figure 4.3: angles and place of the cross, tracking and at a set-point."""
    figure, grid = drawing.panels(2, 2)
    for row, name, title in zip(grid, names, ("Tracking", "Set-point"), strict=True):
        for panel, columns, what, unit in (
            (row[0], slice(1, 3), "$\\theta_1$, $\\theta_2$", "angle [deg]"), (row[1], slice(0, 1), "$y_1$", "y [m]"),
        ):  # fmt: skip
            actual, reference = _of_columns(measures.cross_coordinates, columns), _of_columns(_references, columns)
            drawing.curves(panel, all_runs, name, actual, (BLUE,), labels=("actual",))
            drawing.curves(panel, all_runs, name, reference, (RED,), ls=":", labels=("reference",), marks=False)
            drawing.finish(panel, f"{title}: {what}", unit)
    drawing.engines_note(figure, all_runs)
    return figure


def control_panels(
    all_runs: AllRuns,
    names: Sequence[str],
    bounds: Sequence[float],
    tops: Sequence[float],
    sum_of: str,
    colors: Sequence[str] = (),
    of_cells: bool = False,
) -> Figure:
    """Figures 4.4 and 4.9 to 4.11: controls of three cases, or sums in each cell; and all sums in blue, red and green.

    Args:
        bounds: of the sums [N/m].
        tops: of the thesis' axes of what is drawn of each case and of sums [N/m].
        colors: of `NAMED`, of the strings.
    """
    figure, grid = drawing.panels(2, 2)
    sums, chosen, extra = grid[1, 1], [NAMED[color] for color in colors] or palette.CYCLE, drawing.BAND
    if of_cells:
        # Green: cells 1 and 39; blue: 2, 4 ... 38; red: 3, 5 ... 37.
        chosen = [GREEN if k in (0, BEAM_CELLS - 1) else BLUE if k % 2 else RED for k in range(BEAM_CELLS)]
        extra = "green: end cells, blue: even, red: odd; the pale band is the thesis' axis"
    quantity = measures.cell_sums if of_cells else operator.attrgetter("force_densities")
    for panel, name, bound, color in zip(grid.ravel()[:3], names, bounds, (BLUE, RED, GREEN), strict=True):
        drawing.curves(panel, all_runs, name, quantity, chosen, lw=0.9)
        drawing.thesis_axis(panel, 0.0, tops[0])
        drawing.finish(panel, f"{sum_of} = {bound:g} N/m", "force density [N/m]")
        drawing.curves(sums, all_runs, name, measures.sums, (color,), labels=(f"{bound:g} N/m",))
    drawing.thesis_axis(sums, 0.0, tops[1])
    drawing.finish(sums, "Sum of controls", "force density [N/m]")
    drawing.engines_note(figure, all_runs, extra)
    return figure


def beam_parameters(all_runs: AllRuns, names: Sequence[str]) -> Figure:
    """Figure 4.7: sector angle, radii and six string lengths of the beam."""
    (name,) = names
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
