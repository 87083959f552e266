"""Panels of plots of runs: one quantity each, in rows, and the runs that are drawn.

Of many members in one panel at most eight have names, and the rest are a band. Members that are alike, by their names
or by symmetry, are drawn together: their mean, and a band from the least to the largest. Where they differ, as under a
control law, the largest are drawn each, and a band holds all others.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.members import Rod, String
from tensegrity_mj.model.rods import lumped_masses
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures import figure as figures
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import COLUMN, GREY, MAX_LEGEND, ROW, Axes, Figure, frame, note
from tensegrity_mj.pictures.motion import down_of
from tensegrity_mj.runs.trajectory import Trajectory

Group = tuple[str, NDArray[np.int64]]  # a label, and the rows of its members
WIDTH = 1.2  # points
DIGITS = 6  # in which members that are alike agree


def draw_curves(
    panel: Axes,
    time: Array,
    values: Array,
    names: Sequence[str],
    groups: Sequence[Group] = (),
    sizes: Array | None = None,
) -> None:
    """Draw values (T, n) of members over time, of more than eight by their groups, or the largest by `sizes` (T, n).

    `sizes` are the values themselves by default. What is NaN leaves a gap.
    """
    count = values.shape[1]
    if count > MAX_LEGEND and groups:
        for number, (label, rows) in enumerate(groups):
            color, style = palette.look_of(number)
            one = values[:, rows]
            panel.plot(time, one.mean(axis=1), color=color, ls=style, lw=WIDTH, label=figure_text(label))
            panel.fill_between(time, one.min(axis=1), one.max(axis=1), color=color, alpha=0.2, lw=0.0)
        return
    shown = largest(values if sizes is None else sizes, MAX_LEGEND)
    rest = np.delete(values, shown, axis=1)
    for number, member in enumerate(shown):
        color, style = palette.look_of(number)
        name = figure_text(names[member]) if count > 1 else None
        panel.plot(time, values[:, member], color=color, ls=style, lw=WIDTH, label=name)
    if rest.shape[1]:
        low, high = np.fmin.reduce(rest, axis=1), np.fmax.reduce(rest, axis=1)
        panel.fill_between(time, low, high, color=palette.BAND, lw=0.0, label=f"{rest.shape[1]} others", zorder=1.0)


def largest(values: Array, count: int) -> NDArray[np.int64]:
    """The columns, in their order, of at most `count` curves (T, n) that come farthest from zero."""
    if values.shape[1] <= count:
        return np.arange(values.shape[1])
    peak = np.nan_to_num(np.fmax.reduce(np.abs(values), axis=0), nan=-1.0)
    return np.sort(np.argsort(-peak, kind="stable")[:count])


def string_groups(structure: Structure) -> list[Group]:
    """Strings of a group, else with names that begin alike, else of one stiffness and rest length.

    There are two to eight groups, or none. A symmetry of a structure takes a string to one with the same stiffness
    and rest length.
    """
    keys = np.column_stack([structure.stiffness, structure.rest_lengths])
    several = len(np.unique(structure.stiffness)) > 1

    def label(row: int) -> str:
        stiffness = f"k = {quantity(float(keys[row, 0]), 'N/m')}, " if several else ""
        return f"{stiffness}L₀ = {quantity(float(keys[row, 1]), 'm')}"

    return _alike(structure.strings, keys, label)


def rod_groups(structure: Structure) -> list[Group]:
    """Rods of a group, else with names that begin alike, else of one length and mass; two to eight groups, or none."""
    keys = np.column_stack([structure.rod_lengths, structure.rod_masses])

    def label(row: int) -> str:
        return f"{quantity(float(keys[row, 0]), 'm')}, {quantity(float(keys[row, 1]), 'kg')}"

    return _alike(structure.rods, keys, label)


def _alike(members: Sequence[Rod] | Sequence[String], keys: Array, label: Callable[[int], str]) -> list[Group]:
    """Members by their groups, by what names have before the first digit, or by numbers (n, 2) in six digits."""
    stems = [re.split(r"\d", one.name, maxsplit=1)[0].rstrip(" _-.") for one in members]
    groups = [one.group or "" for one in members]
    found = _groups(groups, lambda row: groups[row] or "others") or _groups(stems, lambda row: stems[row] or "others")
    return found or _groups([tuple(f"{value:.{DIGITS}g}" for value in row) for row in keys], label)


def _groups(keys: Sequence[Hashable], label: Callable[[int], str]) -> list[Group]:
    """Members with the same key, under the label of the first of them and their number."""
    found: dict[Hashable, list[int]] = {}
    for row, key in enumerate(keys):
        found.setdefault(key, []).append(row)
    if not 2 <= len(found) <= MAX_LEGEND:
        return []
    return [(f"{label(rows[0])} ({len(rows)})", np.array(rows)) for rows in found.values()]


def over_time(panel: Axes, title: str, unit: str) -> None:
    """The frame of curves over time."""
    frame(panel, title, y=unit)
    panel.margins(x=0.0)
    if not (panel.lines or panel.patches or panel.collections):
        note(panel, "nothing to show")
        panel.set_xticks([])
        panel.set_yticks([])


def controls(panel: Axes, run: Trajectory) -> None:
    strings = run.scene.structure.strings
    names = [string.name for string in strings]
    draw_curves(panel, run.time, run.force_densities, names)
    title = "Controls $u$" if len(names) != 1 else f"Control $u$ of string {figure_text(names[0])}"
    over_time(panel, title, "force density [N/m]")


def multipliers(panel: Axes, run: Trajectory, rods: Sequence[int] | None = None) -> None:
    """λ of some rods, by default of all."""
    chosen = list(range(len(run.scene.structure.rods)) if rods is None else rods)
    names = [run.scene.structure.rods[a].name for a in chosen]
    draw_curves(panel, run.time, run.multipliers[:, chosen], names)
    over_time(panel, rf"Lagrange multiplier{'s' if len(names) > 1 else ''} $\lambda$", r"$\lambda$ [1/s²]")


def heights(panel: Axes, run: Trajectory) -> None:
    """Draw the heights of the mass centre, the highest and the lowest node: above the floor, or without one, from 0."""
    up, floor = upwards(run), None if run.scene.contact is None else run.scene.contact.floor
    structure = run.scene.structure
    height = run.nodes @ up - (floor or 0.0)
    masses = lumped_masses(structure)
    moving = height[:, masses > 0.0]
    centre = height @ masses / masses.sum()
    low, high = moving.min(axis=1), moving.max(axis=1)
    panel.fill_between(run.time, low, high, color=palette.BAND, lw=0.0)
    for number, (values, label) in enumerate(((centre, "mass centre"), (high, "highest node"), (low, "lowest node"))):
        color, style = palette.look_of(number)
        panel.plot(run.time, values, color=color, ls=style, lw=WIDTH, label=label)
    if floor is not None:
        panel.axhline(0.0, color=GREY, lw=1.0)
    over_time(panel, "Height" if floor is None else "Height above the floor", "height [m]")


def tensions(panel: Axes, run: Trajectory) -> None:
    """Draw the tensions of the strings, alike ones together and those with mass as wholes; without strings, speeds."""
    structure = run.scene.structure
    if not structure.strings:
        speeds = np.linalg.norm(run.velocities, axis=-1)
        draw_curves(panel, run.time, speeds, structure.node_names)
        over_time(panel, "Speed of the nodes", "speed [m/s]")
        return
    names = [string.name for string in structure.given.strings]
    if structure.ropes:
        draw_curves(panel, run.time, np.stack([run.tension(name) for name in names], axis=1), names)
    else:
        draw_curves(panel, run.time, run.tensions, names, string_groups(structure))
    over_time(panel, "Tension of the strings", "tension [N]")


def rest_lengths(panel: Axes, run: Trajectory) -> None:
    """Draw the rest lengths of the strings, as winches set them: of many those that change most; ropes as wholes.

    Alike ones are drawn together where they change together.
    """
    structure = run.scene.structure
    names = [string.name for string in structure.given.strings]
    values = np.stack([run.rest_length(name) for name in names], axis=1) if names else run.rest_lengths
    changes = values - values[:1]
    groups = [] if structure.ropes else string_groups(structure)
    apart = max((float(np.ptp(changes[:, rows], axis=1).max(initial=0.0)) for _, rows in groups), default=0.0)
    together = apart <= 10.0**-DIGITS * np.abs(values).max(initial=0.0)
    draw_curves(panel, run.time, values, names, groups if together else [], changes)
    over_time(panel, "Rest length of the strings", "rest length [m]")


def forces(panel: Axes, run: Trajectory) -> None:
    """Draw the floor's force on the structure where momentum gives it, else the rods' forces, alike ones together."""
    floor = floor_force(run)
    if floor is not None:
        time, across, along = floor
        for number, (values, label) in enumerate(((across, "across the floor"), (along, "along it, friction"))):
            color, style = palette.look_of(number)
            panel.stairs(values, time, baseline=None, color=color, ls=style, lw=WIDTH, label=label)
        over_time(panel, "Contact force, mean between samples", "force [N]")
        return
    structure = run.scene.structure
    draw_curves(panel, run.time, run.rod_forces, [rod.name for rod in structure.rods], rod_groups(structure))
    chosen = "; of redundant ones a choice" if run.reports.get("undetermined_forces") else ""
    over_time(panel, f"Force of the rods, negative in compression{chosen}", "force [N]")


def upwards(run: Trajectory) -> Array:
    """Unit vector (3,): the floor's normal, else against gravity, else z."""
    if run.scene.contact is not None and run.scene.contact.floor is not None:
        return run.scene.contact.up
    return -down_of(run.scene)


