"""Differences of two trajectories of one experiment, and the times from which they exceed a tolerance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, norm
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.basics.texts import at_a_glance, unknown, value_text
from tensegrity_mj.basics.units import quantity
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.convergence import common_times
from tensegrity_mj.runs.table import Table
from tensegrity_mj.runs.trajectory import Trajectory


class Difference(NamedTuple):
    """A quantity that two runs may differ in: what its error is called, what it is of, and the unit of both."""

    words: str
    of: str
    unit: str


DIFFERENCES = {name: Difference(*row) for name, row in table_beside(__file__).items()}
UNITS = tuple(dict.fromkeys(difference.unit for difference in DIFFERENCES.values()))
ERRORS = {"nodes": "node_error", "velocities": "velocity_error", "tensions": "tension_error"}  # by what they are of
OF_TABLES = ("by_node", "resampling_error", "missing_nodes", "unknown_nodes", "times_outside")
# What a comparison's lines have.
GROUPS = {
    "motion": ("node_error", "velocity_error"),
    "forces": ("tension_error", "rod_force_error", "force_density_error"),
    "others": ("rest_length_error", "energy_error"),
}


def _largest(name: str) -> property:
    """Property `max_name` of a comparison."""
    about = f"The largest over members and times [{DIFFERENCES[name].unit}]; NaN where a run has NaN."
    return property(lambda found: float(np.max(getattr(found, name), initial=0.0)), doc=about)


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Differences of two runs at their common output times; each array is (T,), the largest over members.

    Of a run and a table of another program, at the table's times; NaN where the table has none of it. The table stays
    as it is, and the run is interpolated (`runs.resampling.resampled`).

    Attributes:
        time: common output times [s].
        node_error, velocity_error: largest distance of a node [m], of a node velocity [m/s].
        tension_error, rod_force_error, force_density_error, rest_length_error: of strings [N], of rods' axial
            forces [N], of u [N/m], of L0 [m].
        energy_error: of the total energy [J].
        rms_node_error: root mean square over nodes and times [m].
        max_node_error, ...: the largest entry of each array.
        tolerance: in the SI unit of each quantity, what `first_exceeded` refers to where no other is given; or NaN.
        tolerances: others, by units: {"N": 1e-3}.
        compared: those of `NAMES` that both have.
        by_node: the largest distance of each node that both have [m].
        resampling_error: of a table, estimates of what the interpolation adds to "node_error" [m], "velocity_error"
            [m/s] and "tension_error" [N]; 0 where all times are samples of the run, NaN where these are too few to say.
        missing_nodes, unknown_nodes: of the run that the table lacks, of the table that the run lacks: not compared.
        times_outside: of the table, how many are not within the run.
    """

    time: Array
    node_error: Array
    velocity_error: Array
    tension_error: Array
    rod_force_error: Array
    force_density_error: Array
    rest_length_error: Array
    energy_error: Array
    rms_node_error: float
    tolerance: float
    first: str = ""
    second: str = ""
    tolerances: Mapping[str, float] = field(default_factory=dict)
    compared: tuple[str, ...] = tuple(DIFFERENCES)
    by_node: Mapping[str, float] = field(default_factory=dict)
    resampling_error: Mapping[str, float] = field(default_factory=dict)
    missing_nodes: tuple[str, ...] = ()
    unknown_nodes: tuple[str, ...] = ()
    times_outside: int = 0

    NAMES = tuple(DIFFERENCES)

    max_node_error = _largest("node_error")
    max_velocity_error = _largest("velocity_error")
    max_tension_error = _largest("tension_error")
    max_rod_force_error = _largest("rod_force_error")
    max_force_density_error = _largest("force_density_error")
    max_rest_length_error = _largest("rest_length_error")
    max_energy_error = _largest("energy_error")

    def __repr__(self) -> str:
        return at_a_glance(_rows_of(self))

    def tolerance_of(self, name: str) -> float:
        """The tolerance of one of `NAMES`, in its unit; NaN where none was given."""
        return self.tolerances.get(DIFFERENCES[name].unit, self.tolerance)

    @property
    def first_exceeded(self) -> dict[str, float | None]:
        """The first common time at which each difference with a tolerance exceeds it [s]; None if it never does.

        NaN exceeds any tolerance.
        """
        times: dict[str, float | None] = {}
        for name in self.compared:
            if math.isnan(most := self.tolerance_of(name)):
                continue
            over = ~(getattr(self, name) <= most)
            times[name] = float(self.time[np.argmax(over)]) if over.any() else None
        return times

    def to_dict(self) -> dict[str, Any]:
        """Plain values: the maxima, the RMS, when each was first exceeded, and what else is known of a table."""
        return {
            **{f"max_{name}": getattr(self, f"max_{name}") for name in self.NAMES},
            "rms_node_error": self.rms_node_error,
            "tolerance": self.tolerance,
            "first_exceeded": self.first_exceeded,
            "common_times": len(self.time),
            "from": float(self.time[0]),
            "to": float(self.time[-1]),
            **({name: getattr(self, name) for name in OF_TABLES} if self.resampling_error else {}),
        }


