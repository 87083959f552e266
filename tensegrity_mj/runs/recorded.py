"""Recorded runs: arrays over time, with their dimensions, units and names, plain sums of them, and rows by names."""

from __future__ import annotations

import base64
import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import seconds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known, finite
from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.model.elements.element import energy_of, state_names
from tensegrity_mj.model.elements.resistance import bending_energy
from tensegrity_mj.model.rods import lengths
from tensegrity_mj.model.scene import Scene


class Status(enum.Enum):
    """Ways in which a run ends."""

    COMPLETED = "completed"
    INFEASIBLE = "infeasible"  # the control problem had no admissible solution and the caller chose to stop
    DIVERGED = "diverged"
    SINGULAR = "singular"  # the engine's coordinates cannot hold the state that the run came to


Variables = dict[str, tuple[tuple[str, ...], str, str]]


def _table(name: str) -> Variables:
    """A table of `recorded.toml`: dimensions, unit and meaning of each quantity."""
    return {key: (tuple(dimensions), unit, meaning) for key, (dimensions, unit, meaning) in _FILE[name].items()}


_FILE = table_beside(__file__)
VARIABLES = _table("variables")
STATES = _table("states")  # additional, of a scene that has what they are of
LOADS = _table("loads")  # additional, where they are wanted
LABELS: dict[str, str] = _FILE["labels"]  # what the names along each dimension are
AXES = ("x", "y", "z")
LAW_REPORTS = tuple(report.name.lower() for report in Report)  # those that are NaN where the law has none
DICTIONARIES = ("cost", "reports", "provenance")  # in the file as JSON


def variables_of(scene: Scene) -> Variables:
    """Quantities that runs of a scene record, as `VARIABLES`."""
    known = {"time", *labels_of(scene)}
    return VARIABLES | {name: one for name, one in STATES.items() if known.issuperset(one[0])}


def labels_of(scene: Scene) -> dict[str, tuple[str, ...]]:
    """The names along each dimension of `variables_of`, but for time."""
    structure, states = scene.structure, state_names(scene)
    constraints = tuple(one.name for one in structure.constraints)
    return {
        "node": tuple(structure.node_names),
        "axis": AXES,
        "string": tuple(string.name for string in structure.strings),
        "rod": tuple(rod.name for rod in structure.rods),
        **({"element_state": states} if states else {}),
        **({"constraint": constraints} if constraints else {}),
    }


