"""Plots of runs that a reader of the thesis recognises (figures 5.1 to 6.9), and comparisons of runs.

Every function returns a matplotlib Figure and writes it where a path is given (.png, .pdf or .svg). For example:

    tmj.pictures.plots.plot_run([run, reference], "prism.png")     # a row for each run
    tmj.pictures.plots.plot_paths([run, reference], "paths.png")
    tmj.pictures.plots.plot_comparison(tmj.compare(run, reference), "comparison.png", runs=[run, reference])
    tmj.pictures.plots.plot_lyapunov(run, "v.png")
    tmj.pictures.plots.landscape(law, run, "landscape.png")        # V over φ and φ̇, with the run's way over it
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.rods import directions, support_points
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import (
    COLUMN,
    GREY,
    MAX_LEGEND,
    ROW,
    PathLike,
    equal_scales,
    line_style,
    new_figure,
    note,
    saved,
)
from tensegrity_mj.pictures.figure import save_figure as save_figure
from tensegrity_mj.pictures.run_panels import (
    controls,
    law_name,
    listed,
    multipliers,
    over_time,
    rod_index,
    rows_of_panels,
    target_nodes,
)
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tensegrity_mj.controllers.landscape import Landscape
    from tensegrity_mj.controllers.lyapunov import Lyapunov
    from tensegrity_mj.controllers.projection import Projection
    from tensegrity_mj.runs.approaches import Clearance

__all__ = [
    "landscape",
    "plot_clearance",
    "plot_comparison",
    "plot_coordinates",
    "plot_errors",
    "plot_lyapunov",
    "plot_paths",
    "plot_run",
    "save_figure",
]

# What a comparison may hold, with a title and a unit for each.
DIFFERENCES = {
    "node_error": ("Node positions", "m"),
    "velocity_error": ("Node velocities", "m/s"),
    "tension_error": ("String tensions", "N"),
    "rod_force_error": ("Rod forces", "N"),
    "force_density_error": ("Control force densities u", "N/m"),
    "energy_error": ("Total energy", "J"),
}

# times (T,), values (T,), colour, line style, label
_Curve = tuple[Array, Array, Any, str, str | None]


class ComparisonLike(Protocol):
    """What `plot_comparison` reads of a `Comparison`: times (T,), and the differences (T,) named in `DIFFERENCES`."""

    @property
    def time(self) -> Array: ...


def plot_run(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figure 5.4 for a structure of one rod, figure 5.7 for every other; a row for each run.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    all_runs = listed(runs)
    one_rod = all(len(run.scene.structure.rods) == 1 and not run.scene.structure.point_masses for run in all_runs)
    return plot_coordinates(all_runs, path) if one_rod else plot_errors(all_runs, path)


def plot_coordinates(
    runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None, *, rod: str | None = None
) -> Figure:
    """Figure 5.4: a rod's direction b (blue, green, red: x, y, z) with its target dotted and ‖b‖² dashed; u; λ.

    Args:
        rod: the rod's name; the first by default.

    Raises:
        OptionError: no run, an empty one, an unknown rod, or a path that cannot be written.
    """
    all_runs = listed(runs)
    figure, panels = rows_of_panels(all_runs)
    for run, row in zip(all_runs, panels, strict=True):
        which = rod_index(run, rod)
        b = directions(run.scene.structure, run.nodes)[:, which]
        aim = target_nodes(run)
        for axis, name in enumerate("xyz"):
            row[0].plot(run.time, b[:, axis], color=palette.CYCLE[axis], lw=1.3, label=f"$b_{name}$")
        if aim is not None:
            goal = directions(run.scene.structure, aim)[:, which]
            for axis in range(3):
                label = "$b_d$" if axis == 0 else None
                row[0].plot(run.time, goal[:, axis], color=palette.CYCLE[axis], lw=1.2, ls=":", label=label)
        row[0].plot(run.time, np.sum(b * b, axis=1), color="black", lw=1.0, ls="--", label=r"$\|b\|^2$")
        rods = run.scene.structure.rods
        of_which = f" of rod {figure_text(rods[which].name)}" if len(rods) > 1 else ""
        over_time(row[0], f"Coordinates $b$ and $b_d${of_which}", "component of the unit vector [1]")
        controls(row[1], run)
        multipliers(row[2], run, [which])
    return saved(figure, path)


def plot_errors(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figure 5.7: for each rod (blue, green, red, ...) ‖e_b‖ full and ‖e_r‖ dashed; u; λ.

    Without a target, the first column shows how far b and r are from where they started. Point masses are dotted.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    all_runs = listed(runs)
    figure, panels = rows_of_panels(all_runs)
    for run, row in zip(all_runs, panels, strict=True):
        structure, aim = run.scene.structure, target_nodes(run)
        reference = run.nodes[:1] if aim is None else aim
        sign = "\\Delta " if aim is None else "e_"
        b_error = np.linalg.norm(directions(structure, run.nodes) - directions(structure, reference), axis=-1)
        r_error = np.linalg.norm(support_points(structure, run.nodes) - support_points(structure, reference), axis=-1)
        labelled = len(structure.rods) <= MAX_LEGEND // 2
        for a in range(len(structure.rods)):
            for values, style, letter in ((b_error, "-", "b"), (r_error, "--", "r")):
                if letter == "r" and not np.any(r_error[:, a] > 1e-12):
                    continue  # a pinned rod's r cannot move
                label = rf"$\|{sign}{{{letter}_{{{a + 1}}}}}\|$" if labelled else None
                row[0].plot(run.time, values[:, a], color=palette.color_of(a), lw=1.2, ls=style, label=label)
        for k, mass in enumerate(structure.point_masses):
            i = structure.node_index[mass.node]
            distance = np.linalg.norm(run.nodes[:, i] - reference[:, i], axis=-1)
            label = figure_text(mass.node) if len(structure.point_masses) <= MAX_LEGEND // 2 else None
            row[0].plot(run.time, distance, color=palette.color_of(k), lw=1.2, ls=":", label=label)
        title = "Change since the start" if aim is None else r"Errors $\|e_b\|$ (full), $\|e_r\|$ (dashed)"
        over_time(row[0], title, r"$b$ [1], $r$ [m]")
        controls(row[1], run)
        multipliers(row[2], run, range(len(structure.rods)))
    return saved(figure, path)


def plot_paths(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figures 5.3 and 5.6: the paths of the nodes, a colour for each run, and the rods at the end in black.

    Strings at the end are grey, the target's rods dotted, fixed points squares. All runs share one picture; a later
    run is dashed, so that one that it covers shows.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    from tensegrity_mj.pictures.painter import supported_points

    all_runs = listed(runs)
    figure = new_figure(6.4, 5.6)
    axes: Any = figure.add_subplot(projection="3d")
    everything = []
    for number, run in enumerate(all_runs):
        structure, end = run.scene.structure, run.nodes[-1]
        moving = np.flatnonzero(np.ptp(run.nodes, axis=0).max(axis=1) > 1e-9)
        style = line_style(number)
        for count, node in enumerate(moving):
            label = figure_text(run.engine or run.scene.name) if count == 0 else None
            axes.plot(*run.nodes[:, node].T, color=palette.color_of(number), lw=1.2, ls=style, label=label)
        for i, j in structure.string_nodes:
            axes.plot(*end[[i, j]].T, color=(0.7, 0.72, 0.75), lw=0.7)
        for i, j in structure.rod_nodes:
            axes.plot(*end[[i, j]].T, color="black", lw=2.2, solid_capstyle="round")
        for point, held in supported_points(structure, end):
            axes.plot(*point[:, None], marker="s", color="black" if held == 3 else GREY, ms=5)
        everything.append(run.nodes.reshape(-1, 3))
        aim = target_nodes(run)
        if aim is not None:
            for i, j in structure.rod_nodes:
                axes.plot(*aim[-1, [i, j]].T, color=palette.TARGET, lw=1.6, ls=":")
            everything.append(aim[-1])
    equal_scales(axes, np.concatenate(everything))
    ends = ", ".join(dict.fromkeys(f"{run.time[-1]:g} s" for run in all_runs))
    axes.set_title(f"{figure_text(all_runs[0].scene.name)}: paths of the nodes, rods at {ends}", fontsize=10)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False, loc="upper left")
    return saved(figure, path)


def plot_comparison(
    comparison: ComparisonLike, path: PathLike | None = None, *, runs: Sequence[Trajectory] = ()
) -> Figure:
    """The differences of two runs over time, on a logarithmic scale: the largest over nodes, strings or rods.

    Args:
        comparison: from `tmj.compare`.
        runs: the two runs: their energy balances are drawn too.

    Raises:
        OptionError: a path that cannot be written.
    """
    time = np.asarray(comparison.time, float)
    figure = new_figure(3 * COLUMN, 2 * ROW + 0.6)
    panels = figure.subplots(2, 3, sharex=True)
    for panel, (name, (title, unit)) in zip(panels.ravel(), DIFFERENCES.items(), strict=True):
        curves: list[_Curve] = []
        if getattr(comparison, name, None) is not None:
            label = "difference" if name == "energy_error" and runs else None
            values = np.asarray(getattr(comparison, name), float)
            curves.append((time, values, "black" if label else palette.color_of(0), "-", label))
        if name == "energy_error":
            for number, run in enumerate(runs):
                # The engine's name alone: its options are in the title.
                label = f"balance of {figure_text(run.engine.partition(',')[0]) or f'run {number + 1}'}"
                style = line_style(number)
                curves.append((run.time, run.energy_balance, palette.color_of(number), style, label))
        _logarithmic(panel, curves)
        over_time(panel, title, f"largest difference [{unit}]" if len(curves) == 1 else f"magnitude [{unit}]")
    for panel in panels[-1]:
        panel.set_xlabel("time [s]", fontsize=9)
    names = [getattr(comparison, name, "") for name in ("first", "second")]
    if all(names):
        figure.suptitle(" against ".join(map(figure_text, names)), fontsize=11)
    return saved(figure, path)


def plot_clearance(clearance: Clearance, path: PathLike | None = None) -> Figure:
    """The smallest distances of each kind of pairs over time at the samples, and the smallest of all as dots.

    Args:
        clearance: from `tmj.clearance(run, over_time=True)`.

    Raises:
        OptionError: one of a single shape or without `over_time`, or a path that cannot be written.
    """
    if clearance.over_time is None or clearance.samples < 2:
        raise OptionError("plot_clearance: there are no distances over time: use tmj.clearance(run, over_time=True)")
    figure = new_figure(1.8 * COLUMN, 1.3 * ROW)
    panel = figure.subplots()
    for number, (kind, values) in enumerate(clearance.over_time.items()):
        approach = clearance.smallest[kind]
        if approach is None:
            continue
        shown = np.where(np.isfinite(values), values, np.nan)
        panel.plot(clearance.time, shown, color=palette.color_of(number), lw=1.2, label=kind.value)
        panel.plot([approach.time], [approach.distance], color=palette.color_of(number), marker="o", ms=4, ls="none")
    over_time(panel, f"{figure_text(clearance.name)}: smallest distances between elements", "distance [m]")
    panel.axhline(0.0, color=GREY, lw=0.8)
    panel.set_xlabel("time [s]", fontsize=9)
    return saved(figure, path)


def plot_lyapunov(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figure 6.6: V over time in blue, its terms in the errors alone in red, those with velocities in green.

    Raises:
        OptionError: no run, an empty one, one whose law has no V, or a path that cannot be written.
    """
    all_runs = listed(runs)
    figure = new_figure(COLUMN * max(len(all_runs), 1.5), 1.2 * ROW)
    panels = np.atleast_1d(np.asarray(figure.subplots(1, len(all_runs)), dtype=object))
    parts = (("lyapunov", 0, "$V$"), ("lyapunov_error", 2, "errors"), ("lyapunov_velocity", 1, "velocities"))
    for run, panel in zip(all_runs, panels, strict=True):
        if not np.any(np.isfinite(run.lyapunov_error)):
            raise OptionError(f"the run of scene '{run.scene.name}' ({run.engine}) had no law with a Lyapunov function")
        for name, color, label in parts:
            panel.plot(run.time, getattr(run, name), color=palette.CYCLE[color], lw=1.2, label=label)
        over_time(panel, f"{figure_text(run.scene.name)}\n{law_name(run)}", "$V$ and its terms")
        panel.set_xlabel("time [s]", fontsize=9)
    return saved(figure, path)


