"""Drawing of the thesis' figures: the first engine's curves as lines, the second's as circles upon them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from evidence.thesis import measures
from evidence.thesis.experiments import TITLES, EngineName, experiment_of
from evidence.thesis.landscape import draw_landscape
from evidence.thesis.statement import Runs
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.controllers import Lyapunov, Projection, from_scene
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import GREY, common_legend, equal_scales, frame, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MatplotlibFigure

Figure: TypeAlias = "MatplotlibFigure"
AllRuns = Mapping[EngineName, Runs]

BLUE, GREEN, RED = palette.CYCLE[:3]
BLACK = (0.1, 0.1, 0.1)
NAMED = {"blue": BLUE, "green": GREEN, "red": RED, "black": BLACK, "purple": palette.CYCLE[4]}
PANEL = (3.9, 2.6)  # inches
MARKS = 24  # circles along a curve
TIME = "time [s]"
BAND = "the pale band is the range of the thesis' axis"


@dataclass(frozen=True)
class ThesisFigure:
    """One figure of the thesis.

    Attributes:
        number: as in the thesis.
        page: of the thesis.
        title: what it shows, in our words.
        needs: the experiments, or series, that are drawn.
        draw: from the runs of the engines, in order; the first engine has all that are needed.
    """

    number: str
    page: int
    title: str
    needs: tuple[str, ...]
    draw: Callable[[AllRuns], Figure]


def panels(rows: int, columns: int, height: float = PANEL[1], width: float = PANEL[0]) -> tuple[Figure, Any]:
    """A figure with a grid of panels, as a (rows, columns) array."""
    figure = new_figure(columns * width, rows * height + 0.3)
    return figure, figure.subplots(rows, columns, squeeze=False)


def versions_of(all_runs: AllRuns, name: str) -> list[tuple[EngineName, Any]]:
    """The runs of an experiment, or of a series, of two engines at most."""
    return [(engine, runs[name]) for engine, runs in all_runs.items() if name in runs][:2]


def first_of(all_runs: AllRuns, name: str) -> Any:
    """The run of an experiment, or of a series or study, of the first engine that has it."""
    return next(runs[name] for runs in all_runs.values() if name in runs)


def curves(
    panel: Any,
    all_runs: AllRuns,
    name: str,
    values: Callable[[Any], Array],
    colors: Sequence[Any] = palette.CYCLE,
    *,
    over: Callable[[Any], Array] = attrgetter("time"),
    labels: Sequence[str] = (),
    marks: bool = True,
    **line: Any,
) -> None:
    """Draw a quantity over time, (T,) or (T, n); of the second engine as circles, of many curves only the first 24.

    `over` has what stands in place of the times, `line` is Matplotlib's, for the first engine's.
    """
    for number, (_, run) in enumerate(versions_of(all_runs, name)):
        x = over(run)
        found = np.asarray(values(run)).reshape(len(x), -1)
        for column, series in enumerate(found.T):
            color = colors[column % len(colors)]
            if number == 0:
                text = labels[column] if column < len(labels) and np.isfinite(series).any() else None
                panel.plot(x, series, **{"color": color, "lw": 1.1, "label": text, **line})
            elif marks and column < MARKS:
                every = max(1, len(x) // MARKS)
                # Shifted from curve to curve, so that circles of curves that coincide do not hide one another.
                first = (column * every) // max(1, min(found.shape[1], MARKS))
                circles(panel, x, series, color=color, markevery=(first, every))


def circles(panel: Any, *places: Any, color: Any, size: float = 3.2, width: float = 0.7, **more: Any) -> None:
    """The second engine's values at places, around those of the first."""
    panel.plot(*places, ls="none", marker="o", ms=size, mfc="none", mec=color, mew=width, **more)


def members(panel: Any, places: Array, rods: Any, strings: Any, width: float = 1.3, thin: float = 0.5) -> None:
    """Members of a structure, pairs of nodes, on a plane (N, 2), or in space (N, 3); in points, how wide they are."""
    for i, j in strings:
        panel.plot(*places[[i, j]].T, color=palette.TARGET, lw=thin)
    for i, j in rods:
        panel.plot(*places[[i, j]].T, color="black", lw=width, solid_capstyle="round")


def finish(panel: Any, title: str, unit: str, over: str = TIME) -> None:
    """Title, unit, what it is over, grid and legend in one style."""
    frame(panel, title, over, unit, small=0.5)
    if over == TIME:
        panel.margins(x=0.0)


