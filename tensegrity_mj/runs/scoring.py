"""Tables of other programs against a reference that has an error bar: error, order, and a verdict in a sentence.

A reference is the table reference.csv beside a scene, with `error` [m] in its header, as those of the benchmark pack
(docs/benchmark.md). Nothing is interpolated: the times of the reference are those that count.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import norm
from tensegrity_mj.basics.checks import check_known, positive
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.model.text.sources import find, pack_names
from tensegrity_mj.runs.convergence import common_times, orders_between
from tensegrity_mj.runs.table import Table, read_table

# Of the motion: what is further off is wrong. A parameter that is off by 1 % moves whatever is linear in it by 1 % of
# the motion; a tenth of that is left for errors of the solution.
WRONG = 1e-3


@dataclass(frozen=True)
class Score:
    """How far a table is from a reference.

    Attributes:
        table: its name.
        step: that it was computed with [s]; None where it is not known.
        error: largest distance of a node over the reference's times that the table has [m], of `node` at `time` [s].
        error_bar: of the reference [m].
        motion: largest distance of a node of the reference from where it begins [m].
        span: first and last of these times [s].
        times: how many these are, and how many the reference has.
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

    @property
    def judged(self) -> str:
        """The verdict in a word: "exact", within the error bar; "close"; or "wrong", another motion."""
        if self.error <= self.error_bar:
            return "exact"
        return "close" if self.error <= WRONG * self.motion else "wrong"

    @property
    def verdict(self) -> str:
        """The verdict in a sentence."""
        off, part = quantity(self.error, "m"), quantity(self.error / self.motion, digits=2)
        words = {
            "exact": f"right: {off} off at most, within the error bar of {quantity(self.error_bar, 'm')}",
            "close": f"right to {part} of the motion: {off} off at most",
            "wrong": f"wrong: {off} off, {part} of the motion: another model, or too large a step",
        }
        own, all_ = self.times
        over = f"{quantity(self.span[0])} to {quantity(self.span[1], 's')}" if own < all_ else "the whole run"
        return f"{self.table} is {words[self.judged]}, over {over} ({own} of {all_} times)."


def reference_of(scene: str | os.PathLike[str]) -> Table:
    """The reference beside a scene, which is named as in `load_scene`; "free" is "pack/free", too.

    Raises:
        FormatError: if there is no such scene, no reference beside it, or none that can be read.
        OptionError: if its header has no error bar.
    """
    name = f"pack/{scene}" if f"pack/{scene}" in pack_names() else scene
    path = find(name)[2] / "reference.csv"
    if not path.is_file():
        raise FormatError(
            f"scene '{scene}': there is no reference.csv beside it; scenes that have one: {', '.join(pack_names())}"
        )
    found = read_table(path)
    positive(f"{path}: error", found.header.get("error"), "[m]")
    return found


def score(reference: Table, table: Table, step: float | None = None) -> Score:
    """How far a table is from a reference, as `reference_of` reads one.

    Args:
        step: that the table was computed with [s], where its header does not say so.

    Raises:
        OptionError: for nodes that the reference does not have or that the table lacks although they move, times
            beyond the reference's, times of the reference that are left out, positions that are missing, a bad step.
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
    ours = reference.positions[rows][:, [reference.nodes.index(node) for node in table.nodes]]
    distance = norm(table.positions[columns] - ours)
    at, which = np.unravel_index(distance.argmax(), distance.shape)  # of a NaN, where there is one
    node, time = table.nodes[int(which)], float(reference.time[rows[at]])
    if not math.isfinite(distance[at, which]):
        raise OptionError(f"{table.name}: '{node}' has no position at t = {time:.6g} s")
    return Score(
        table=table.name,
        step=step,
        error=float(distance.max()),
        node=node,
        time=time,
        error_bar=float(reference.header["error"]),
        motion=float(moves.max()),
        span=(float(reference.time[rows[0]]), float(reference.time[rows[-1]])),
        times=(len(rows), len(reference.time)),
    )


def _times(reference: Table, table: Table) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows of both at the times that count: all of the reference from the table's first to its last."""
    known = f"the reference has {len(reference.time)} times, from {reference.time[0]:.6g} to {reference.time[-1]:.6g} s"
    if table.time[-1] > reference.time[-1] * (1 + 1e-9):
        raise OptionError(f"{table.name}: t = {table.time[-1]:.6g} s is beyond the end; {known}")
    rows, columns = common_times(reference.time, table.time)
    if len(rows) < 2:
        raise OptionError(f"{table.name}: it has {len(rows)} of the reference's times, two are needed; {known}")
    if rows[-1] - rows[0] >= len(rows):
        absent = reference.time[np.setdiff1d(np.arange(rows[0], rows[-1]), rows)[0]]
        raise OptionError(f"{table.name}: there is no row at t = {absent:.6g} s, a time of the reference; {known}")
    return rows, columns


def observed_orders(scores: Sequence[Score]) -> list[float | None]:
    """The order between each score and the next of a smaller step, the largest step first.

    None where an error is within the error bar, below which no order shows, and where steps do not fall.
    """
    floor = max((one.error_bar for one in scores), default=0.0)
    return orders_between([one.step or math.nan for one in scores], [one.error for one in scores], floor)