def sizes_of(scene: Scene, samples: int) -> dict[str, int]:
    """Lengths of the dimensions of `variables_of`."""
    return {"time": samples, **{dimension: len(labels) for dimension, labels in labels_of(scene).items()}}


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """Data of a `Trajectory`, whose documentation explains the fields; it saves and analyses them."""

    scene: Scene
    time: Array
    nodes: Array
    velocities: Array
    force_densities: Array
    rest_lengths: Array
    tensions: Array
    multipliers: Array
    rod_force_densities: Array
    kinetic_energy: Array
    gravity_energy: Array
    string_energy: Array
    winch_work: Array
    external_work: Array
    dissipation: Array
    feasibility_margin: Array
    lyapunov: Array
    lyapunov_error: Array
    lyapunov_velocity: Array
    allocation_residual: Array
    status: Status = Status.COMPLETED
    message: str = ""
    engine: str = ""
    cost: dict[str, float] = field(default_factory=dict)
    reports: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    element_states: Array = field(default_factory=lambda: np.zeros((0, 0)))
    constraint_forces: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def timestep(self) -> float:
        """Fixed step of the engine [s]; NaN where it chose its steps."""
        step = self.provenance.get("engine", {}).get("timestep")
        return math.nan if step is None else float(step)

    @property
    def seconds_per_evaluation(self) -> float:
        """Wall time [s] of the steps by evaluations of the right-hand side (`cost`); NaN where there were none."""
        return self.cost.get("wall_time", math.nan) / (self.cost.get("evaluations") or math.nan)

    @property
    def element_state_names(self) -> tuple[str, ...]:
        """Names (S,) of `element_states`, such as "elements[0] Maxwell: s1"."""
        return state_names(self.scene)

    @property
    def bending_energy(self) -> Array:
        """Energy stored in bent joints (T,) [J]; zero where the scene's `resistance` has no such stiffness."""
        return bending_energy(self.scene, self.nodes)

    @property
    def element_energy(self) -> Array:
        """Energy stored in the scene's elements (T,) [J], bent joints among them."""
        return energy_of(self.scene.effects, self.scene, self.nodes, self.element_states)

    @property
    def energy_balance(self) -> Array:
        """Energy gained minus winch work minus external work plus dissipation (T,) [J]; zero if exact."""
        energy = self.kinetic_energy + self.gravity_energy + self.string_energy + self.element_energy
        return energy - energy[:1] - self.winch_work - self.external_work + self.dissipation

    @property
    def energy_residual(self) -> float:
        """Largest absolute entry of the energy balance [J]."""
        return float(np.max(np.abs(self.energy_balance), initial=0.0))

    @property
    def permanent_stretch(self) -> Array:
        """Permanent stretch (T, M) [m] of strings that yield, by the last sample that pulled; zero of all others."""
        structure = self.scene.structure
        if not structure.curves.yields.any():
            return np.zeros_like(self.rest_lengths)
        lengths = structure.string_lengths(self.nodes)
        elastic = self.force_densities * lengths
        known = structure.curves.yields & (elastic > 0)
        left = np.where(known, lengths - self.rest_lengths - elastic / np.where(known, structure.stiffness, 1.0), 0.0)
        return np.asarray(np.maximum.accumulate(np.maximum(left, 0.0), axis=0))

    @property
    def max_force_density(self) -> float:
        """Largest u over strings and time [N/m]."""
        return float(np.max(self.force_densities, initial=0.0))

    @property
    def min_feasibility_margin(self) -> float:
        """Smallest margin over time; NaN where no law reports one."""
        finite = self.feasibility_margin[~np.isnan(self.feasibility_margin)]
        return float(np.min(finite)) if finite.size else float("nan")

    @property
    def error_estimate(self) -> float:
        """Largest node error over the run [m] of an engine with `accuracy`; NaN where none was requested.

        `reports["accuracy"]["settled"]` states whether it can be relied on.
        """
        return float(self.reports.get("accuracy", {}).get("error_estimate", float("nan")))

    def target_error(self) -> Array:
        """Largest distance (T,) [m] of a node, ropes' apart, from its target at each time; NaN without a target."""
        if self.scene.target is None:
            return np.full(len(self.time), np.nan)
        from tensegrity_mj.dynamics.target import target_nodes

        aims = target_nodes(self.scene.structure.massless, self.scene.target, self.time)
        return np.max(np.linalg.norm(self.nodes[:, : aims.shape[1]] - aims, axis=-1), axis=1)

    def position(self, node: str) -> Array:
        """Position (T, 3) [m] of a node by its name; OptionError where there is none."""
        return np.asarray(self.nodes[:, self._number("node", node)])

    def velocity(self, node: str) -> Array:
        """Velocity (T, 3) [m/s] of a node by its name; OptionError where there is none."""
        return np.asarray(self.velocities[:, self._number("node", node)])

    def tension(self, string: str) -> Array:
        """Tension (T,) [N] of a string by its name, the mean along one with mass; OptionError where there is none."""
        rows, shares = self.parts_of(string)
        return np.asarray(self.tensions[:, rows] @ shares)

    def rest_length(self, string: str) -> Array:
        """Rest length (T,) [m] of a string by its name, one with mass as a whole; OptionError where there is none."""
        return np.asarray(self.rest_lengths[:, self.parts_of(string)[0]].sum(axis=1))

    def length(self, string: str) -> Array:
        """Length (T,) [m] of a string by its name, of one with mass along its parts; OptionError if there is none."""
        return np.asarray(self.scene.structure.string_lengths(self.nodes)[:, self.parts_of(string)[0]].sum(axis=1))

    @property
    def rod_forces(self) -> Array:
        """Forces (T, R) [N] along the rods, negative in compression."""
        return np.asarray(self.rod_force_densities * lengths(self.scene.structure, self.nodes))

    def rod_force(self, rod: str) -> Array:
        """Force (T,) [N] along a rod by its name, negative in compression; OptionError where there is none."""
        return np.asarray(self.rod_forces[:, self._number("rod", rod)])

    def parts_of(self, string: str) -> tuple[list[int], Array]:
        """The rows of what a string is made of, itself alone unless it has mass, and what part of it each is."""
        rope = next((one for one in self.scene.structure.ropes if one.string.name == string), None)
        if rope is None:
            return [self._number("string", string)], np.ones(1)
        first = self._number("string", rope.parts[0].name)
        return list(range(first, first + len(rope.parts))), rope.shares

    def _number(self, dimension: str, name: str) -> int:
        names = labels_of(self.scene)[dimension]
        check_known(f"the run of '{self.scene.name}'", name, names, dimension)
        return names.index(name)

    def at(self, time: float | str) -> Self:
        """The run up to its sample at a time [s], from which `simulate` goes on; OptionError where there is none."""
        time = finite("time", seconds.read(time), " [s]")
        row = int(np.searchsorted(self.time, time * (1 - 1e-9)))
        if row == len(self.time) or self.time[row] > time * (1 + 1e-9):
            nearest = " and ".join(f"{one:.9g} s" for one in self.time[max(row - 1, 0) : row + 1])
            raise OptionError(f"the run of '{self.scene.name}' has no sample at {time:.9g} s; the nearest: {nearest}")
        found = self.until(row + 1)
        return found if found is self else replace(found, status=Status.COMPLETED, message="")

    def until(self, count: int) -> Self:
        """The first `count` samples."""
        if count == len(self.time):
            return self
        known = {key: one for key, one in self.provenance.items() if key != "end"}  # the state of another time
        return replace(self, provenance=known, **{name: getattr(self, name)[:count] for name in (*VARIABLES, *STATES)})


assert {*VARIABLES, *STATES, *DICTIONARIES} < {f.name for f in fields(RecordedRun)}


MAY_BE_NAN = "report"  # of a run's end: what laws report


def texts_of(engine: str, parts: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Encode the state of a run's end as texts: arrays by names, with their sizes, and the engine's name.

    They are `provenance["end"]`, which `parts_of` reads.
    """
    found = {name: np.array(part, float) for name, part in parts.items()}
    coded = {name: base64.b64encode(part.tobytes()).decode() for name, part in found.items()}
    return {"engine": engine, "sizes": {name: part.size for name, part in found.items()}, **coded}


def parts_of(end: Any, where: str) -> dict[str, Array]:
    """The arrays (size,) of an end.

    Raises:
        FormatError: where it is damaged; `where` begins the message.
    """
    place, parts = "provenance.end", {}
    try:
        if not isinstance(end["engine"], str) or end.keys() != {"engine", "sizes", *end["sizes"]}:
            raise KeyError
        for name, size in end["sizes"].items():
            place = f"provenance.end.{name}"
            parts[name] = np.frombuffer(base64.b64decode(end[name], validate=True))
            if len(parts[name]) != size or not (name == MAY_BE_NAN or np.isfinite(parts[name]).all()):
                raise ValueError
    except (AttributeError, KeyError, TypeError, ValueError):
        raise FormatError(
            f"{where}: {place} is not the state of a run's end: the file is damaged or was changed; simulate that run "
            "again"
        ) from None
    return parts