def _rows_of(comparison: Comparison) -> list[tuple[str, str]]:
    """Rows (name, line) of a comparison: runs, times, largest differences in their units, and tolerances exceeded."""
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
    since = {DIFFERENCES[name].words: when for name, when in comparison.first_exceeded.items() if when is not None}
    beyond = ", ".join(f"{words} from {quantity(when, 's')}" for words, when in since.items())
    return rows + ([("beyond", beyond or "no tolerance")] if comparison.first_exceeded else [])


@np.errstate(over="ignore", invalid="ignore")  # runs that diverged: what is not finite shows in the result
def compare(
    first: Trajectory | Table,
    second: Trajectory | Table,
    tolerance: float | None = None,
    *,
    tolerances: Mapping[str, float] | None = None,
) -> Comparison:
    """Compare two runs at all output times that they share, without interpolation; or a run with a table.

    Of a table, such as `runs.read_table` reads, each time within the run counts, see `Comparison`.

    Args:
        tolerance: in the SI unit of each quantity; none by default.
        tolerances: other ones by units, m, m/s, N, N/m or J: {"N": 1e-3}.

    Raises:
        OptionError: for a wrong run or tolerance, where the structures differ, or where fewer than two times are
            common.
    """
    limits = math.nan if tolerance is None else positive("tolerance", tolerance), dict(tolerances or {})
    for unit, most in (tolerances or {}).items():
        if unit not in UNITS:
            raise OptionError(unknown(unit, UNITS, "unit of a tolerance"))
        limits[1][unit] = positive(f"tolerances[{unit!r}]", most)
    if isinstance(first, Trajectory) and isinstance(second, Table):
        return _with_table(first, second, limits, (first.engine, second.name))
    if isinstance(first, Table) and isinstance(second, Trajectory):
        return _with_table(second, first, limits, (first.name, second.engine))
    for place, run in (("first", first), ("second", second)):
        if not isinstance(run, Trajectory):
            also = "; one of the two is a run" if isinstance(run, Table) else ""
            raise OptionError(f"compare: the {place} is {value_text(run)}; it must be a Trajectory{also}")
    assert isinstance(first, Trajectory)
    assert isinstance(second, Trajectory)
    for member, names in (
        ("nodes", lambda run: list(run.scene.structure.nodes)),
        ("strings", lambda run: [(s.name, s.nodes) for s in run.scene.structure.strings]),
        ("rods", lambda run: [(r.name, r.nodes) for r in run.scene.structure.rods]),
    ):
        if names(first) != names(second):
            raise OptionError(
                f"the runs of '{first.scene.name}' and '{second.scene.name}' have different {member}: "
                "only runs of the same structure can be compared"
            )
    rows, columns = common_times(first.time, second.time)
    if len(rows) < 2:
        raise OptionError(
            f"the runs share {len(rows)} output times: give both the same output_interval "
            f"({_spacing(first)} and {_spacing(second)} now)"
        )

    def difference(name: str) -> Array:
        return np.asarray(getattr(first, name)[rows] - getattr(second, name)[columns])

    def largest(name: str, scale: Array | float = 1.0) -> Array:
        return np.max(np.abs(difference(name) * scale), axis=1, initial=0.0)

    def energy(run: Trajectory) -> Array:
        return run.kinetic_energy + run.gravity_energy + run.string_energy + run.element_energy

    distance = np.linalg.norm(difference("nodes"), axis=-1)
    return Comparison(
        time=first.time[rows],
        node_error=distance.max(axis=1),
        velocity_error=np.linalg.norm(difference("velocities"), axis=-1).max(axis=1),
        tension_error=largest("tensions"),
        rod_force_error=largest("rod_force_densities", first.scene.structure.rod_lengths),
        force_density_error=largest("force_densities"),
        rest_length_error=largest("rest_lengths"),
        energy_error=np.abs(energy(first)[rows] - energy(second)[columns]),
        rms_node_error=float(np.sqrt(np.mean(distance**2))),
        tolerance=limits[0],
        first=first.engine,
        second=second.engine,
        tolerances=limits[1],
        by_node=dict(zip(first.scene.structure.node_names, distance.max(axis=0).tolist(), strict=True)),
    )


