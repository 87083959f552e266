"""Trajectories: what every engine returns, saves and loads. Nodes in the world frame, SI units."""

from __future__ import annotations

import enum
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.basics.jsontext import from_exact_json, to_exact_json
from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.errors import FormatError, TensegrityError
from tensegrity_mj.model.elements.element import energy_of, state_names
from tensegrity_mj.model.elements.resistance import bending_energy
from tensegrity_mj.model.scene import Scene

FORMAT = 2
MOST_PACKED = 1032  # bytes that one byte of a file may stand for: the most that its compression, deflate, achieves


class Status(enum.Enum):
    """How a run ended."""

    COMPLETED = "completed"
    INFEASIBLE = "infeasible"  # the control problem had no admissible solution and the caller chose to stop
    DIVERGED = "diverged"
    SINGULAR = "singular"  # the engine's coordinates cannot hold the state that the run came to


# Every recorded quantity: dimensions, unit, meaning. One table for the class, the file and the docs.
VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "time": (("time",), "s", "simulated time"),
    "nodes": (("time", "node", "axis"), "m", "node positions, world frame"),
    "velocities": (("time", "node", "axis"), "m/s", "node velocities, world frame"),
    "force_densities": (("time", "string"), "N/m", "u: elastic force density of the strings"),
    "rest_lengths": (("time", "string"), "m", "L0: rest lengths of the strings"),
    "tensions": (("time", "string"), "N", "tension of the strings, damping included"),
    "multipliers": (("time", "rod"), "1/s2", "λ of (2.31)"),
    "rod_force_densities": (("time", "rod"), "N/m", "J λ / ℓ²; negative in compression"),
    "kinetic_energy": (("time",), "J", "kinetic energy"),
    "gravity_energy": (("time",), "J", "potential energy of gravity"),
    "string_energy": (("time",), "J", "elastic energy of the strings"),
    "winch_work": (("time",), "J", "-∫ T dL0, T the elastic tension: work of the winches on the strings"),
    "external_work": (("time",), "J", "work of external nodal forces, contact, moved supports, wind and water"),
    "dissipation": (("time",), "J", "energy taken by the strings' dampers and by what resists motion"),
    "feasibility_margin": (("time",), "m2 or as the law defines", "max(v/α) of (5.18); NaN without such a law"),
    "lyapunov": (("time",), "as the law defines", "V of (5.3); NaN without such a law"),
    "lyapunov_error": (("time",), "as the law defines", "terms of V in the errors alone; NaN without such a law"),
    "lyapunov_velocity": (("time",), "as the law defines", "terms of V with velocities; NaN without such a law"),
    "allocation_residual": (
        ("time",),
        "as the law defines",
        "largest violation of what a law with an optimal allocation asked of the strings; NaN without such a law",
    ),
}
# Besides, of a scene whose elements have states.
STATES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "element_states": (("time", "element_state"), "as the elements define", "states of the elements, in their order"),
}
LAW_REPORTS = tuple(report.name.lower() for report in Report)  # those that are NaN where the law has none
DICTIONARIES = ("cost", "reports", "provenance")  # in the file as JSON


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One simulated run: arrays over time as in `VARIABLES`, and where they come from.

    It has no samples where a run diverged at its very start.

    Attributes:
        scene: what was simulated (loads given as a Python function are not kept in files).
        status, message: how it ended, and in words when not completed.
        engine: one line that names engine, integrator and step or tolerance.
        cost: `wall_time` [s], `steps`, `evaluations` of the right-hand side, and what else the engine counts.
        reports: numbers about the run: constraint drift, largest holding ratio, times with L0 <= 0, ...
        provenance: versions, options and seeds, as text or numbers.
        element_states: (T, S) of the elements that have one, as `element_state_names` calls them.
    """

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

    @property
    def element_state_names(self) -> tuple[str, ...]:
        """(S,) what `element_states` has, such as "elements[0] Maxwell: s1"."""
        return state_names(self.scene)

    @property
    def bending_energy(self) -> Array:
        """(T,) [J]: what bent joints have stored; zero where the scene's `resistance` has no such stiffness."""
        return bending_energy(self.scene, self.nodes)

    @property
    def element_energy(self) -> Array:
        """(T,) [J]: what the scene's elements have stored, bent joints among them."""
        return energy_of(self.scene.effects, self.scene, self.nodes, self.element_states)

    @property
    def energy_balance(self) -> Array:
        """(T,) [J]: energy gained minus winch work minus external work plus dissipation; zero if exact."""
        energy = self.kinetic_energy + self.gravity_energy + self.string_energy + self.element_energy
        return energy - energy[:1] - self.winch_work - self.external_work + self.dissipation

    @property
    def energy_residual(self) -> float:
        """Largest absolute entry of the energy balance [J]."""
        return float(np.max(np.abs(self.energy_balance), initial=0.0))

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
        """Largest node error over the run [m] of an engine with `accuracy`; NaN where none was wanted.

        `reports["accuracy"]["settled"]` states whether it can be relied on.
        """
        return float(self.reports.get("accuracy", {}).get("error_estimate", float("nan")))

    def target_error(self) -> Array:
        """(T,) [m]: largest distance of a node from its target at each time; NaN without a target."""
        if self.scene.target is None:
            return np.full(len(self.time), np.nan)
        from tensegrity_mj.dynamics.target import target_nodes

        aims = target_nodes(self.scene.structure, self.scene.target, self.time)
        return np.max(np.linalg.norm(self.nodes - aims, axis=-1), axis=1)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write NetCDF-4 (.nc), atomically (a crash leaves the old file or none); returns the path.

        Raises:
            OptionError: for another suffix, or a place where no file can be written.
            FormatError: if writing fails.
        """
        from tensegrity_mj.model.text.writing import scene_to_toml
        from tensegrity_mj.runs.netcdf import write_netcdf

        destination = checked(path, (".nc",), "trajectory")
        variables = {
            name: (dimensions, getattr(self, name), {"units": unit, "long_name": meaning})
            for name, (dimensions, unit, meaning) in variables_of(self.scene).items()
        }
        if "element_states" in variables:
            variables["element_states"][2]["names"] = ", ".join(self.element_state_names)
        attributes: dict[str, str | int] = {
            "format": FORMAT,
            "title": f"tensegrity_mj trajectory of scene {self.scene.name}",
            "scene": scene_to_toml(_without_functions(self.scene, self.time)),
            "status": self.status.value,
            "message": self.message,
            "engine": self.engine,
            **{name: to_exact_json(getattr(self, name)) for name in DICTIONARIES},
        }
        with replacing(destination) as part:
            write_netcdf(part, _sizes(self.scene, len(self.time)), variables, attributes)
        return destination

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read what `save` wrote, exactly.

        Raises:
            FormatError: if the file is absent, damaged, or no trajectory, or where its times do not rise or its values
                are not finite (what a law reports may be NaN); it says which.
        """
        import h5netcdf

        from tensegrity_mj.model.text.reading import scene_from_toml

        try:
            source = Path(path)
        except TypeError:
            raise FormatError(f"{path!r}: that is no path; give the name of a trajectory's .nc file") from None
        try:
            if source.is_dir():
                raise FormatError(f"{path}: that is a folder; name a .nc file in it")
            if not source.is_file():
                raise FormatError(f"{path}: no such file")
            with h5netcdf.File(source, "r") as file:
                if file.attrs.get("format") != FORMAT or "scene" not in file.attrs:
                    raise FormatError(f"{path}: a NetCDF file, but no trajectory of format {FORMAT} of tensegrity_mj")
                texts = {key: _text(file.attrs[key]) for key in ("scene", "status", "message", "engine", *DICTIONARIES)}
                scene = scene_from_toml(texts["scene"], where=str(path))
                variables = {name: file.variables[name] for name in variables_of(scene)}
                _check_shapes(source, scene, {name: tuple(variable.shape) for name, variable in variables.items()})
                arrays: dict[str, Any] = {name: np.array(variable[...], float) for name, variable in variables.items()}
            status = Status(texts["status"])
            extra = {key: from_exact_json(texts[key]) for key in DICTIONARIES}
        except TensegrityError:
            raise
        except (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError) as error:
            # What the libraries of the format raise for damaged files is documented nowhere.
            raise FormatError(f"{path}: not a readable trajectory ({error})") from error
        for key, value in extra.items():
            if not isinstance(value, dict):
                raise FormatError(f"{path}: {key} is a {type(value).__name__}; it must be a JSON object")
        _check_words(str(path), extra)
        _check_values(str(path), arrays)
        return cls(scene, **arrays, status=status, message=texts["message"], engine=texts["engine"], **extra)

    def until(self, count: int) -> Trajectory:
        """The first `count` samples."""
        if count == len(self.time):
            return self
        return replace(self, **{name: getattr(self, name)[:count] for name in (*VARIABLES, *STATES)})


