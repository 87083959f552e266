"""How far two trajectories of one experiment are apart, and since when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self, overload

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.runs.convergence import common_times
from tensegrity_mj.runs.trajectory import Trajectory


class _Largest:
    """Property `max_x` of a comparison: the largest entry of its array `x`; NaN where one is NaN."""

    def __init__(self, unit: str) -> None:
        self.__doc__ = f"The largest over members and times [{unit}]; NaN where a run has NaN."

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name.removeprefix("max_")

    @overload
    def __get__(self, comparison: None, owner: type) -> Self: ...
    @overload
    def __get__(self, comparison: object, owner: type) -> float: ...
    def __get__(self, comparison: object | None, owner: type) -> Self | float:
        return self if comparison is None else float(np.max(getattr(comparison, self._name), initial=0.0))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Differences of two runs at their common output times; each array is (T,), the largest over members.

    Attributes:
        time: common output times [s].
        node_error, velocity_error: largest distance of a node [m], of a node velocity [m/s].
        tension_error, rod_force_error, force_density_error, rest_length_error: of strings [N], of rods' axial
            forces [N], of u [N/m], of L0 [m].
        energy_error: of the total energy [J].
        rms_node_error: root mean square over nodes and times [m].
        max_node_error, ...: the largest entry of each array.
        tolerance: [m], [m/s], [N], [N/m], [J] alike: what `first_exceeded` refers to.
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

    NAMES = (
        "node_error",
        "velocity_error",
        "tension_error",
        "rod_force_error",
        "force_density_error",
        "rest_length_error",
        "energy_error",
    )

    max_node_error = _Largest("m")
    max_velocity_error = _Largest("m/s")
    max_tension_error = _Largest("N")
    max_rod_force_error = _Largest("N")
    max_force_density_error = _Largest("N/m")
    max_rest_length_error = _Largest("m")
    max_energy_error = _Largest("J")

    @property
    def first_exceeded(self) -> dict[str, float | None]:
        """The first common time at which each difference exceeds the tolerance [s]; None if it never does.

        NaN exceeds any tolerance.
        """
        times: dict[str, float | None] = {}
        for name in self.NAMES:
            over = ~(getattr(self, name) <= self.tolerance)
            times[name] = float(self.time[np.argmax(over)]) if over.any() else None
        return times

    def to_dict(self) -> dict[str, Any]:
        """Plain values: the maxima, the RMS, and when each was first exceeded."""
        return {
            **{f"max_{name}": getattr(self, f"max_{name}") for name in self.NAMES},
            "rms_node_error": self.rms_node_error,
            "tolerance": self.tolerance,
            "first_exceeded": self.first_exceeded,
            "common_times": len(self.time),
            "from": float(self.time[0]),
            "to": float(self.time[-1]),
        }


@np.errstate(over="ignore", invalid="ignore")  # runs that diverged: what is not finite shows in the result
def compare(first: Trajectory, second: Trajectory, tolerance: float = 1e-6) -> Comparison:
    """Compare two runs at all output times that they share, without interpolation.

    Raises:
        OptionError: for what is no run, where the structures differ, or where fewer than two times are common.
    """
    for place, run in (("first", first), ("second", second)):
        if not isinstance(run, Trajectory):
            raise OptionError(f"compare: the {place} is {run!r}; it must be a Trajectory")
    if not isinstance(tolerance, (int, float)) or not (np.isfinite(tolerance) and tolerance > 0):
        raise OptionError(f"tolerance = {tolerance!r}; it must be a finite number > 0")
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
        tolerance=float(tolerance),
        first=first.engine,
        second=second.engine,
    )


def _spacing(run: Trajectory) -> str:
    return f"{np.median(np.diff(run.time)):.6g} s" if len(run.time) > 1 else f"{len(run.time)} samples"
