"""A run or a comparison at a glance: some lines of text; of a run for notebooks also a table with a plot."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import shortened
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import printable
from tensegrity_mj.runs.differences import DIFFERENCES

if TYPE_CHECKING:
    from tensegrity_mj.runs.comparison import Comparison
    from tensegrity_mj.runs.trajectory import Trajectory

MOST_LETTERS = 100  # of a line
# What a comparison's lines have.
GROUPS = {
    "motion": ("node_error", "velocity_error"),
    "forces": ("tension_error", "rod_force_error", "force_density_error"),
    "others": ("rest_length_error", "energy_error"),
}
MOST_CURVES, MOST_POINTS = 8, 240
WIDTH, HEIGHT, LEFT, RIGHT, EDGE = 560, 180, 70, 90, 18  # px of the plot, and of its margins
# Okabe and Ito's colours, which the colour-blind tell apart (https://jfly.uni-koeln.de/color/).
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999")


def rows_of(run: Trajectory) -> list[tuple[str, str]]:
    """What it is, engine, time, status, and what is to be known of its errors: a name and a line each."""
    structure = run.scene.structure
    size = f"{len(structure.nodes)} nodes, {len(structure.rods)} rods, {len(structure.strings)} strings"
    span = f"{run.time[0]:g} to {run.time[-1]:g} s, " if len(run.time) else ""
    warnings = run.reports.get("warnings", [])
    error = f"energy off by {run.energy_residual:.2g} J"
    if warnings:
        error += f"; {len(warnings)} warning{'s' * (len(warnings) > 1)}: {warnings[0]}"
    rows = [
        ("run of", f"{run.scene.name}: {size}"),
        ("engine", run.engine),
        ("time", f"{span}{len(run.time)} samples"),
        ("status", run.status.value + (f": {run.message}" if run.message else "")),
        ("errors", error),
    ]
    return [(name, shortened(printable(text), MOST_LETTERS)) for name, text in rows]


def rows_of_comparison(comparison: Comparison) -> list[tuple[str, str]]:
    """What was compared, when, the largest differences in their units, and which are beyond their tolerances."""
    between = " and ".join(name or "a run" for name in (comparison.first, comparison.second))
    time = comparison.time
    rows = [("between", between), ("time", f"{time[0]:g} to {time[-1]:g} s, {len(time)} common times")]
    for group, names in GROUPS.items():
        found = [
            f"{DIFFERENCES[name].words.removesuffix(' error')} "
            f"{quantity(getattr(comparison, f'max_{name}'), DIFFERENCES[name].unit)}"
            for name in names
            if name in comparison.compared
        ]
        rows += [(group, ", ".join(found))] if found else []
    beyond = [
        f"{DIFFERENCES[name].words} from {quantity(since, 's')} "
        f"({quantity(comparison.tolerance_of(name), DIFFERENCES[name].unit)})"
        for name, since in comparison.first_exceeded.items()
        if since is not None
    ]
    rows.append(("beyond", ", ".join(beyond) or f"no tolerance ({comparison.tolerance:g} in SI units by default)"))
    return rows


def html_of(run: Trajectory) -> str:
    """The same as a table, and the largest tensions over time below it, or the nodes' heights where nothing pulls."""
    cells = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in rows_of(run))
    structure = run.scene.structure
    if run.tensions.any():
        plot = _svg(run.time, run.tensions, [string.name for string in structure.strings], "tension [N]")
    else:
        plot = _svg(run.time, run.nodes[:, :, 2], list(structure.node_names), "height z [m]")
    return f"<table>{cells}</table>{plot}"


def _svg(time: Array, values: Array, names: list[str], title: str) -> str:
    """A picture of the curves (T, K) that are largest; nothing of one that has no extent."""
    good = np.isfinite(values).all(axis=1)
    time, values = time[good], values[good]
    if len(time) < 2 or not values.size:
        return ""
    largest = np.argsort(-np.abs(values).max(axis=0), kind="stable")[:MOST_CURVES]
    rows = np.unique(np.linspace(0, len(time) - 1, MOST_POINTS).astype(int))
    low, high = float(values[:, largest].min()), float(values[:, largest].max())
    across = LEFT + (WIDTH - LEFT - RIGHT) * (time[rows] - time[0]) / (time[-1] - time[0])
    down = HEIGHT - EDGE - (HEIGHT - 2 * EDGE) * (values[rows] - low) / ((high - low) or 1.0)
    parts = []
    for place, number in enumerate(largest):
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, down[:, number], strict=True))
        color, y = COLORS[place], EDGE * (place + 1.5)
        parts.append(f'<polyline points="{points}" fill="none" stroke="{color}"/>')
        name = escape(shortened(printable(names[number]), MOST_LETTERS))
        parts.append(f'<text x="{WIDTH - RIGHT + 8}" y="{y}" fill="{color}">{name}</text>')
    label, right = f'x="{LEFT - 6}" text-anchor="end"', f'x="{WIDTH - RIGHT}" text-anchor="end"'
    parts += [
        f'<text x="{LEFT}" y="{EDGE - 6}">{title}</text>',
        f'<text {label} y="{EDGE + 4}">{high:.3g}</text><text {label} y="{HEIGHT - EDGE}">{low:.3g}</text>',
        f'<text x="{LEFT}" y="{HEIGHT - 4}">{time[0]:g} s</text><text {right} y="{HEIGHT - 4}">{time[-1]:g} s</text>',
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" font-size="11" '
        f'font-family="sans-serif" style="background:white">{"".join(parts)}</svg>'
    )
