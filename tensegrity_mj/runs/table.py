"""Tables of other programs: node positions over time, as cameras, finite-element programs and others write them."""

from __future__ import annotations

import csv
import math
import os
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics import checks, files, jsontext
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.runs.netcdf import opened

MOST_BYTES = 500_000_000  # of a CSV file
COLUMNS = ("x", "y", "z", "vx", "vy", "vz")
FORM = (
    "the first line names the columns: time, n1.x, n1.y, n1.z, ... or time, node, x, y, z; also velocities (n1.vx ...) "
    "and s1.tension, s1.length, in SI units"
)
# Variables of a NetCDF table: dimensions, units that it may name.
VARIABLES = {
    "time": (("time",), ("s", "seconds")),
    "nodes": (("time", "node", "axis"), ("m", "metres", "meters")),
    "velocities": (("time", "node", "axis"), ("m/s", "m s-1")),
    "tensions": (("time", "string"), ("N", "newton")),
    "lengths": (("time", "string"), ("m", "metres", "meters")),
}


@dataclass(frozen=True, eq=False)
class Table:
    """Node positions over time from another program or a camera; NaN where a node was not seen.

    Attributes:
        time: (T,) rising [s].
        nodes: (K,) names.
        positions: (T, K, 3) [m].
        velocities: (T, K, 3) [m/s], or None.
        tensions, lengths: (T,) [N], [m] of strings by their names.
        name: such as the name of its file.
        header: values in the file's header, such as the time `step` of its computation [s].

    Raises:
        OptionError: where shapes do not fit, times do not rise or two nodes have the same name.
    """

    time: Array
    nodes: tuple[str, ...]
    positions: Array
    velocities: Array | None = None
    tensions: dict[str, Array] = field(default_factory=dict)
    name: str = "table"
    header: dict[str, Any] = field(default_factory=dict)
    lengths: dict[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = np.size(self.time)
        time = checks.real_array(f"{self.name}: time", self.time, (count,), "s", scalar=False)
        object.__setattr__(self, "time", time)
        back = np.flatnonzero(np.diff(time) <= 0)
        if len(back):
            raise OptionError(f"{self.name}: row {back[0] + 2}: {_backwards(time[back[0] + 1], time[back[0]])}")
        if len(set(self.nodes)) < len(self.nodes):
            raise OptionError(f"{self.name}: nodes {', '.join(self.nodes)}: each may be there once")
        of_nodes, of_strings = (count, len(self.nodes), 3), (count,)
        parts: list[tuple[str, Any, tuple[int, ...]]] = [("positions", self.positions, of_nodes)]
        parts += [("velocities", self.velocities, of_nodes)]
        parts += [(name, one, of_strings) for name, one in (*self.tensions.items(), *self.lengths.items())]
        for what, values, shape in parts:
            if values is not None and np.shape(values) != shape:
                raise OptionError(f"{self.name}: {what} has shape {np.shape(values)}; it must be {shape}")


def read_table(path: str | os.PathLike[str]) -> Table:
    """The table of a CSV file, or of a NetCDF-4 one (.nc); docs/data.md has the forms.

    Raises:
        FormatError: if the file is absent or no such table, where a value is no finite number, or times do not rise; it
            names the line and the column.
    """
    source = files.path_of(path, "a table's .csv or .nc file")
    found = _read_netcdf(source) if source.suffix.lower() == ".nc" else _read_csv(source)
    try:
        return Table(**found, name=source.name)
    except OptionError as error:
        raise FormatError(f"{path}: {str(error).removeprefix(f'{source.name}: ')}") from None


def _backwards(now: float, before: float) -> str:
    return f"time is {now:.9g} s after {before:.9g} s; times must rise"


def _read_csv(source: Path) -> dict[str, Any]:
    try:
        text = files.content_of(source, MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{source}: no text in UTF-8 ({error.reason} at byte {error.start}); {FORM}") from None
    lines = text.splitlines()
    rows = csv.reader("" if line.startswith("#") else line for line in lines)
    header = [name.strip() for name in next(filter(None, rows), [])]
    if "time" not in header or len(set(header)) < len(header):
        raise FormatError(f"{source}: there is no column 'time', or one twice; {FORM}")
    long = {"node", "x"} <= set(header)
    nodes = list(dict.fromkeys(name[:-2] for name in header if name[-2:] in (".x", ".y", ".z")))
    fast = "vx" in header if long else any(f"{node}.v{axis}" in header for node in nodes for axis in "xyz")
    columns = COLUMNS[: 6 if fast else 3]
    # The columns of each member; of one of the long form, by its row.
    strings = [name for name in header if name.endswith((".tension", ".length"))]
    wide = {} if long else {node: [f"{node}.{one}" for one in columns] for node in nodes or ([] if strings else ["n1"])}
    absent = [name for name in chain(columns if long else (), *wide.values()) if name not in header]
    if absent:
        raise FormatError(f"{source}: there is no column '{absent[0]}'; {FORM}")
    last: dict[str, float] = {}
    found: dict[tuple[float, str], list[float]] = {}
    for cells in rows:
        line, row = rows.line_num, dict(zip(header, cells, strict=False))
        if not cells:
            continue
        time = _number(source, line, "time", row["time"]) if len(cells) == len(header) else math.nan
        if math.isnan(time):
            raise FormatError(f"{source}, line {line}: no time, or {len(cells)} cells below {len(header)} columns")
        own = {row["node"].strip(): columns} if long else wide
        for name, places in (*own.items(), *((name, [name]) for name in strings)):
            if time <= last.get(name, -math.inf):
                raise FormatError(f"{source}, line {line}: {name}: {_backwards(time, last[name])}")
            last[name] = time
            found[time, name] = [_number(source, line, one, row[one]) for one in places]
    times, gap = sorted({time for time, _ in found}), [math.nan] * len(columns)
    seen = tuple(name for name in last if name not in strings)
    moved = np.array([[found.get((time, node), gap) for node in seen] for time in times], float)
    moved = moved.reshape(len(times), len(seen), len(columns))
    of_strings = {name: np.array([found[time, name][0] for time in times]) for name in strings}
    tensions, lengths = (
        {name.removesuffix(end): one for name, one in of_strings.items() if name.endswith(end)}
        for end in (".tension", ".length")
    )
    velocities = moved[..., 3:] if fast else None
    data = {"time": times, "nodes": seen, "positions": moved[..., :3], "velocities": velocities, "tensions": tensions}
    return data | {"lengths": lengths, "header": files.said_in_comments(lines)}


def _number(source: Path, line: int, column: str, text: str) -> float:
    """A finite number; NaN of an empty cell."""
    try:
        value = float(text) if text.strip() else 0.0
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FormatError(
            f"{source}, line {line}: {column} is '{text}'; it must be a finite number; leave empty what was not seen"
        )
    return value if text.strip() else math.nan


def _read_netcdf(source: Path) -> dict[str, Any]:
    with opened(source, "table in NetCDF-4") as file:
        held = file.variables
        absent = [name for name in ("time", "node", "nodes") if name not in held]
        if absent:
            raise FormatError(
                f"{source}: there is no variable '{absent[0]}'; a table has time (time), node (node: names) and "
                "nodes (time, node, axis)"
            )
        values = {name: _variable(source, held[name], *VARIABLES[name]) for name in VARIABLES if name in held}
        of_strings = {
            name: dict(zip(_names(held["string"]), values[name].T, strict=True)) if name in values else {}
            for name in ("tensions", "lengths")
        }
        nodes = _names(held["node"])
        step = file.attrs.get("step")
        if step is None and "scene" in file.attrs:  # a run of ours, which says what it was computed with
            step = jsontext.from_exact_json(str(file.attrs["provenance"])).get("engine", {}).get("timestep")
    moved = {"positions": values["nodes"], "velocities": values.get("velocities")}
    return {"time": values["time"], "nodes": nodes, **of_strings, **moved, "header": {"step": step}}


def _variable(source: Path, variable: Any, dimensions: tuple[str, ...], units: tuple[str, ...]) -> Array:
    """The values of a variable, NaN where it has its fill value."""
    name, fill = variable.name.rpartition("/")[2], variable.attrs.get("_FillValue")
    if tuple(variable.dimensions) != dimensions or variable.attrs.get("units", units[0]) not in units:
        raise FormatError(
            f"{source}: {name} has dimensions {tuple(variable.dimensions)} and is in "
            f"{variable.attrs.get('units', units[0])}; it must have {dimensions} and be in {units[0]}"
        )
    values = np.array(variable[...], float)
    gaps = np.zeros(values.shape, bool) if fill is None else (values == fill) | (np.isnan(values) & np.isnan(fill))
    bad = np.argwhere(~np.isfinite(values) & ~gaps)
    if len(bad):
        at = ", ".join(f"{one} {k}" for one, k in zip(dimensions, bad[0].tolist(), strict=True))
        raise FormatError(f"{source}: {name} is not finite at {at} (counted from 0); what is missing has _FillValue")
    return np.where(gaps, np.nan, values)


def _names(variable: Any) -> tuple[str, ...]:
    """Names, of texts or, as programs write them that have no texts, of rows of characters."""
    values = np.asarray(variable[...])
    texts = [b"".join(row) for row in values] if values.ndim == 2 else list(values)
    return tuple((one.decode() if isinstance(one, bytes) else str(one)).rstrip(" \0") for one in texts)
