"""Plots of runs that a reader of the thesis recognises (figures 5.1 to 6.9), and comparisons of runs.

Every function returns a matplotlib Figure and writes it where a path is given (.png, .pdf or .svg). Figures are made
without pyplot: nothing global is touched, no window opens, and they can be made in any thread. For example:

    tmj.plots.plot_run([run, reference], "prism.png")     # a row for each run
    tmj.plots.plot_paths([run, reference], "paths.png")
    tmj.plots.plot_comparison(tmj.compare(run, reference), "comparison.png", runs=[run, reference])
    tmj.plots.plot_lyapunov(run, "v.png")
    tmj.plots.landscape(law, run, "landscape.png")        # V over φ and φ̇, with the run's way over it
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures import palette
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tensegrity_mj.controllers import Lyapunov, Projection
    from tensegrity_mj.controllers.landscape import Landscape
    from tensegrity_mj.runs.clearances import Clearance

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

PathLike = str | os.PathLike[str]

SUFFIXES = (".png", ".pdf", ".svg")
DPI = 130
ROW, COLUMN = 2.5, 3.9  # inches, a panel
MAX_LEGEND = 8  # entries
RUN_STYLES = ("-", "--", ":", "-.")
GREY = (0.45, 0.47, 0.5)


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
    all_runs = _listed(runs)
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
    all_runs = _listed(runs)
    figure, panels = _grid_of_panels(all_runs)
    for run, row in zip(all_runs, panels, strict=True):
        which = _rod_index(run, rod)
        b = _directions(run, run.nodes)[:, which]
        aim = _target_nodes(run)
        for axis, name in enumerate("xyz"):
            row[0].plot(run.time, b[:, axis], color=palette.CYCLE[axis], lw=1.3, label=f"$b_{name}$")
        if aim is not None:
            goal = _directions(run, aim)[:, which]
            for axis in range(3):
                label = "$b_d$" if axis == 0 else None
                row[0].plot(run.time, goal[:, axis], color=palette.CYCLE[axis], lw=1.2, ls=":", label=label)
        row[0].plot(run.time, np.sum(b * b, axis=1), color="black", lw=1.0, ls="--", label=r"$\|b\|^2$")
        rods = run.scene.structure.rods
        of_which = f" of rod {figure_text(rods[which].name)}" if len(rods) > 1 else ""
        _finish(row[0], f"Coordinates $b$ and $b_d${of_which}", "component of the unit vector [1]")
        _controls(row[1], run)
        _multipliers(row[2], run, [which])
    return _saved(figure, path)


def plot_errors(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figure 5.7: for each rod (blue, green, red, ...) ‖e_b‖ full and ‖e_r‖ dashed; u; λ.

    Without a target, the first column shows how far b and r are from where they started. Point masses are dotted.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    all_runs = _listed(runs)
    figure, panels = _grid_of_panels(all_runs)
    for run, row in zip(all_runs, panels, strict=True):
        structure, aim = run.scene.structure, _target_nodes(run)
        reference = run.nodes[:1] if aim is None else aim
        sign = "\\Delta " if aim is None else "e_"
        b_error = np.linalg.norm(_directions(run, run.nodes) - _directions(run, reference), axis=-1)
        r_error = np.linalg.norm(_points(run, run.nodes) - _points(run, reference), axis=-1)
        labelled = len(structure.rods) <= MAX_LEGEND // 2
        for a in range(len(structure.rods)):
            color = _color(a)
            for values, style, letter in ((b_error, "-", "b"), (r_error, "--", "r")):
                if letter == "r" and not np.any(r_error[:, a] > 1e-12):
                    continue  # a pinned rod's r cannot move
                label = rf"$\|{sign}{{{letter}_{{{a + 1}}}}}\|$" if labelled else None
                row[0].plot(run.time, values[:, a], color=color, lw=1.2, ls=style, label=label)
        for k, mass in enumerate(structure.point_masses):
            i = structure.node_index[mass.node]
            distance = np.linalg.norm(run.nodes[:, i] - reference[:, i], axis=-1)
            label = figure_text(mass.node) if len(structure.point_masses) <= MAX_LEGEND // 2 else None
            row[0].plot(run.time, distance, color=_color(k), lw=1.2, ls=":", label=label)
        title = "Change since the start" if aim is None else r"Errors $\|e_b\|$ (full), $\|e_r\|$ (dashed)"
        _finish(row[0], title, r"$b$ [1], $r$ [m]")
        _controls(row[1], run)
        _multipliers(row[2], run, range(len(structure.rods)))
    return _saved(figure, path)


def plot_paths(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figures 5.3 and 5.6: the paths of the nodes, a colour for each run, and the rods at the end in black.

    Strings at the end are grey, the target's rods dotted, fixed points squares. All runs share one picture; a later
    run is dashed, so that one that it covers shows.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    from tensegrity_mj.pictures.painter import supported_points

    all_runs = _listed(runs)
    figure = _figure(6.4, 5.6)
    axes: Any = figure.add_subplot(projection="3d")
    everything = []
    for number, run in enumerate(all_runs):
        structure, end = run.scene.structure, run.nodes[-1]
        moving = np.flatnonzero(np.ptp(run.nodes, axis=0).max(axis=1) > 1e-9)
        style = RUN_STYLES[number % len(RUN_STYLES)]
        for count, node in enumerate(moving):
            label = figure_text(run.engine or run.scene.name) if count == 0 else None
            axes.plot(*run.nodes[:, node].T, color=_color(number), lw=1.2, ls=style, label=label)
        for i, j in structure.string_nodes:
            axes.plot(*end[[i, j]].T, color=(0.7, 0.72, 0.75), lw=0.7)
        for i, j in structure.rod_nodes:
            axes.plot(*end[[i, j]].T, color="black", lw=2.2, solid_capstyle="round")
        for point, held in supported_points(structure, end):
            axes.plot(*point[:, None], marker="s", color="black" if held == 3 else GREY, ms=5)
        everything.append(run.nodes.reshape(-1, 3))
        aim = _target_nodes(run)
        if aim is not None:
            for i, j in structure.rod_nodes:
                axes.plot(*aim[-1, [i, j]].T, color=palette.TARGET, lw=1.6, ls=":")
            everything.append(aim[-1])
    _equal_scales(axes, np.concatenate(everything))
    ends = ", ".join(dict.fromkeys(f"{run.time[-1]:g} s" for run in all_runs))
    axes.set_title(f"{figure_text(all_runs[0].scene.name)}: paths of the nodes, rods at {ends}", fontsize=10)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False, loc="upper left")
    return _saved(figure, path)


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
    figure = _figure(3 * COLUMN, 2 * ROW + 0.6)
    panels = figure.subplots(2, 3, sharex=True)
    for panel, (name, (title, unit)) in zip(panels.ravel(), DIFFERENCES.items(), strict=True):
        curves: list[_Curve] = []
        if getattr(comparison, name, None) is not None:
            label = "difference" if name == "energy_error" and runs else None
            values = np.asarray(getattr(comparison, name), float)
            curves.append((time, values, "black" if label else _color(0), "-", label))
        if name == "energy_error":
            for number, run in enumerate(runs):
                # The engine's name alone: its options are in the title.
                label = f"balance of {figure_text(run.engine.partition(',')[0]) or f'run {number + 1}'}"
                style = RUN_STYLES[number % len(RUN_STYLES)]
                curves.append((run.time, run.energy_balance, _color(number), style, label))
        _logarithmic(panel, curves)
        _finish(panel, title, f"largest difference [{unit}]" if len(curves) == 1 else f"magnitude [{unit}]")
    for panel in panels[-1]:
        panel.set_xlabel("time [s]", fontsize=9)
    names = [getattr(comparison, name, "") for name in ("first", "second")]
    if all(names):
        figure.suptitle(" against ".join(map(figure_text, names)), fontsize=11)
    return _saved(figure, path)


def plot_clearance(clearance: Clearance, path: PathLike | None = None) -> Figure:
    """The smallest distances of each kind of pairs over time at the samples, and the smallest of all as dots.

    Args:
        clearance: from `tmj.clearance(run, over_time=True)`.

    Raises:
        OptionError: one of a single shape or without `over_time`, or a path that cannot be written.
    """
    if clearance.over_time is None or clearance.samples < 2:
        raise OptionError("plot_clearance: there are no distances over time: use tmj.clearance(run, over_time=True)")
    figure = _figure(1.8 * COLUMN, 1.3 * ROW)
    panel = figure.subplots()
    for color, (kind, values) in enumerate(clearance.over_time.items()):
        approach = clearance.smallest[kind]
        if approach is None:
            continue
        shown = np.where(np.isfinite(values), values, np.nan)
        panel.plot(clearance.time, shown, color=_color(color), lw=1.2, label=kind.value)
        panel.plot([approach.time], [approach.distance], color=_color(color), marker="o", ms=4, ls="none")
    _finish(panel, f"{figure_text(clearance.name)}: smallest distances between elements", "distance [m]")
    panel.axhline(0.0, color=GREY, lw=0.8)
    panel.set_xlabel("time [s]", fontsize=9)
    return _saved(figure, path)


def plot_lyapunov(runs: Trajectory | Sequence[Trajectory], path: PathLike | None = None) -> Figure:
    """Figure 6.6: V over time in blue, its terms in the errors alone in red, those with velocities in green.

    Raises:
        OptionError: no run, an empty one, one whose law has no V, or a path that cannot be written.
    """
    all_runs = _listed(runs)
    figure = _figure(COLUMN * max(len(all_runs), 1.5), 1.2 * ROW)
    panels = np.atleast_1d(np.asarray(figure.subplots(1, len(all_runs)), dtype=object))
    parts = (("lyapunov", 0, "$V$"), ("lyapunov_error", 2, "errors"), ("lyapunov_velocity", 1, "velocities"))
    for run, panel in zip(all_runs, panels, strict=True):
        if not np.any(np.isfinite(run.lyapunov_error)):
            raise OptionError(f"the run of scene '{run.scene.name}' ({run.engine}) had no law with a Lyapunov function")
        for name, color, label in parts:
            panel.plot(run.time, getattr(run, name), color=palette.CYCLE[color], lw=1.2, label=label)
        _finish(panel, f"{figure_text(run.scene.name)}\n{_law_name(run)}", "$V$ and its terms")
        panel.set_xlabel("time [s]", fontsize=9)
    return _saved(figure, path)


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
    all_runs = _listed(runs) if isinstance(runs, Trajectory) or len(runs) else []
    ways = [angles(run, rod) for run in all_runs]
    top = max([1.0, *(1.1 * float(np.max(np.abs(way.phi_rate))) for way in ways)])
    phi, rate = np.linspace(-np.pi, np.pi, 361), np.linspace(-top, top, 241)
    figure = _figure(6.4, 4.6)
    panel = figure.subplots()
    contours = panel.contour(phi, rate, shape(phi, rate[:, None]), levels=24, cmap="viridis", linewidths=0.8)
    figure.colorbar(contours, ax=panel, label=r"$V_\varphi$")
    for number, (run, way) in enumerate(zip(all_runs, ways, strict=True)):
        color = _color(2 + number)
        label = f"{_law_name(run)}, {figure_text(run.engine or run.scene.name)}" if len(all_runs) > 1 else None
        panel.plot(way.phi, way.phi_rate, lw=1.6, ls=RUN_STYLES[number % len(RUN_STYLES)], color=color, label=label)
        panel.plot(way.phi[:1], way.phi_rate[:1], marker="o", ms=5, ls="none", color=color)
    names = {None: "no projection", "current": r"onto $b^\perp$", "target": r"onto $b_d^\perp$"}
    name = names[shape.onto.value if shape.onto else None]
    gains = (
        rf"$\alpha = {shape.alpha:g}$, $\beta = {shape.beta:g}$, $\gamma = {shape.gamma:g}$, $K = {shape.stiffness:g}$"
    )
    _finish(panel, f"{name}: {gains}", r"$\dot\varphi$ [rad/s]")
    panel.set_xlabel(r"$\varphi$ [rad]", fontsize=9)
    panel.set_xticks([-np.pi, -np.pi / 2, 0, np.pi / 2, np.pi], [r"$-\pi$", r"$-\pi/2$", "0", r"$\pi/2$", r"$\pi$"])
    panel.set_ylim(-top, top)
    return _saved(figure, path)


def save_figure(figure: Figure, path: PathLike) -> Path:
    """Write a figure as .png, .pdf or .svg, as a whole or not at all; returns the path.

    Raises:
        OptionError: a path that cannot be written.
    """
    destination = checked(path, SUFFIXES, "plot")
    with replacing(destination) as part:
        # Without dates the same figure gives the same file.
        metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(destination.suffix.lower(), {})
        figure.savefig(part, dpi=DPI, metadata=metadata)
    return destination


# ------------------------------------------------------------------------------------------------------- panels


def _controls(panel: Axes, run: Trajectory) -> None:
    count = run.force_densities.shape[1]
    for a in range(count):
        label = f"$u_{{{a + 1}}}$" if count <= MAX_LEGEND else None
        panel.plot(run.time, run.force_densities[:, a], color=_color(a), lw=1.1, label=label)
    names = "" if count == 0 else "$u_1$" if count == 1 else f"$u_1 \\ldots u_{{{count}}}$"
    _finish(panel, f"Controls {names}", "force density [N/m]")
    if count == 0:
        _note(panel, "no strings")


def _multipliers(panel: Axes, run: Trajectory, rods: Sequence[int]) -> None:
    for a in rods:
        label = rf"$\lambda_{{{a + 1}}}$" if 1 < len(rods) <= MAX_LEGEND else None
        panel.plot(run.time, run.multipliers[:, a], color=_color(a), lw=1.1, label=label)
    count = len(rods)
    names = r"$\lambda$" if count == 1 else rf"$\lambda_1 \ldots \lambda_{{{count}}}$" if count else ""
    _finish(panel, f"Lagrange multiplier{'s' if count > 1 else ''} {names}", r"$\lambda$ [1/s²]")
    if count == 0:
        _note(panel, "no rods")


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
        _note(panel, "exactly equal" if curves else "not compared")
        return
    panel.set_yscale("log")
    # A single value near zero, where a difference changes sign, must not squeeze the rest.
    top = float(sizes.max())
    low = max(float(np.quantile(sizes, 0.02)) / 3.0, top * 1e-9)
    room = 3.0 if len(curves) == 1 else 100.0  # for the legend
    panel.set_ylim(min(low, top / 3.0), room * top)


def _finish(panel: Axes, title: str, unit: str) -> None:
    panel.set_title(title, fontsize=10)
    panel.set_ylabel(unit, fontsize=9)
    panel.grid(True, color=(0.9, 0.91, 0.92), lw=0.7)
    panel.set_axisbelow(True)
    panel.margins(x=0.0)
    panel.tick_params(labelsize=8, color=GREY)
    for side in panel.spines.values():
        side.set_color(GREY)
        side.set_linewidth(0.7)
    handles, labels = panel.get_legend_handles_labels()
    if handles:
        columns = 2 if len(handles) > 4 else 1
        panel.legend(handles, labels, fontsize=7.5, frameon=True, framealpha=0.75, edgecolor="none", ncols=columns)


def _note(panel: Axes, text: str) -> None:
    panel.text(0.5, 0.5, text, transform=panel.transAxes, ha="center", va="center", color=GREY, fontsize=9)


def _equal_scales(axes: Any, points: Array) -> None:
    """The same scale on all three axes, with nothing cut off."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.max(high - low)) or 1.0
    half = np.maximum(0.5 * (high - low), 0.15 * size) * 1.05
    middle = 0.5 * (low + high)
    for name, m, h in zip("xyz", middle, half, strict=True):
        getattr(axes, f"set_{name}lim")(m - h, m + h)
        getattr(axes, f"set_{name}label")(f"{name} [m]", fontsize=9)
    axes.set_box_aspect(half)
    axes.tick_params(labelsize=7)
    axes.view_init(elev=22.0, azim=-55.0)