def _with_table(
    run: Trajectory, table: Table, limits: tuple[float, dict[str, float]], names: tuple[str, str]
) -> Comparison:
    index = run.scene.structure.node_index
    shared = [node for node in table.nodes if node in index]
    if not shared:
        raise OptionError(
            f"{table.name} has no node of the run of '{run.scene.name}': {', '.join(table.nodes)} are none of "
            f"{', '.join(index)}"
        )
    ours, theirs = [index[node] for node in shared], [table.nodes.index(node) for node in shared]
    span = run.time[[0, -1]] if len(run.time) else np.zeros(2)
    inside = (table.time >= span[0] - 1e-9 * span[1]) & (table.time <= span[1] + 1e-9 * span[1])
    rows = np.flatnonzero(inside & ~np.isnan(table.positions[:, theirs]).any(axis=-1).all(axis=-1))
    if len(rows) < 2 or len(run.time) < 2:
        raise OptionError(
            f"{table.name} has {len(rows)} of its {len(table.time)} times within the run, from {span[0]:.6g} to "
            f"{span[1]:.6g} s, with a node of it; two are needed"
        )
    found = resampled(run, np.clip(table.time[rows], *span))
    distance = norm(found.values["nodes"][:, ours] - table.positions[rows][:, theirs])
    arrays = {name: np.full(len(rows), np.nan) for name in Comparison.NAMES}
    # fmax leaves out what is NaN: nodes that were not seen.
    arrays["node_error"] = np.fmax.reduce(distance, axis=1)
    if table.velocities is not None:
        off = norm(found.values["velocities"][:, ours] - table.velocities[rows][:, theirs])
        arrays["velocity_error"] = np.fmax.reduce(off, axis=1)
    for number, string in enumerate(run.scene.structure.strings):
        if string.name in table.tensions:
            off = np.abs(found.values["tensions"][:, number] - table.tensions[string.name][rows])
            arrays["tension_error"] = np.fmax(arrays["tension_error"], off)
    return Comparison(
        time=table.time[rows],
        **arrays,
        rms_node_error=float(np.sqrt(np.nanmean(distance**2))),
        tolerance=limits[0],
        first=names[0],
        second=names[1],
        tolerances=limits[1],
        compared=tuple(name for name, values in arrays.items() if not np.isnan(values).all()),
        by_node=dict(zip(shared, np.fmax.reduce(distance, axis=0).tolist(), strict=True)),
        resampling_error={ERRORS[name]: error for name, error in found.errors.items()},
        missing_nodes=tuple(node for node in index if node not in table.nodes),
        unknown_nodes=tuple(node for node in table.nodes if node not in index),
        times_outside=int((~inside).sum()),
    )


def _spacing(run: Trajectory) -> str:
    return f"{np.median(np.diff(run.time)):.6g} s" if len(run.time) > 1 else f"{len(run.time)} samples"


ORDERS = {"nodes": 4, "velocities": 4, "tensions": 2}  # of the error, in the spacing of samples, on smooth motion
FEWEST = 9  # samples that show how an error falls


@dataclass(frozen=True, eq=False)
class Resampled:
    """A run at other times: `values` of each of `ORDERS`, and estimates of their largest `errors`; NaN for unknown."""

    values: dict[str, Array]
    errors: dict[str, float]


def resampled(run: Trajectory, times: Array) -> Resampled:
    """A run at times (T,) within it [s].

    Positions are cubic Hermite polynomials of the recorded positions and velocities (error h⁴/384 max |d⁴n/dt⁴| for
    samples h apart), velocities cubic splines, tensions straight lines, which alone make no push of a slack string.
    Where all times are samples of the run, these are taken as they are.

    The error is estimated from the samples themselves: the largest distance of those between from what every other one
    foresees falls to the spacing of the samples as it did from every fourth to every other one, at most by the order
    that smooth motion has. It is an estimate, not a bound: what leaves no trace in the samples cannot be seen.
    """
    rows, columns = common_times(run.time, times)
    if len(columns) == len(times):
        return Resampled({name: getattr(run, name)[rows] for name in ORDERS}, dict.fromkeys(ORDERS, 0.0))
    first = max(int(np.searchsorted(run.time, times[0], side="right")) - 1, 0)
    last = min(int(np.searchsorted(run.time, times[-1])), len(run.time) - 1)
    # As many samples more as make quarters of them: before, or after.
    first = max(first - (first - last) % 4, 0)
    last = min(last + (first - last) % 4, len(run.time) - 1)
    known = last - first + 1 >= FEWEST
    return Resampled(
        {name: np.asarray(_interpolant(run, name, slice(first, last + 1))(times)) for name in ORDERS},
        {name: _error(run, name, first, last - (last - first) % 4) if known else float("nan") for name in ORDERS},
    )


def _interpolant(run: Trajectory, name: str, rows: slice) -> Any:
    from scipy.interpolate import CubicHermiteSpline, CubicSpline, make_interp_spline  # slow to load

    time, values = run.time[rows], getattr(run, name)[rows]
    if name == "nodes":
        return CubicHermiteSpline(time, values, run.velocities[rows])
    return CubicSpline(time, values) if name == "velocities" else make_interp_spline(time, values, k=1)


def _error(run: Trajectory, name: str, first: int, last: int) -> float:
    """The estimate of `resampled` for one quantity, from the samples `first` to `last`, which are 1 more than 4 k."""
    differences = []
    for stride in (4, 2):
        between = slice(first + stride // 2, last, stride)
        foreseen = _interpolant(run, name, slice(first, last + 1, stride))(run.time[between])
        missed = getattr(run, name)[between] - foreseen
        size = np.linalg.norm(missed, axis=-1) if missed.ndim == 3 else np.abs(missed)
        differences.append(float(np.max(size, initial=0.0)))
    before, now = differences
    return now / min(max(before / now, 1.0), 2.0 ** ORDERS[name]) if now > 0 else 0.0
