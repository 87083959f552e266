"""Plots of runs that a reader of the thesis recognises (figures 5.1 to 6.9), and comparisons of runs.

Every function returns a matplotlib Figure and writes it where a path is given (.png, .pdf or .svg). For example:

    tmj.pictures.plots.plot_run([run, reference], "prism.png")     # a row for each run
    tmj.pictures.plots.plot_paths([run, reference], "paths.png")
    tmj.pictures.plots.plot_comparison(tmj.compare(run, reference), "comparison.png", runs=[run, reference])
    tmj.pictures.plots.plot_lyapunov(run, "v.png")
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.rods import directions, rod_number, support_points
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures import figure as figures
from tensegrity_mj.pictures import palette, run_panels
from tensegrity_mj.pictures.figure import Axes, Figure, PathLike
from tensegrity_mj.pictures.figure import paper as paper
from tensegrity_mj.pictures.figure import save_figure as save_figure
from tensegrity_mj.pictures.motion import supported_points
from tensegrity_mj.runs.comparison import DIFFERENCES
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.runs.approaches import Clearance
    from tensegrity_mj.runs.comparison import Comparison

# Differences of a comparison that are drawn.
DRAWN = ("node_error", "velocity_error", "tension_error", "rod_force_error", "force_density_error", "energy_error")

# From where on and how far apart marks stand on curves whose line styles mean something, in diagonals of the panel.
MARKS = [(0.02 + 0.0171 * k, 0.12) for k in range(len(palette.MARKERS))]

NOTEBOOK_DPI = 90
STILL = 1e-12  # what moves no farther is where it was: a pinned rod's r

# times (T,), values (T,), colour, line style, label
_Curve = tuple[Array, Array, Any, str, str | None]


def plot_run(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """A row for each run: with a target figure 5.4 for a structure of one rod, figure 5.7 for others; else its motion.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    all_runs = run_panels.listed(runs)
    if not any(run.scene.target is not None for run in all_runs):
        return plot_motion(all_runs, path)
    one_rod = all(len(run.scene.structure.rods) == 1 and not run.scene.structure.point_masses for run in all_runs)
    return plot_coordinates(all_runs, path) if one_rod else plot_errors(all_runs, path)


def png_of(run: Trajectory) -> bytes | None:
    """The tensions of a run over time as PNG, for notebooks, or heights where nothing pulls; None of an instant."""
    if len(run.time) < 2:
        return None
    figure = figures.new_figure(1.5 * figures.COLUMN, 1.2 * figures.ROW)
    panel, stream = figure.subplots(), io.BytesIO()
    (run_panels.tensions if run.tensions.any() else run_panels.heights)(panel, run)
    panel.set_xlabel("time [s]", fontsize=9)
    figures.print_png(figure, stream, NOTEBOOK_DPI)
    return stream.getvalue()