assert {*VARIABLES, *STATES, *DICTIONARIES} < {f.name for f in fields(Trajectory)}


def variables_of(scene: Scene) -> dict[str, tuple[tuple[str, ...], str, str]]:
    """What runs of a scene have recorded, as `VARIABLES`."""
    return VARIABLES | (STATES if state_names(scene) else {})


def _text(value: Any) -> str:
    """An attribute as text, which UTF-8 can hold; ValueError where it is none."""
    text = str(value)
    text.encode()
    return text


def _check_shapes(source: Path, scene: Scene, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise FormatError unless the variables have the shapes of a scene, and as many numbers as the file can hold.

    Looked at before they are read: a small file may declare more than any memory holds.
    """
    sizes = _sizes(scene, math.prod(shapes["time"]))
    for name, (dimensions, _, _) in variables_of(scene).items():
        shape = tuple(sizes[dimension] for dimension in dimensions)
        if shapes[name] != shape:
            raise FormatError(
                f"{source}: {name} has shape {shapes[name]}; for its scene '{scene.name}' and its times it must be "
                f"{shape}, ({', '.join(dimensions)})"
            )
    declared, stored = 8 * sum(math.prod(shape) for shape in shapes.values()), source.stat().st_size
    if declared > MOST_PACKED * stored:
        raise FormatError(
            f"{source}: its variables have {declared:.3g} bytes of numbers, which a file of {stored} bytes cannot "
            "hold: it is damaged; save the run again"
        )


def _sizes(scene: Scene, samples: int) -> dict[str, int]:
    """Lengths of the dimensions of `variables_of`."""
    structure, states = scene.structure, len(state_names(scene))
    return {
        "time": samples,
        "node": len(structure.nodes),
        "axis": 3,
        "string": len(structure.strings),
        "rod": len(structure.rods),
        **({"element_state": states} if states else {}),
    }


def _check_values(path: str, arrays: dict[str, Array]) -> None:
    """Raise FormatError where times do not rise, or where what every run has is not finite."""
    for name, (dimensions, unit, _) in (VARIABLES | STATES).items():
        if name not in arrays:
            continue
        finite = np.isfinite(arrays[name])
        if name in LAW_REPORTS or finite.all():
            continue
        place = np.argwhere(~finite)[0].tolist()
        at = ", ".join(f"{dimension} {number}" for dimension, number in zip(dimensions, place, strict=True))
        raise FormatError(
            f"{path}: {name} is {arrays[name][tuple(place)]} {unit} at {at} (counted from 0); it must be finite: the "
            "file is damaged or was changed, write it anew"
        )
    time = arrays["time"]
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        row = int(back[0])
        raise FormatError(
            f"{path}: time {row + 1} (counted from 0) is {time[row + 1]:.9g} s after {time[row]:.9g} s; times must "
            "rise: the file is damaged or was changed, write it anew"
        )


# What is read again of the words of a run, by other commands: where it stands, its type, and the words of that.
READ_AGAIN: dict[tuple[str, ...], tuple[tuple[type, ...], str]] = {
    ("reports", "warnings"): ((list,), "a list of texts"),
    ("reports", "accuracy"): ((dict,), "an object"),
    ("reports", "accuracy", "met"): ((bool,), "true or false"),
    ("reports", "accuracy", "reason"): ((str,), "a text"),
    ("reports", "accuracy", "error_estimate"): ((int, float, type(None)), "a number"),
    ("reports", "stability"): ((dict,), "an object"),
    ("provenance", "controller"): ((dict, type(None)), "an object"),
    ("provenance", "actuation"): ((dict, type(None)), "an object"),
    ("provenance", "actuation", "mode"): ((str,), "a text"),
    ("provenance", "actuation", "period"): ((int, float, type(None)), "a number"),
    ("cost", "wall_time"): ((int, float, type(None)), "a number"),
}


def _check_words(path: str, words: dict[str, Any]) -> None:
    """Raise FormatError where something that is read again has another type; what is absent may be, but for `met`."""
    for place, (kinds, meaning) in READ_AGAIN.items():
        inside: Any = words
        for key in place[:-1]:
            inside = inside.get(key) or {}
        value = inside.get(place[-1], ...)
        held = place[-1] == "period" and inside.get("mode", "continuous") != "continuous"
        if held and value in (..., None):
            kinds = (int, float)
        absent = value is ... and not held and not (place[-1] in ("met", "mode") and inside)
        texts = not isinstance(value, list) or all(isinstance(item, str) for item in value)
        if not absent and not (isinstance(value, kinds) and texts):
            found = "missing" if value is ... else f"a {type(value).__name__}"
            raise FormatError(
                f"{path}: {'.'.join(place)} is {found}; it must be {meaning}: the file is damaged or was changed, "
                "write it anew"
            )


def _without_functions(scene: Scene, time: Array) -> Scene:
    """The scene as a file can hold it: without loads, and with data of motions, where these are functions."""
    if callable(scene.loads):
        scene = scene.with_(loads=())
    if any(motion.function is not None for motion in scene.motions):
        # At the recorded times, and on to the end of the scene: data must not stop on their way.
        end = float(time[-1]) if len(time) else 0.0
        more = np.linspace(end, max(scene.duration, end + 1e-3), 101)[1:]
        times = np.concatenate([time if len(time) else [0.0], more if scene.duration > end or len(time) < 2 else []])
        motions = [motion if motion.function is None else motion.sampled(times) for motion in scene.motions]
        scene = scene.with_(motions=motions)
    return scene
