"""Tables of other programs against a reference that has an error bar: error, order, and a verdict in a sentence.

A reference is the table reference.csv next to a scene, with `error` [m] in its header, as those of the benchmark pack
(docs/benchmark.md). Nothing is interpolated: the times of the reference are those that count.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, norm
from tensegrity_mj.basics.checks import check_known, positive
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.model.text.sources import find, pack_names
from tensegrity_mj.runs.convergence import common_times, orders_between
from tensegrity_mj.runs.table import Table, read_table

# Of the motion: what is further off is wrong. A parameter that is off by 1 % moves all that is linear in it by 1 % of
# the motion; a tenth of that is left for errors of the solution.
WRONG = 1e-3
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inches": 0.0254, "km": 1e3}


@dataclass(frozen=True)
class Score:
    """Distance of a table from a reference.

    Attributes:
        table: its name.
        step: time step of its computation [s]; None where it is not known.
        error: largest distance of a node over the reference's times that the table has [m], of `node` at `time` [s].
        error_bar: of the reference [m].
        motion: largest distance of a node of the reference from where it begins [m].
        span: first and last of these times [s].
        times: how many these are, and how many the reference has.
        read_as: unit and axes that its first row shows, if they are others than the reference's; "" for the same.
        gaps: (T, K, 3) of the reference's times and nodes, from there to the table [m]; NaN where it has none.
    """

    table: str
    step: float | None
    error: float
    node: str
    time: float
    error_bar: float
    motion: float
    span: tuple[float, float]
    times: tuple[int, int]
    read_as: str
    gaps: Array = field(repr=False, compare=False)

    @property
    def judged(self) -> str:
        """The verdict in a word: "exact", within the error bar; "close"; or "undecided", too large a step or wrong."""
        if self.error <= self.error_bar:
            return "exact"
        return "close" if self.error <= WRONG * self.motion else "undecided"

    @property
    def verdict(self) -> str:
        """The verdict in a sentence."""
        off, part = quantity(self.error, "m"), quantity(self.error / self.motion, digits=2)
        sentences = {
            "exact": f"right: {off} off at most, within the error bar of {quantity(self.error_bar, 'm')}",
            "close": f"right to {part} of the motion: {off} off at most",
            "undecided": f"{off} off, {part} of the motion: not converged or another model; a second step decides",
        }
        own, all_ = self.times
        over = f"{quantity(self.span[0])} to {quantity(self.span[1], 's')}" if own < all_ else "the whole run"
        read = f" (read as {self.read_as})" if self.read_as else ""
        return f"{self.table}{read} is {sentences[self.judged]}, over {over} ({own} of {all_} times)."


@dataclass(frozen=True)
class Limit:
    """Limit of tables of two steps, by Richardson's extrapolation.

    Attributes:
        order: that of 1 to 4 whose limit is nearest to the reference.
        error: largest distance of that limit from the reference [m].
        score: that of the finer table.
    """

    order: int
    error: float
    score: Score

    @property
    def judged(self) -> str:
        """The verdict in a word: that of the finer table, "converges", "undecided" or "wrong".

        An extrapolation that leaves half of the error or more has not found what makes it: it is no error of the step.
        """
        one = self.score
        if one.judged != "undecided":
            return one.judged
        if self.error <= max(one.error_bar, WRONG * one.motion):
            return "converges"
        return "undecided" if self.error < one.error / 2 else "wrong"

    @property
    def verdict(self) -> str:
        """The verdict in a sentence."""
        off, part = quantity(self.error, "m"), quantity(self.error / self.score.motion, digits=2)
        texts = {
            "converges": f"right, with too large a step: the limit by order {self.order} is",
            "undecided": "not converged: give smaller steps; the limit is",
            "wrong": "wrong, another model: the limit is",
        }
        return f"{self.score.table} is {texts.get(self.judged, 'right: the limit is')} {off} off, {part} of the motion."


def reference_of(scene: str | os.PathLike[str]) -> Table:
    """Read the reference next to a scene, which is named as in `load_scene`; "free" is "pack/free", too.

    Raises:
        FormatError: if there is no such scene, no reference next to it, or none that can be read.
        OptionError: if its header has no error bar.
    """
    name = f"pack/{scene}" if f"pack/{scene}" in pack_names() else scene
    path = find(name)[2] / "reference.csv"
    if not path.is_file():
        raise FormatError(
            f"scene '{scene}': there is no reference.csv next to it; scenes that have one: {', '.join(pack_names())}"
        )
    found = read_table(path)
    positive(f"{path}: error", found.header.get("error"), "[m]")
    return found


def score(reference: Table, table: Table, step: float | None = None) -> Score:
    """Measure how far a table is from a reference, as `reference_of` reads one.

    Args:
        step: time step of the table's computation [s], where its header does not state it.

    Raises:
        OptionError: for nodes that the reference does not have or that the table lacks although they move, times
            beyond the reference's, fewer than two of its times, a bad step.
    """
    step = table.header.get("step") if step is None else step
    if step is not None:
        step = positive(f"{table.name}: step", step, "[s]")
    for node in table.nodes:
        check_known(table.name, node, reference.nodes, "node")
    moves = norm(reference.positions - reference.positions[0]).max(axis=0)
    if not moves.max() > 0:
        raise OptionError(f"{reference.name}: nothing moves in the reference, so that nothing can be scored by it")
    for node in np.array(reference.nodes)[moves > 0]:
        if node not in table.nodes:
            raise OptionError(f"{table.name}: there is no node '{node}', which moves in the reference")
    rows, columns = _times(reference, table)
    places = np.full_like(reference.positions, math.nan)
    own = np.array([reference.nodes.index(node) for node in table.nodes])
    turn, read_as = _axes(reference.positions[0, own], table.positions[0]) if rows[0] == columns[0] == 0 else (None, "")
    places[np.ix_(rows, own)] = table.positions[columns] if turn is None else table.positions[columns] @ turn
    gaps = places - reference.positions
    distance = norm(gaps)
    there = np.isfinite(distance[:, moves > 0])
    seen, counts = np.flatnonzero(there.any(axis=1)), there.sum(axis=0)  # of each node that moves
    if counts.min() < 2:
        node = np.array(reference.nodes)[moves > 0][counts.argmin()]
        raise OptionError(f"{table.name}: it has '{node}' at {counts.min()} of the reference's times, two are needed")
    at, which = np.unravel_index(np.nanargmax(distance), distance.shape)
    return Score(
        table=table.name,
        step=step,
        error=float(distance[at, which]),
        node=reference.nodes[int(which)],
        time=float(reference.time[at]),
        error_bar=float(reference.header["error"]),
        motion=float(moves.max()),
        span=(float(reference.time[seen[0]]), float(reference.time[seen[-1]])),
        times=(int(counts.min()), len(reference.time)),
        read_as=read_as,
        gaps=gaps,
    )


def limit(scores: Sequence[Score]) -> Limit | None:
    """Extrapolate the two tables of the smallest steps to their limit.

    None where there are no two with steps that differ, or the coarser lacks the place where the finer is furthest off.
    """
    known = sorted((one for one in scores if one.step), key=lambda one: one.step or 0.0)
    coarse = next((one for one in known if one.step != known[0].step), None)
    if coarse is None:
        return None
    fine, ratio = known[0], (coarse.step or 0.0) / (known[0].step or 1.0)
    if np.isnan(norm(coarse.gaps).flat[np.nanargmax(norm(fine.gaps))]):
        return None
    found = [(np.nanmax(norm(fine.gaps + (fine.gaps - coarse.gaps) / (ratio**p - 1))), p) for p in range(1, 5)]
    error, order = min(found)
    return Limit(order, float(error), fine)


def _axes(ours: Array, theirs: Array) -> tuple[Array | None, str]:
    """Find the matrix that takes a table's first row to the start (None for the unit matrix), and its text.

    Of several the first: the axes as they are, then y up for z up, then turns, then mirror images.
    """
    near = 1e-6 * float(np.abs(ours).max())  # six digits
    turns = [np.eye(3)[list(order)] * signs for order in permutations(range(3)) for signs in product((1, -1), repeat=3)]
    up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # (x, y, z) here is (x, -z, y) there
    turns.sort(key=lambda one: (not (one == np.eye(3)).all(), not (one == up).all(), np.linalg.det(one) < 0))
    for unit, factor in UNITS.items():
        for turn in turns:
            if np.abs(factor * theirs @ turn - ours).max() <= near:
                if factor == 1 and (turn == np.eye(3)).all():
                    return None, ""
                axes = [f"{'-' if column.min() < 0 else ''}{'xyz'[np.abs(column).argmax()]}" for column in turn.T]
                return factor * turn, f"{unit}, with (x, y, z) as ({', '.join(axes)})"
    return None, ""


def _times(reference: Table, table: Table) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows of both at the times that count: those of the reference that the table has."""
    known = f"the reference has {len(reference.time)} times, from {reference.time[0]:.6g} to {reference.time[-1]:.6g} s"
    if table.time[-1] > reference.time[-1] * (1 + 1e-9):
        raise OptionError(f"{table.name}: t = {table.time[-1]:.6g} s is beyond the end; {known}")
    rows, columns = common_times(reference.time, table.time)
    if len(rows) < 2:
        raise OptionError(f"{table.name}: it has {len(rows)} of the reference's times, two are needed; {known}")
    return rows, columns


def observed_orders(scores: Sequence[Score]) -> list[float | None]:
    """The order between each score and the next of a smaller step, the largest step first.

    None where an error is within the error bar, below which no order shows, and where steps do not fall.
    """
    floor = max((one.error_bar for one in scores), default=0.0)
    return orders_between([one.step or math.nan for one in scores], [one.error for one in scores], floor)