def plot_motion(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Height [m], tension of the strings [N], the floor's force or the rods' [N], and under a law rest lengths [m].

    Members that are alike are drawn together, see `curves`. The floor's force is drawn where nothing but gravity acts
    from outside as well.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    driven = any(run.provenance.get("controller") for run in run_panels.listed(runs))
    drawn = [run_panels.heights, run_panels.tensions, *([run_panels.rest_lengths] if driven else []), run_panels.forces]
    return _in_rows(runs, path, *drawn)


def plot_coordinates(
    runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None, *, rod: str | None = None
) -> Figure:
    """Figure 5.4: a rod's direction b (blue, green, red: x, y, z) with its target dotted and ‖b‖² dashed; u; λ.

    Args:
        rod: the rod's name; the first by default.

    Raises:
        OptionError: no run, an empty one, an unknown rod, or a path that cannot be written.
    """

    def coordinates(panel: Axes, run: Trajectory) -> None:
        which, rods = rod_number(run.scene.structure, rod), run.scene.structure.rods
        b = directions(run.scene.structure, run.nodes)[:, which]
        aim = run_panels.target_nodes(run)
        for axis, name in enumerate("xyz"):
            look: dict[str, Any] = {"color": palette.CYCLE[axis], "marker": palette.marker_of(axis), "ms": 3.5}
            panel.plot(run.time, b[:, axis], lw=1.3, label=f"$b_{name}$", markevery=MARKS[axis], **look)
        if aim is not None:
            goal = directions(run.scene.structure, aim)[:, which]
            for axis in range(3):
                label = "$b_d$" if axis == 0 else None
                panel.plot(run.time, goal[:, axis], color=palette.CYCLE[axis], lw=1.2, ls=":", label=label)
        panel.plot(run.time, np.sum(b * b, axis=1), color="black", lw=1.0, ls="--", label=r"$\|b\|^2$")
        of_which = f" of rod {figure_text(rods[which].name)}" if len(rods) > 1 else ""
        run_panels.over_time(panel, f"Coordinates $b$ and $b_d${of_which}", "component of the unit vector [1]")

    def multiplier(panel: Axes, run: Trajectory) -> None:
        run_panels.multipliers(panel, run, [rod_number(run.scene.structure, rod)])

    return _in_rows(runs, path, coordinates, run_panels.controls, multiplier)


def plot_errors(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figure 5.7: for each rod (blue, green, red, ...) ‖e_b‖ [1], and ‖e_r‖ [m] where rods can shift; u; λ.

    Of more than four rods, the four with the largest errors and a band of the others. Without a target, these show how
    far b and r are from where they started. Point masses are dotted.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """

    def turned(run: Trajectory) -> bool:
        return bool(run.scene.structure.rods)

    def shifted(run: Trajectory) -> bool:
        return bool(run.scene.structure.given.point_masses) or _off(run, support_points).max(initial=0.0) > STILL

    all_runs = run_panels.listed(runs)
    chosen = [one for one, needed in ((_turns, turned), (_shifts, shifted)) if any(map(needed, all_runs))]
    return _in_rows(runs, path, *(chosen or [_turns]), run_panels.controls, run_panels.multipliers)


def _reference(run: Trajectory) -> Array:
    """Nodes (T or 1, N, 3) [m] of the target, or of the start."""
    aim = run_panels.target_nodes(run)
    return run.nodes[:1] if aim is None else aim


def _off(run: Trajectory, what: Callable[[Structure, Array], Array]) -> Array:
    """Return the distance of b or r of each rod (T, R) from the target's, or from where it started."""
    structure = run.scene.structure
    return np.linalg.norm(what(structure, run.nodes) - what(structure, _reference(run)), axis=-1)


def _turns(panel: Any, run: Trajectory) -> None:
    """‖e_b‖ of the rods, or the change since the start."""
    _distances(panel, run, "b", directions)
    title = "Directions: change since the start" if run.scene.target is None else r"Errors $\|e_b\|$ of directions"
    run_panels.over_time(panel, title, "of the unit vector [1]")


def _shifts(panel: Any, run: Trajectory) -> None:
    """‖e_r‖ of the rods and distances of point masses, or changes since the start."""
    structure, reference = run.scene.structure, _reference(run)
    _distances(panel, run, "r", support_points)
    for k, mass in enumerate(structure.given.point_masses):
        i = structure.node_index[mass.node]
        distance = np.linalg.norm(run.nodes[:, i] - reference[:, i], axis=-1)
        name = figure_text(mass.node) if k < figures.MAX_LEGEND // 2 else None
        panel.plot(run.time, distance, color=palette.color_of(k), lw=1.2, ls=":", label=name)
    title = "Places: change since the start" if run.scene.target is None else r"Errors $\|e_r\|$ of places"
    run_panels.over_time(panel, title, "distance [m]")


def _distances(panel: Any, run: Trajectory, letter: str, what: Callable[[Structure, Array], Array]) -> None:
    """Curves of the rods that move most, and a band of the others."""
    values, sign = _off(run, what), "\\Delta " if run.scene.target is None else "e_"
    moving = np.flatnonzero(values.max(axis=0) > STILL)
    shown = moving[run_panels.largest(values[:, moving], figures.MAX_LEGEND // 2)]
    rest = np.delete(values[:, moving], np.searchsorted(moving, shown), axis=1)
    if rest.shape[1]:
        label = rf"$\|{sign}{letter}\|$, {rest.shape[1]} others"
        band = {"color": palette.BAND, "lw": 0.0, "zorder": 1.0, "label": label}
        panel.fill_between(run.time, rest.min(axis=1), rest.max(axis=1), **band)
    for a in shown:
        label = rf"$\|{sign}{{{letter}_{{{a + 1}}}}}\|$"
        look = {"color": palette.color_of(a), "marker": palette.marker_of(a), "ms": 3.5, "lw": run_panels.WIDTH}
        panel.plot(run.time, values[:, a], ls="-", label=label, markevery=MARKS[a % len(MARKS)], **look)


def _in_rows(
    runs: Trajectory | Sequence[Trajectory], path: PathLike | None, *draw: Callable[[Any, Trajectory], None]
) -> Figure:
    """A row of panels for each run, one by each of these functions; written where a path is given."""
    all_runs = run_panels.listed(runs)
    figure, panels = run_panels.rows_of_panels(all_runs, len(draw))
    for run, row in zip(all_runs, panels, strict=True):
        for one, panel in zip(draw, row, strict=True):
            one(panel, run)
    run_panels.share_scales(panels)
    return figures.saved(figure, path)


STRING = (0.70, 0.72, 0.75)
FLAT = 1e-3  # of the extent: paths that stay as near to a plane across an axis are drawn in that plane
SIZE = 6.4  # inches


def plot_paths(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figures 5.3 and 5.6: the paths of the nodes, a colour for each run, and the rods at the end in black.

    Strings at the end are grey, the target's rods broad and pale, fixed points squares. All runs share one picture; a
    later run is thin and dashed, so that one that it covers shows. What stays in a plane across x, y or z is drawn in
    that plane.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    all_runs = run_panels.listed(runs)
    aims = [run_panels.target_nodes(run) for run in all_runs]
    points = [run.nodes.reshape(-1, 3) for run in all_runs] + [aim[-1] for aim in aims if aim is not None]
    panel, shown = _space(np.concatenate(points))
    for number, (run, aim) in enumerate(zip(all_runs, aims, strict=True)):
        _draw(panel, shown, run, aim, number)
    ends = ", ".join(dict.fromkeys(f"{run.time[-1]:g} s" for run in all_runs))
    title = f"{figure_text(all_runs[0].scene.name)}: paths of the nodes, rods at {ends}"
    if len(shown) == 2:
        figures.frame(panel, title, *(f"{'xyz'[axis]} [m]" for axis in shown))
    else:
        panel.set_title(title, fontsize=10)
        figures.common_legend(panel.figure, [panel])
    return figures.saved(panel.figure, path)


def _space(points: Array) -> tuple[Any, list[int]]:
    """An empty panel for points (n, 3) [m], of three axes or of the two that they spread in; those axes."""
    spread = np.ptp(points, axis=0)
    thin = int(np.argmin(spread))
    if spread[thin] > FLAT * float(spread.max()):
        panel: Any = figures.new_figure(SIZE, 0.85 * SIZE).add_subplot(projection="3d", computed_zorder=False)
        figures.equal_scales(panel, points)
        return panel, [0, 1, 2]
    shown = [axis for axis in range(3) if axis != thin]
    wide, tall = np.maximum(spread[shown], 0.1 * float(spread.max()) or 1.0)
    panel = figures.new_figure(SIZE, float(np.clip(SIZE * tall / wide, 0.22 * SIZE, SIZE)) + 0.9).subplots()
    panel.set_aspect("equal", adjustable="datalim")
    panel.margins(0.06)
    return panel, shown


def _draw(panel: Any, axes: list[int], run: Trajectory, aim: Array | None, number: int) -> None:
    """One run: its paths, where it ends, and its target."""

    def lines(pieces: Array, **look: Any) -> None:
        """Pieces (n, P, 3) as one curve with gaps."""
        gaps = np.full((len(pieces), 1, 3), np.nan)
        joined = np.concatenate([pieces, gaps], axis=1).reshape(-1, 3)[:-1]
        panel.plot(*joined[:, axes].T, **look)

    structure, end = run.scene.structure, run.nodes[-1]
    moving = np.ptp(run.nodes, axis=0).max(axis=1) > 1e-9
    if moving.any():
        width = (1.2 if moving.sum() <= 2 * figures.MAX_LEGEND else 0.6) * (1.0 if number else 2.0)
        label = figure_text(run.engine.partition(",")[0] or run.scene.name)
        look = {"color": palette.color_of(2 * number), "ls": figures.line_style(number), "lw": width}
        lines(run.nodes[:, moving].swapaxes(0, 1), label=label, **look)
    if len(structure.strings):
        lines(end[structure.paths.nodes], color=STRING, lw=0.7)
    if aim is not None and len(structure.rod_nodes):
        label = "" if number else "target"
        lines(aim[-1, structure.rod_nodes], color=palette.TARGET, lw=4.0, alpha=0.5, label=label)
    bars = np.concatenate([structure.rod_nodes, structure.body_edges])
    if len(bars):
        lines(end[bars], color="black", lw=2.0, solid_capstyle="round")
    for point, held in supported_points(structure, end):
        panel.plot(*point[axes][:, None], marker="s", color="black" if held == 3 else figures.GREY, ms=5)


def plot_comparison(comparison: Comparison, path: PathLike | None = None, *, runs: Sequence[Trajectory] = ()) -> Figure:
    """The differences of two runs over time, on a logarithmic scale: the largest over nodes, strings or rods.

    Args:
        comparison: from `tmj.compare`.
        runs: the two runs: their energy balances are drawn too.

    Raises:
        OptionError: a path that cannot be written.
    """
    time = np.asarray(comparison.time, float)
    columns = figures.panels_in_a_row(3)
    figure = figures.new_figure(columns * figures.COLUMN, 6 // columns * figures.ROW + 0.6)
    panels = figure.subplots(6 // columns, columns, sharex=True)
    for panel, name in zip(panels.ravel(), DRAWN, strict=True):
        _, of, unit = DIFFERENCES[name]
        curves: list[_Curve] = []
        given = getattr(comparison, name, None)
        if given is not None and not np.isnan(given).all():
            label = "difference" if name == "energy_error" and runs else None
            values = np.asarray(given, float)
            curves.append((time, values, "black" if label else palette.color_of(0), "-", label))
        if name == "energy_error":
            for number, run in enumerate(runs):
                # The engine's name alone: its options are in the title.
                label = f"balance of {figure_text(run.engine.partition(',')[0]) or f'run {number + 1}'}"
                style = figures.line_style(number)
                curves.append((run.time, run.energy_balance, palette.color_of(number), style, label))
        _logarithmic(panel, curves)
        run_panels.over_time(
            panel, of.capitalize(), f"largest difference [{unit}]" if len(curves) == 1 else f"magnitude [{unit}]"
        )
    for panel in panels.ravel()[-columns:]:
        panel.set_xlabel("time [s]", fontsize=9)
    names = [getattr(comparison, name, "") for name in ("first", "second")]
    if all(names):
        figure.suptitle(" against ".join(map(figure_text, names)), fontsize=11)
    return figures.saved(figure, path)


def plot_clearance(clearance: Clearance, path: PathLike | None = None) -> Figure:
    """The smallest distances of each kind of pairs over time at the samples, and the smallest of all as dots.

    Args:
        clearance: from `tmj.clearance(run, over_time=True)`.

    Raises:
        OptionError: one of a single shape or without `over_time`, or a path that cannot be written.
    """
    if clearance.over_time is None or clearance.samples < 2:
        raise OptionError("plot_clearance: there are no distances over time: use tmj.clearance(run, over_time=True)")
    figure = figures.new_figure(1.8 * figures.COLUMN, 1.3 * figures.ROW)
    panel = figure.subplots()
    for number, (kind, values) in enumerate(clearance.over_time.items()):
        approach = clearance.smallest[kind]
        if approach is None:
            continue
        shown = np.where(np.isfinite(values), values, np.nan)
        panel.plot(clearance.time, shown, color=palette.color_of(number), lw=1.2, label=kind.value)
        panel.plot([approach.time], [approach.distance], color=palette.color_of(number), marker="o", ms=4, ls="none")
    run_panels.over_time(panel, f"{figure_text(clearance.name)}: smallest distances between elements", "distance [m]")
    panel.axhline(0.0, color=figures.GREY, lw=0.8)
    panel.set_xlabel("time [s]", fontsize=9)
    return figures.saved(figure, path)


def plot_lyapunov(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figure 6.6: V over time in blue, its terms in the errors alone in red, those with velocities in green.

    Raises:
        OptionError: no run, an empty one, one whose law has no V, or a path that cannot be written.
    """
    all_runs = run_panels.listed(runs)
    figure = figures.new_figure(figures.COLUMN * max(len(all_runs), 1.5), 1.2 * figures.ROW)
    panels = np.atleast_1d(np.asarray(figure.subplots(1, len(all_runs)), dtype=object))
    parts = (("lyapunov", 0, "$V$"), ("lyapunov_error", 2, "errors"), ("lyapunov_velocity", 1, "velocities"))
    for run, panel in zip(all_runs, panels, strict=True):
        if not np.any(np.isfinite(run.lyapunov_error)):
            raise OptionError(f"the run of scene '{run.scene.name}' ({run.engine}) had no law with a Lyapunov function")
        for name, color, label in parts:
            panel.plot(run.time, getattr(run, name), color=palette.CYCLE[color], lw=1.2, label=label)
        run_panels.over_time(panel, f"{figure_text(run.scene.name)}\n{run_panels.law_name(run)}", "$V$ and its terms")
        panel.set_xlabel("time [s]", fontsize=9)
    return figures.saved(figure, path)


def _logarithmic(panel: Axes, curves: Sequence[_Curve]) -> None:
    """Curves by magnitude; zeros are left out, as no logarithm shows them."""
    found = [np.zeros(0)]
    for time, values, color, style, label in curves:
        size = np.abs(values)
        size[~(size > 0.0)] = np.nan
        found.append(size[np.isfinite(size)])
        panel.plot(time, size, color=color, ls=style, lw=1.1, label=label)
    sizes = np.concatenate(found)
    if sizes.size == 0:
        panel.set_yticks([])
        figures.note(panel, "exactly equal" if curves else "not compared")
        return
    panel.set_yscale("log")
    # A single value near zero, where a difference changes sign, must not squeeze the rest.
    top = float(sizes.max())
    low = max(float(np.quantile(sizes, 0.02)) / 3.0, top * 1e-9)
    panel.set_ylim(min(low, top / 3.0), 3.0 * top)