def landscape(
    law: Lyapunov | Projection | Landscape,
    runs: Trajectory | Sequence[Trajectory] = (),
    path: PathLike | None = None,
    *,
    rod: str | None = None,
) -> Figure:
    """Figures 5.1, 6.2 and 6.7: contours of V_φ(φ, φ̇) of one rod, and the ways of runs over them.

    φ is the angle from b_d to b. In space b turns about b_d too; that part of V, V_θ, is not in the picture.
    Each way starts at a dot.

    Args:
        law: whose V, or a `landscape.Landscape`.
        runs: towards a set-point; none for the contours alone.
        rod: the rod's name; the first by default.

    Raises:
        OptionError: gains that are no numbers, an unknown rod, a run without a set-point, or a path that cannot be
            written.
    """
    from tensegrity_mj.controllers.landscape import Landscape, angles

    shape = law if isinstance(law, Landscape) else Landscape.of(law, rod)
    all_runs = listed(runs) if isinstance(runs, Trajectory) or len(runs) else []
    ways = [angles(run, rod) for run in all_runs]
    top = max([1.0, *(1.1 * float(np.max(np.abs(way.phi_rate))) for way in ways)])
    figure = new_figure(6.4, 4.6)
    panel = figure.subplots()
    contours_of(panel, shape, top)
    for number, (run, way) in enumerate(zip(all_runs, ways, strict=True)):
        label = f"{law_name(run)}, {figure_text(run.engine or run.scene.name)}" if len(all_runs) > 1 else None
        color = palette.color_of(2 + number)
        panel.plot(way.phi, way.phi_rate, lw=1.6, ls=line_style(number), color=color, label=label)
        panel.plot(way.phi[:1], way.phi_rate[:1], marker="o", ms=5, ls="none", color=color)
    names = {None: "no projection", "current": r"onto $b^\perp$", "target": r"onto $b_d^\perp$"}
    name = names[shape.onto.value if shape.onto else None]
    gains = (
        rf"$\alpha = {shape.alpha:g}$, $\beta = {shape.beta:g}$, $\gamma = {shape.gamma:g}$, $K = {shape.stiffness:g}$"
    )
    over_time(panel, f"{name}: {gains}", r"$\dot\varphi$ [rad/s]")
    return saved(figure, path)


def contours_of(panel: Any, shape: Landscape, top: float) -> None:
    """Contours of V_φ over φ and φ̇ within ±top [rad/s]; axes with their labels."""
    phi, rate = np.linspace(-np.pi, np.pi, 361), np.linspace(-top, top, 241)
    contours = panel.contour(phi, rate, shape(phi, rate[:, None]), levels=24, cmap="viridis", linewidths=0.8)
    panel.figure.colorbar(contours, ax=panel, label=r"$V_\varphi$")
    panel.set_xlabel(r"$\varphi$ [rad]", fontsize=9)
    panel.set_xticks([-np.pi, -np.pi / 2, 0, np.pi / 2, np.pi], [r"$-\pi$", r"$-\pi/2$", "0", r"$\pi/2$", r"$\pi$"])
    panel.set_ylim(-top, top)


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
        note(panel, "exactly equal" if curves else "not compared")
        return
    panel.set_yscale("log")
    # A single value near zero, where a difference changes sign, must not squeeze the rest.
    top = float(sizes.max())
    low = max(float(np.quantile(sizes, 0.02)) / 3.0, top * 1e-9)
    room = 3.0 if len(curves) == 1 else 100.0  # for the legend
    panel.set_ylim(min(low, top / 3.0), room * top)
