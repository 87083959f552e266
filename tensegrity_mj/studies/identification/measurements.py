"""Measurements with times and noise of their own, and the places in a run where the same is found."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import check_known, instance, positive, sequence_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.stored import is_table
from tensegrity_mj.runs.table import Table, read_table
from tensegrity_mj.runs.trajectory import Trajectory

UNITS = {"nodes": "m", "lengths": "m", "tensions": "N"}
Source = str | os.PathLike[str] | Table | Trajectory


class Series(NamedTuple):
    """A number over time: of a node ("nodes", "n1", "x") or of a string ("lengths", "s1", "length"); sigma or None."""

    place: tuple[str, str, str]
    times: Array
    values: Array
    sigma: float | None


def measured(source: Source, members: Sequence[str] | None = None, **sigmas: float | None) -> tuple[Series, ...]:
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
    members = None if members is None else sequence_of("members", members)
    source = _table(source)
    name, moved = source.name, np.moveaxis(source.positions, 0, -1)
    held = {("nodes", node, "xyz"[k]): moved[n, k] for n, node in enumerate(source.nodes) for k in range(3)}
    held |= {("lengths", string, "length"): values for string, values in source.lengths.items()}
    held |= {("tensions", string, "tension"): values for string, values in source.tensions.items()}
    quantities = _quantities(source)
    for quantity, sigma in sigmas.items():
        check_known(name, quantity, quantities, "quantity")
        if sigma is not None:
            positive(f"{name}: sigma of {quantity}", sigma, UNITS[quantity])
    chosen = sigmas or {one: None for one in quantities if one == "nodes" or len(quantities) == 1}
    if not chosen:
        raise OptionError(f"{name} has {', '.join(quantities)}: name what counts, as measured(..., tensions=0.1)")
    for member in members or ():
        check_known(name, member, {place[1] for place in held if place[0] in chosen}, "node or string")
    return tuple(
        Series(place, source.time[seen], values[seen], chosen[place[0]])
        for place, values in held.items()
        if place[0] in chosen and (members is None or place[1] in members)
        for seen in [~np.isnan(values)]
    )


def measured_together(
    sources: Sequence[Source], members: Sequence[str] | None, sigmas: dict[str, float]
) -> list[Series]:
    """`measured` of several sources, of which each has some of the members and of the quantities.

    Raises:
        OptionError: as `measured`; for a quantity or a member that none of them has.
    """
    tables = [_table(one) for one in sources]
    for quantity in sigmas:
        check_known("measurements", quantity, {one for table in tables for one in _quantities(table)}, "quantity")
    own = [{one: sigmas[one] for one in _quantities(table) if one in sigmas} for table in tables]
    found = [one for table, sigma in zip(tables, own, strict=True) for one in measured(table, None, **sigma)]
    for member in members or ():
        check_known("measurements", member, {one.place[1] for one in found}, "node or string")
    return [one for one in found if members is None or one.place[1] in members]


def _table(source: Source) -> Table:
    if isinstance(source, (str, os.PathLike)):
        source = read_table(source) if is_table(source) else Trajectory.load(source)
    instance("measurements", source, (Table, Trajectory), "use a run, a table, the path of one, or measured(...)")
    if isinstance(source, Table):
        return source
    strings = [string.name for string in source.scene.structure.strings]
    pulls, spans = ({one: of(one) for one in strings} for of in (source.tension, source.length))
    names = tuple(source.scene.structure.node_names)
    return Table(source.time, names, source.nodes, None, pulls, f"the run of {source.engine}", {}, spans)


def _quantities(table: Table) -> list[str]:
    return [one for one in UNITS if getattr(table, one)]


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
        """Make the observation from what `measured` takes or makes, or several of these.

        Raises:
            OptionError: for a member that the structure does not have, a time below 0, several units of unknown noise,
                noise that is known of some alone, or no measurement at all.
        """
        found = [one for one in _each(given) if len(one.times)]
        nodes, strings = structure.node_names, [string.name for string in structure.strings]
        known = {(one.sigma is not None, UNITS[one.place[0]]) for one in found}
        for one in found:
            of_node = one.place[0] == "nodes"
            check_known("measurements", one.place[1], nodes if of_node else strings, "node" if of_node else "string")
            for k in np.flatnonzero(~np.isfinite(one.values)):
                where = f"{one.place[1]}.{one.place[2]} at {one.times[k]:g} s"
                raise OptionError(f"measurements: {where} is {one.values[k]:g}; NaN marks what was not seen")
        if not found:
            raise OptionError("measurements: there is none")
        if len({one for one, _ in known}) > 1 or (len(known) > 1 and not next(iter(known))[0]):
            raise OptionError("measurements: give the noise of all, as measured(..., nodes=1e-3, tensions=0.1)")
        places = [("nodes", node, axis) for node in nodes for axis in "xyz"]
        places += [(of, string, of.removesuffix("s")) for of in ("lengths", "tensions") for string in strings]
        times, rows = np.unique(np.round(np.concatenate([one.times for one in found]), 12), return_inverse=True)
        if times[0] < 0 or times[-1] == 0:
            raise OptionError(f"measurements are from {times[0]:g} to {times[-1]:g} s; runs begin at 0 s")
        sizes = [len(one.times) for one in found]
        return cls(
            times,
            tuple(f"{one.place[1]}.{one.place[2]}" for one in found),
            tuple(UNITS[one.place[0]] for one in found),
            np.concatenate([one.values for one in found]),
            np.repeat([one.sigma or 1.0 for one in found], sizes),
            next(iter(known))[0],
            np.repeat(np.arange(len(found)), sizes),
            rows,
            np.repeat([places.index(one.place) for one in found], sizes),
        )

    def seen(self, nodes: Any, lengths: Any, tensions: Any) -> Any:
        """(n,) in a run at `times`: of nodes (T, N, 3), lengths and tensions (T, M), in arrays of NumPy or JAX."""
        columns = [nodes.reshape(len(self.times), -1), lengths, tensions]
        return nodes.__array_namespace__().concatenate(columns, axis=1)[self.rows, self.columns]


def _each(given: Any) -> list[Series]:
    if isinstance(given, Series):
        return [given]
    if isinstance(given, Iterable) and not isinstance(given, (str, np.ndarray)):
        return [series for one in given for series in _each(one)]
    return list(measured(given))