def floor_force(run: Trajectory) -> tuple[Array, Array, Array] | None:
    """Times (T,) [s]; between them the floor's force (T - 1,) [N] across it, and along it: what changes the momentum.

    p(t₂) - p(t₁) = ∫ (M g + F) dt, as gravity and floor are all that act from outside: the mean of F between two
    samples is exact. None where more acts, a support or water for instance, or where there is no floor.
    """
    scene, structure = run.scene, run.scene.structure
    held = structure.fixed_nodes or scene.effects or any(len(rod.support.directions) for rod in structure.rods)
    if scene.contact is None or scene.contact.floor is None or held or len(run.time) < 2:
        return None
    masses = lumped_masses(structure)
    momentum = np.einsum("n,tnk->tk", masses, run.velocities)
    force = np.diff(momentum, axis=0) / np.diff(run.time)[:, None] - masses.sum() * np.array(scene.gravity)
    across = force @ scene.contact.up
    along = np.linalg.norm(force - across[:, None] * scene.contact.up, axis=1)
    return run.time, across, along


def rows_of_panels(runs: Sequence[Trajectory], count: int = 3) -> tuple[Figure, Any]:
    """Three panels in a row for each run, or four in two; in a paper's column all below one another."""
    columns = figures.panels_in_a_row(2 if count == 4 else 3)
    lines = count // columns
    # A legend below a panel takes about a quarter of its height; several above one another are flatter.
    tall = 1.25 * ROW if lines == 1 else lines * (0.85 if columns == 1 else 1.1) * ROW
    figure = figures.new_figure(columns * COLUMN, (tall + 0.45) * len(runs) + 0.45)
    rows = np.atleast_1d(np.asarray(figure.subfigures(len(runs), 1), dtype=object))
    panels = [row.subplots(lines, columns).ravel() for row in rows]
    for row, run in zip(rows, runs, strict=True):
        note = "" if run.status.value == "completed" else f" ({run.status.value})"
        name = figure_text(run.scene.name)
        row.suptitle(f"{name}: {figure_text(run.engine)}{note}" if run.engine else name, fontsize=11)
    for panel in panels[-1]:
        panel.set_xlabel("time [s]", fontsize=9)
    return figure, panels


def share_scales(panels: Sequence[Any]) -> None:
    """Give panels of a kind, in rows as of `rows_of_panels`, the same scales: of forces none that shows speeds."""
    from tensegrity_mj.pictures.ticks import prefix_ticks

    for first, *others in zip(*panels, strict=True):
        for other in others:
            other.sharex(first)
            if other.get_ylabel() == first.get_ylabel():
                other.sharey(first)
                prefix_ticks(other)
        first.autoscale_view()


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