def thesis_axis(panel: Any, low: float, high: float) -> None:
    """Show the range of the thesis' axis as a pale band, without cutting off what lies outside."""
    panel.axhspan(low, high, color=(0.12, 0.36, 0.78), alpha=0.05, lw=0)


def engines_note(
    figure: Figure,
    all_runs: AllRuns,
    extra: str = "",
    names: Sequence[str] = (),
    marks: Sequence[str] = ("lines", "circles"),
) -> None:
    """Say below the panels which engine is which, of those that have one of what is named, and how each is drawn."""
    engines = [TITLES[engine] for engine, runs in all_runs.items() if not names or not runs.keys().isdisjoint(names)]
    drawn = [f"{mark}: {engine}" for mark, engine in zip(marks, engines, strict=False)]
    note(figure, "; ".join([*drawn, *([extra] if extra else [])]))


def note(figure: Figure, text: str, size: float = 8) -> None:
    """Say something below the panels."""
    figure.supxlabel(text, fontsize=size, color=GREY)


def space_paths(
    all_runs: AllRuns, names: Sequence[str], colors: Sequence[str], labels: Sequence[str], title: str
) -> Figure:
    """Paths of the moving nodes in space, a colour of `NAMED` for each experiment; members of the last at its end.

    The second engine's are circles.
    """
    figure = new_figure(6.4, 5.8)
    axes: Any = figure.add_subplot(projection="3d")
    everything = []
    for name, color, label in zip(names, (NAMED[color] for color in colors), labels, strict=True):
        for number, (_, run) in enumerate(versions_of(all_runs, name)):
            everything.append(run.nodes.reshape(-1, 3))
            moving = np.flatnonzero(np.ptp(run.nodes, axis=0).max(axis=1) > 1e-9)
            for count, node in enumerate(moving):
                path = run.nodes[:, node].T
                if number == 0:
                    axes.plot(*path, color=color, lw=1.3, label=label if count == 0 else None)
                else:
                    every = max(1, len(run.time) // MARKS)
                    circles(axes, *path[:, ::every], color=color)
    run = first_of(all_runs, names[-1])
    structure, end = run.scene.structure, run.nodes[-1]
    members(axes, end, structure.rod_nodes, structure.string_nodes, 2.2, 0.7)
    equal_scales(axes, np.concatenate(everything))
    axes.set_title(title, fontsize=9.5)
    common_legend(figure, [axes], size=7.5)
    engines_note(figure, all_runs)
    return figure


def landscape(all_runs: AllRuns, names: Sequence[str], title: str) -> Figure:
    """Contours of V of an experiment's law over φ and φ̇, and the run's way over them."""
    (name,) = names
    experiment = experiment_of(name)
    law = from_scene(experiment.load(), experiment.law, **experiment.options)
    assert isinstance(law, Lyapunov | Projection)
    figure = draw_landscape(law, [run for _, run in versions_of(all_runs, name)])
    figure.axes[0].set_title(title, fontsize=9.5)
    engines_note(figure, all_runs, "the dot is the start", marks=("full", "dashed"))
    return figure


def snapshots(
    all_runs: AllRuns, names: Sequence[str], times: Sequence[float], axes: Sequence[float], height: float
) -> Figure:
    """Figures 4.2 and 4.8: the first engine's structure at some times, with the second engine's nodes as circles.

    Args:
        axes: in x and in y [m], from and to.
    """
    (name,) = names
    broad = height * (axes[1] - axes[0]) / (axes[3] - axes[2])
    figure, grid = panels(len(times) // 2, 2, height=height, width=broad)
    for panel, time in zip(grid.ravel(), times, strict=True):
        for number, (_, run) in enumerate(versions_of(all_runs, name)):
            nodes, structure = measures.at(run, time, run.nodes)[:, [0, 2]], run.scene.structure
            if number == 0:
                width = 1.2 if len(structure.rods) > 4 else 2.2
                members(panel, nodes, structure.rod_nodes, structure.string_nodes, width, 0.7)
            else:
                circles(panel, *nodes.T, color=RED, size=3.5, width=0.6)
        panel.set_xlim(*axes[:2])
        panel.set_ylim(*axes[2:])
        panel.set_aspect("equal")
        finish(panel, f"t = {time:.2f} s", "y [m]", "x [m]")
    engines_note(figure, all_runs)
    return figure
