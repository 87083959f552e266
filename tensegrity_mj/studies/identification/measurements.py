"""What was measured, with times and noise of its own, and where a run has the same."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import check_known, instance, positive
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.stored import is_table
from tensegrity_mj.runs.table import Table, read_table
from tensegrity_mj.runs.trajectory import Trajectory

UNITS = {"nodes": "m", "lengths": "m", "tensions": "N"}
Source = str | os.PathLike[str] | Table | Trajectory


@dataclass(frozen=True, eq=False)
class Measured:
    """What counts of a table: series by quantities and members, and the noise's standard deviation of each, or None."""

    table: Table
    series: dict[str, dict[str, Array]]
    sigmas: dict[str, float | None]


def measured(source: Source, members: Sequence[str] | None = None, **sigmas: float | None) -> Measured:
    """The measurements in a table, which arrays make (`runs.Table`), in a run, or in a file of either (docs/data.md).

    Args:
        members: names of nodes and strings; all by default.
        sigmas: the noise's standard deviation of each quantity that counts: nodes=1e-3 [m], lengths=... [m] and
            tensions=... [N] of strings. Without any, node positions count, or where there are none the only other
            quantity, with noise that is not known.

    Raises:
        FormatError: as `read_table` and `Trajectory.load`.
        OptionError: for a quantity or a member that the source does not have.
    """
    if isinstance(source, (str, os.PathLike)):
        source = read_table(source) if is_table(source) else Trajectory.load(source)
    instance("measurements", source, (Table, Trajectory), "use a run, a table, the path of one, or measured(...)")
    table = source if isinstance(source, Table) else _table_of(source)
    positions = dict(zip(table.nodes, np.swapaxes(table.positions, 0, 1), strict=True))
    parts = {"nodes": positions, "lengths": table.lengths, "tensions": table.tensions}
    held = {quantity: series for quantity, series in parts.items() if series}
    usual = [one for one in held if one == "nodes" or len(held) == 1]
    for quantity, sigma in sigmas.items():
        check_known(table.name, quantity, held, "quantity")
        if sigma is not None:
            positive(f"{table.name}: sigma of {quantity}", sigma, UNITS[quantity])
    if not (chosen := sigmas or dict.fromkeys(usual)):
        raise OptionError(f"{table.name} has {', '.join(held)}: name what counts, as measured(..., tensions=0.1)")
    for member in members or ():
        check_known(table.name, member, {one for quantity in chosen for one in held[quantity]}, "node or string")
    of = {key: {name: one for name, one in held[key].items() if members is None or name in members} for key in chosen}
    return Measured(table, of, chosen)


def _table_of(run: Trajectory) -> Table:
    structure = run.scene.structure
    pulls, lengths = (
        {string.name: values(string.name) for string in structure.strings} for values in (run.tension, run.length)
    )
    return Table(run.time, tuple(structure.node_names), run.nodes, None, pulls, f"the run of {run.engine}", {}, lengths)


@dataclass(frozen=True, eq=False)
class Observation:
    """Numbers (n,) that were measured, series after series, and where runs of a structure have them.

    Attributes:
        times: (T,) of all measurements, rising [s].
        labels, units: of each series, such as "n1.z" and "m".
        values, sigma: (n,), and the noise's standard deviations; ones where these are not `known`.
        series, rows: (n,) the series and the time of each.
        columns: (n,) of the table of nodes, lengths and tensions that `seen` makes.
    """

    times: Array
    labels: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sigma: Array
    known: bool
    series: IntArray
    rows: IntArray
    columns: IntArray

    @classmethod
    def of(cls, structure: Structure, given: Any) -> Observation:
        """Of what `measured` takes or makes, or several of these.

        Raises:
            OptionError: for a member that the structure does not have, a time below 0, several units of unknown noise,
                noise that is known of some alone, or no measurement at all.
        """
        several = isinstance(given, Iterable) and not isinstance(given, (str, Measured))
        sources = [one if isinstance(one, Measured) else measured(one) for one in (given if several else [given])]
        strings = [string.name for string in structure.strings]
        begins = {"nodes": 0, "lengths": 3 * len(structure.nodes), "tensions": 3 * len(structure.nodes) + len(strings)}
        names: list[tuple[str, str]] = []
        pieces, known = [], set()
        for source in sources:
            for quantity, sigma in source.sigmas.items():
                known.add((sigma is not None, UNITS[quantity]))
                word, members = ("node", structure.node_names) if quantity == "nodes" else ("string", strings)
                for member, values in source.series[quantity].items():
                    check_known(source.table.name, member, members, word)
                    width, ends = (3, "xyz") if quantity == "nodes" else (1, [quantity.removesuffix("s")])
                    first = begins[quantity] + width * list(members).index(member)
                    for axis, end in enumerate(ends):
                        column = np.reshape(values, (-1, width))[:, axis]
                        seen = np.flatnonzero(~np.isnan(column))
                        same = (np.ones(len(seen)) * one for one in (sigma or 1.0, first + axis, len(names)))
                        pieces.append((np.round(source.table.time[seen], 12), column[seen], *same))
                        names.append((f"{member}.{end}", UNITS[quantity]))
        if not sum(len(piece[0]) for piece in pieces):
            raise OptionError("measurements: there is none")
        if len({one for one, _ in known}) > 1 or (len(known) > 1 and not next(iter(known))[0]):
            raise OptionError("measurements: give the noise of all, as measured(..., nodes=1e-3, tensions=0.1)")
        at, values, sizes, columns, series = (np.concatenate(one) for one in zip(*pieces, strict=True))
        times, rows = np.unique(at, return_inverse=True)
        if times[0] < 0 or times[-1] == 0:
            raise OptionError(f"measurements are from {times[0]:g} to {times[-1]:g} s; runs begin at 0 s")
        labels, units = zip(*names, strict=True)
        places = (series.astype(int), rows, columns.astype(int))
        return cls(times, labels, units, values, sizes, next(iter(known))[0], *places)

    def seen(self, nodes: Any, lengths: Any, tensions: Any) -> Any:
        """(n,) in a run at `times`: of nodes (T, N, 3), lengths and tensions (T, M), in arrays of NumPy or JAX."""
        columns = [nodes.reshape(len(self.times), -1), lengths, tensions]
        return nodes.__array_namespace__().concatenate(columns, axis=1)[self.rows, self.columns]
