"""What plots of runs are made of: panels of controls and multipliers, rows of panels, and the runs that are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import COLUMN, MAX_LEGEND, ROW, frame, new_figure, note
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def over_time(panel: Axes, title: str, unit: str) -> None:
    """The frame of curves over time."""
    frame(panel, title, y=unit)
    panel.margins(x=0.0)


def controls(panel: Axes, run: Trajectory) -> None:
    count = run.force_densities.shape[1]
    for a in range(count):
        label = f"$u_{{{a + 1}}}$" if count <= MAX_LEGEND else None
        panel.plot(run.time, run.force_densities[:, a], color=palette.color_of(a), lw=1.1, label=label)
    names = "" if count == 0 else "$u_1$" if count == 1 else f"$u_1 \\ldots u_{{{count}}}$"
    over_time(panel, f"Controls {names}", "force density [N/m]")
    if count == 0:
        note(panel, "no strings")


def multipliers(panel: Axes, run: Trajectory, rods: Sequence[int]) -> None:
    for a in rods:
        label = rf"$\lambda_{{{a + 1}}}$" if 1 < len(rods) <= MAX_LEGEND else None
        panel.plot(run.time, run.multipliers[:, a], color=palette.color_of(a), lw=1.1, label=label)
    count = len(rods)
    names = r"$\lambda$" if count == 1 else rf"$\lambda_1 \ldots \lambda_{{{count}}}$" if count else ""
    over_time(panel, f"Lagrange multiplier{'s' if count > 1 else ''} {names}", r"$\lambda$ [1/s²]")
    if count == 0:
        note(panel, "no rods")


def rows_of_panels(runs: Sequence[Trajectory]) -> tuple[Figure, Any]:
    """A row of three panels for each run; panels of a column share their scales."""
    figure = new_figure(3 * COLUMN, ROW * len(runs) + 0.45 * (1 + len(runs)))
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


def listed(runs: Trajectory | Sequence[Trajectory]) -> list[Trajectory]:
    found = [runs] if isinstance(runs, Trajectory) else list(runs)
    if not found:
        raise OptionError("a plot needs at least one run; none was given")
    for run in found:
        if not isinstance(run, Trajectory):
            raise OptionError(f"a plot is made of Trajectory objects, not of a {type(run).__name__}")
        if len(run.time) == 0:
            raise OptionError(f"the trajectory of scene '{run.scene.name}' ({run.engine}) has no samples to plot")
    return found


def rod_index(run: Trajectory, rod: str | None) -> int:
    names = [r.name for r in run.scene.structure.rods]
    if not names:
        raise OptionError(f"scene '{run.scene.name}' has no rods; plot_errors shows its point masses")
    if rod is None:
        return 0
    if rod not in names:
        raise OptionError(f"rod={rod!r}: scene '{run.scene.name}' has no such rod; its rods are {', '.join(names)}")
    return names.index(rod)


def target_nodes(run: Trajectory) -> Array | None:
    """Target node positions (T, N, 3) [m] at the run's times, or None."""
    from tensegrity_mj.dynamics.target import target_positions

    return target_positions(run.scene.structure, run.scene.target, run.time)


def law_name(run: Trajectory) -> str:
    """The law of a run as its provenance has it, with what it projects onto and its decay rate."""
    law = run.provenance.get("controller") or {}
    onto = f" onto {law['onto']}" if "onto" in law else ""
    rate = law.get("decay_rate")
    pace = f", δ = {rate:g} /s" if isinstance(rate, (int, float)) else ""
    return figure_text(f"{law.get('law', 'law')}{onto}{pace}")
