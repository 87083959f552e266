"""Curves of many members in one panel that can still be read: at most eight with names, and the rest as a band.

Members that are alike, by their names or by symmetry, are drawn together: their mean, and a band from the least to the
largest. Where they differ, as under a control law, the largest are drawn each, and a band holds all others.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.model.members import Rod, String
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.pictures import palette
from tensegrity_mj.pictures.figure import MAX_LEGEND

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    words = [one.group or "" for one in members]
    found = _groups(words, lambda row: words[row] or "others") or _groups(stems, lambda row: stems[row] or "others")
    return found or _groups([tuple(f"{value:.{DIGITS}g}" for value in row) for row in keys], label)


def _groups(keys: Sequence[Hashable], label: Callable[[int], str]) -> list[Group]:
    """Members with the same key, under the label of the first of them and their number."""
    found: dict[Hashable, list[int]] = {}
    for row, key in enumerate(keys):
        found.setdefault(key, []).append(row)
    if not 2 <= len(found) <= MAX_LEGEND:
        return []
    return [(f"{label(rows[0])} ({len(rows)})", np.array(rows)) for rows in found.values()]
