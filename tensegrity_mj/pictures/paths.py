"""The paths of nodes in space, or in the plane that they stay in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.pictures import figure, palette
from tensegrity_mj.pictures.run_panels import listed, target_nodes
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STRING = (0.70, 0.72, 0.75)
FLAT = 1e-3  # of the extent: paths that stay as near to a plane across an axis are drawn in that plane
SIZE = 6.4  # inches


def plot_paths(runs: Trajectory | Sequence[Trajectory], path: figure.PathLike | None = None) -> Figure:
    """Figures 5.3 and 5.6: the paths of the nodes, a colour for each run, and the rods at the end in black.

    Strings at the end are grey, the target's rods broad and pale, fixed points squares. All runs share one picture; a
    later run is thin and dashed, so that one that it covers shows. What stays in a plane across x, y or z is drawn in
    that plane.

    Raises:
        OptionError: no run, an empty one, or a path that cannot be written.
    """
    all_runs = listed(runs)
    aims = [target_nodes(run) for run in all_runs]
    points = [run.nodes.reshape(-1, 3) for run in all_runs] + [aim[-1] for aim in aims if aim is not None]
    panel, shown = _space(np.concatenate(points))
    for number, (run, aim) in enumerate(zip(all_runs, aims, strict=True)):
        _draw(panel, shown, run, aim, number)
    ends = ", ".join(dict.fromkeys(f"{run.time[-1]:g} s" for run in all_runs))
    title = f"{figure_text(all_runs[0].scene.name)}: paths of the nodes, rods at {ends}"
    if len(shown) == 2:
        figure.frame(panel, title, *(f"{'xyz'[axis]} [m]" for axis in shown))
    else:
        panel.set_title(title, fontsize=10)
        figure.common_legend(panel.figure, [panel])
    return figure.saved(panel.figure, path)


def _space(points: Array) -> tuple[Any, list[int]]:
    """An empty panel for points (n, 3) [m], of three axes or of the two that they spread in; those axes."""
    spread = np.ptp(points, axis=0)
    thin = int(np.argmin(spread))
    if spread[thin] > FLAT * float(spread.max()):
        panel: Any = figure.new_figure(SIZE, 0.85 * SIZE).add_subplot(projection="3d", computed_zorder=False)
        figure.equal_scales(panel, points)
        return panel, [0, 1, 2]
    shown = [axis for axis in range(3) if axis != thin]
    wide, tall = np.maximum(spread[shown], 0.1 * float(spread.max()) or 1.0)
    panel = figure.new_figure(SIZE, float(np.clip(SIZE * tall / wide, 0.22 * SIZE, SIZE)) + 0.9).subplots()
    panel.set_aspect("equal", adjustable="datalim")
    panel.margins(0.06)
    return panel, shown


def _draw(panel: Any, axes: list[int], run: Trajectory, aim: Array | None, number: int) -> None:
    """One run: its paths, where it ends, and its target."""
    from tensegrity_mj.pictures.supports import supported_points

    def lines(pieces: Array, **look: Any) -> None:
        """Pieces (n, P, 3) as one curve with gaps."""
        gaps = np.full((len(pieces), 1, 3), np.nan)
        joined = np.concatenate([pieces, gaps], axis=1).reshape(-1, 3)[:-1]
        panel.plot(*joined[:, axes].T, **look)

    structure, end = run.scene.structure, run.nodes[-1]
    moving = np.ptp(run.nodes, axis=0).max(axis=1) > 1e-9
    if moving.any():
        width = (1.2 if moving.sum() <= 2 * figure.MAX_LEGEND else 0.6) * (1.0 if number else 2.0)
        label = figure_text(run.engine.partition(",")[0] or run.scene.name)
        look = {"color": palette.color_of(2 * number), "ls": figure.line_style(number), "lw": width}
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
        panel.plot(*point[axes][:, None], marker="s", color="black" if held == 3 else figure.GREY, ms=5)