# ------------------------------------------------------------------------------------------------------- figures


def _figure(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as MatplotlibFigure

    figure = MatplotlibFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _grid_of_panels(runs: Sequence[Trajectory]) -> tuple[Figure, Any]:
    """A row of three panels for each run; panels of a column share their scales."""
    figure = _figure(3 * COLUMN, ROW * len(runs) + 0.45 * (1 + len(runs)))
    rows = np.atleast_1d(np.asarray(figure.subfigures(len(runs), 1), dtype=object))
    panels = [row.subplots(1, 3) for row in rows]
    for column in range(3):
        for other in panels[1:]:
            other[column].sharex(panels[0][column])
            other[column].sharey(panels[0][column])
    for row, run in zip(rows, runs, strict=True):
        note = "" if run.status.value == "completed" else f" ({run.status.value})"
        name = figure_text(run.scene.name)
        row.suptitle(f"{name}: {figure_text(run.engine)}{note}" if run.engine else name, fontsize=11)
    for panel in panels[-1]:
        panel.set_xlabel("time [s]", fontsize=9)
    return figure, panels


def _saved(figure: Figure, path: PathLike | None) -> Figure:
    if path is not None:
        save_figure(figure, path)
    return figure


# ------------------------------------------------------------------------------------------------------- data


def _listed(runs: Trajectory | Sequence[Trajectory]) -> list[Trajectory]:
    found = [runs] if isinstance(runs, Trajectory) else list(runs)
    if not found:
        raise OptionError("a plot needs at least one run; none was given")
    for run in found:
        if not isinstance(run, Trajectory):
            raise OptionError(f"a plot is made of Trajectory objects, not of a {type(run).__name__}")
        if len(run.time) == 0:
            raise OptionError(f"the trajectory of scene '{run.scene.name}' ({run.engine}) has no samples to plot")
    return found


def _rod_index(run: Trajectory, rod: str | None) -> int:
    names = [r.name for r in run.scene.structure.rods]
    if not names:
        raise OptionError(f"scene '{run.scene.name}' has no rods; plot_errors shows its point masses")
    if rod is None:
        return 0
    if rod not in names:
        raise OptionError(f"rod={rod!r}: scene '{run.scene.name}' has no such rod; its rods are {', '.join(names)}")
    return names.index(rod)


def _directions(run: Trajectory, nodes: Array) -> Array:
    """b (T, R, 3) of (2.4): from a rod's first node to its second, over its length."""
    structure = run.scene.structure
    pairs = structure.rod_nodes
    return (nodes[:, pairs[:, 1]] - nodes[:, pairs[:, 0]]) / structure.rod_lengths[:, None]


def _points(run: Trajectory, nodes: Array) -> Array:
    """r (T, R, 3) [m] of (2.6): the point (1 - σ) n_i + σ n_j of each rod."""
    structure = run.scene.structure
    pairs = structure.rod_nodes
    sigma = np.array([rod.support.sigma for rod in structure.rods])[:, None]
    return (1.0 - sigma) * nodes[:, pairs[:, 0]] + sigma * nodes[:, pairs[:, 1]]


def _target_nodes(run: Trajectory) -> Array | None:
    """Target node positions (T, N, 3) [m] at the run's times, or None."""
    from tensegrity_mj.dynamics.target import target_positions

    return target_positions(run.scene.structure, run.scene.target, run.time)


def _law_name(run: Trajectory) -> str:
    """The law of a run as its provenance has it, with what it projects onto and its decay rate."""
    law = run.provenance.get("controller") or {}
    onto = f" onto {law['onto']}" if "onto" in law else ""
    rate = law.get("decay_rate")
    pace = f", δ = {rate:g} /s" if isinstance(rate, (int, float)) else ""
    return figure_text(f"{law.get('law', 'law')}{onto}{pace}")


def _color(number: int) -> palette.Color:
    return palette.CYCLE[number % len(palette.CYCLE)]
