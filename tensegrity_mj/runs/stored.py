"""Files of runs: NetCDF, read back exactly or refused with a reason; and tables for xarray, pandas, CSV and MATLAB.

NetCDF files follow the CF conventions (https://cfconventions.org) where these fit: `units` are udunits', where a law or
an element defines the unit there is a `unit_note` in their place, and each dimension has coordinates, which are names
but for time. Nothing in a file depends on when it was written.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.dependencies import optional
from tensegrity_mj.basics.files import path_of
from tensegrity_mj.basics.jsontext import from_exact_json, to_exact_json
from tensegrity_mj.basics.matfile import legal_names, save_mat
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs import recorded as known
from tensegrity_mj.runs.flow_regime import loaded_by_water
from tensegrity_mj.runs.flow_regime import water_loads as loads_of_water
from tensegrity_mj.runs.netcdf import opened, write_netcdf
from tensegrity_mj.runs.recorded import RecordedRun, parts_of

if TYPE_CHECKING:
    import pandas
    import xarray

    from tensegrity_mj.runs.netcdf import Variables

FORMAT = 2
CONVENTIONS = "CF-1.11"
MOST_PACKED = 1032  # bytes that one byte of a file may stand for: the most that its compression, deflate, achieves


def recorded(run: RecordedRun, water_loads: bool = False) -> dict[str, tuple[tuple[str, ...], str, str, Array]]:
    """Dimensions, unit, meaning and values of what a run has; with loads of water on members, where these are wanted.

    Raises:
        OptionError: for loads of water, as `Trajectory.water_loads`.
    """
    found = {name: (*about, getattr(run, name)) for name, about in known.variables_of(run.scene).items()}
    if water_loads:
        kinds = loaded_by_water(run.scene) or ("rod",)  # of which the message is that there is no water
        wanted = {name: about for name, about in known.LOADS.items() if about[0][1] in kinds}
        found |= {name: (*about, loads_of_water(run, about[0][1])) for name, about in wanted.items()}
    return found


def variables_in_file(run: RecordedRun, water_loads: bool = False) -> Variables:
    """Dimensions, values and attributes of all that a file holds of a run: its coordinates first, then the rest."""
    labels = {
        name: ((name,), names, {"long_name": known.LABELS[name]}) for name, names in known.labels_of(run.scene).items()
    }
    # Units as CF has them, udunits'; a note in their place where a law or an element defines one.
    data = {
        name: (dimensions, values, {"unit_note" if " " in unit else "units": unit, "long_name": meaning})
        for name, (dimensions, unit, meaning, values) in recorded(run, water_loads).items()
    }
    if "element_states" in data:
        data["element_states"][2]["names"] = ", ".join(run.element_state_names)
    return {"time": data.pop("time"), **labels, **data}


def attributes_in_file(run: RecordedRun) -> dict[str, str | int]:
    """The attributes of a run's file: those of CF, then what `read_run` makes the run of."""
    from tensegrity_mj.model.text.writing import scene_to_toml

    versions = run.provenance.get("versions", {})
    program = " ".join(["tensegrity-mj", *[str(versions[name]) for name in ("tensegrity-mj",) if name in versions]])
    law = (run.provenance.get("controller") or {}).get("law", "none")
    return {
        "Conventions": CONVENTIONS,
        "title": f"tensegrity_mj trajectory of scene {run.scene.name}",
        "source": f"{program}: {run.engine}",
        "history": f"{program}: simulate scene {run.scene.name}, law {law}",
        **({"references": run.scene.source} if run.scene.source else {}),
        "format": FORMAT,
        "scene": scene_to_toml(_without_functions(run.scene, run.time)),
        "status": run.status.value,
        "message": run.message,
        "engine": run.engine,
        **{name: to_exact_json(getattr(run, name)) for name in known.DICTIONARIES},
    }


def write_run(run: RecordedRun, path: Path, water_loads: bool = False) -> None:
    """Write the NetCDF-4 file of a run."""
    write_netcdf(path, variables_in_file(run, water_loads), attributes_in_file(run))


def is_table(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is for `read_table` rather than for `read_run`: CSV, or NetCDF with nodes and no scene."""
    if Path(path).suffix.lower() != ".nc":
        return True
    try:
        with opened(path, "table") as file:
            return "node" in file.variables and "scene" not in file.attrs
    except FormatError:
        return False  # reading it says what is wrong


def read_run(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The fields of the `Trajectory` that a file holds, exactly as they were.

    Raises:
        FormatError: as `Trajectory.load`.
    """
    from tensegrity_mj.model.text.reading import scene_from_toml

    source = path_of(path, "a trajectory's .nc file")
    with opened(source, "trajectory", "; name a file that `run --out` or `save` wrote") as file:
        if file.attrs.get("format") != FORMAT or "scene" not in file.attrs:
            raise FormatError(f"{path}: a NetCDF file, but no trajectory of format {FORMAT} of tensegrity_mj")
        texts = {key: _text(file.attrs[key]) for key in ("scene", "status", "message", "engine", *known.DICTIONARIES)}
        scene = scene_from_toml(texts["scene"], where=str(path))
        variables = {name: file.variables[name] for name in known.variables_of(scene)}
        _check_shapes(source, scene, {name: tuple(variable.shape) for name, variable in variables.items()})
        _check_labels(source, scene, file.variables)
        arrays: dict[str, Any] = {name: np.array(variable[...], float) for name, variable in variables.items()}
        status = known.Status(texts["status"])
        extra = {key: from_exact_json(texts[key]) for key in known.DICTIONARIES}
    for key, value in extra.items():
        if not isinstance(value, dict):
            raise FormatError(f"{path}: {key} is a {type(value).__name__}; it must be a JSON object")
    _check_words(str(path), extra)
    if (end := extra["provenance"].get("end")) is not None:
        parts_of(end, str(path))
    _check_values(str(path), arrays)
    return {"scene": scene, **arrays, "status": status, "message": texts["message"], "engine": texts["engine"], **extra}


def _text(value: Any) -> str:
    """An attribute as text, which UTF-8 can hold; ValueError where it is none."""
    text = str(value)
    text.encode()
    return text


def _check_shapes(source: Path, scene: Scene, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise FormatError unless the variables have the shapes of a scene, and as many numbers as the file can hold.

    Looked at before they are read: a small file may declare more than any memory holds.
    """
    sizes = known.sizes_of(scene, math.prod(shapes["time"]))
    for name, (dimensions, _, _) in known.variables_of(scene).items():
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


def _check_labels(source: Path, scene: Scene, variables: Mapping[str, Any]) -> None:
    """Raise FormatError where names along a dimension are others than the scene's: somebody has put them in order.

    Files from before these names were written have none.
    """
    for dimension, names in known.labels_of(scene).items():
        if dimension not in variables:
            continue
        if tuple(variables[dimension].shape) != (len(names),):
            raise FormatError(
                f"{source}: {dimension} has shape {variables[dimension].shape}; it must be ({len(names)},)"
            )
        for number, (found, name) in enumerate(zip(map(_text, variables[dimension][...]), names, strict=True)):
            if found != name:
                raise FormatError(
                    f"{source}: {dimension} {number} (counted from 0) is '{found}', in its scene it is '{name}': "
                    "the file was put in another order; save the run in the order that it had"
                )


def _check_values(path: str, arrays: dict[str, Array]) -> None:
    """Raise FormatError where times do not rise, or where what every run has is not finite."""
    for name, (dimensions, unit, _) in (known.VARIABLES | known.STATES).items():
        if name not in arrays:
            continue
        finite = np.isfinite(arrays[name])
        if name in known.LAW_REPORTS or finite.all():
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
        last = scene.start_time + scene.duration
        more = np.linspace(end, max(last, end + 1e-3), 101)[1:]
        times = np.concatenate([time if len(time) else [0.0], more if last > end or len(time) < 2 else []])
        motions = [motion if motion.function is None else motion.sampled(times) for motion in scene.motions]
        scene = scene.with_(motions=motions)
    return scene


# What a column is called after its member: "n1.x", "s1.tension".
VECTORS = {
    "nodes": known.AXES,
    "velocities": ("vx", "vy", "vz"),
    "water_loads": ("water_x", "water_y", "water_z"),
    "string_water_loads": ("drag_x", "drag_y", "drag_z"),  # a rod may have the same name
}
OF_MEMBERS = {
    "force_densities": "force_density",
    "rest_lengths": "rest_length",
    "tensions": "tension",
    "multipliers": "multiplier",
    "rod_force_densities": "rod_force_density",
}


def columns_of(run: RecordedRun, water_loads: bool = False) -> tuple[list[str], Array]:
    """The names (K,) and the values (T, K) of what `recorded` has, time first; units as in `VARIABLES`."""
    labels, names, values = known.labels_of(run.scene), [], []
    for name, (dimensions, _, _, array) in recorded(run, water_loads).items():
        members: tuple[str, ...] = labels[dimensions[1]] if len(dimensions) > 1 else ()
        if name in VECTORS:
            names += [f"{member}.{axis}" for member in members for axis in VECTORS[name]]
        elif name in OF_MEMBERS:
            names += [f"{member}.{OF_MEMBERS[name]}" for member in members]
        else:
            names += members or [name]
        values.append(array.reshape(len(array), int(np.prod(array.shape[1:]))))
    return names, np.hstack(values)


def to_xarray(run: RecordedRun, water_loads: bool = False) -> xarray.Dataset:
    """Dataset of a run, as `xarray.open_dataset` reads its file, with loads of water where they are wanted."""
    xr = optional("xarray", "run.to_xarray()")
    held = {
        name: (dimensions, np.array(values), attributes)
        for name, (dimensions, values, attributes) in variables_in_file(run, water_loads).items()
    }
    coordinates = {name: held.pop(name) for name in ("time", *known.labels_of(run.scene))}
    return xr.Dataset(held, coordinates, attributes_in_file(run))


def to_dataframe(run: RecordedRun, water_loads: bool = False) -> pandas.DataFrame:
    """A row for each time, which is the index; columns as `columns_of` names them, and loads of water, where wanted."""
    pd = optional("pandas", "run.to_dataframe()")
    names, values = columns_of(run, water_loads)
    return pd.DataFrame(values[:, 1:], index=pd.Index(values[:, 0], name=names[0]), columns=names[1:])


def write_csv(run: RecordedRun, path: Path, water_loads: bool = False) -> None:
    """The columns of `columns_of` below their names; every number as exactly as it is."""
    names, values = columns_of(run, water_loads)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(values.tolist())


def write_mat(run: RecordedRun, path: Path, water_loads: bool = False) -> None:
    """The arrays of a run, what stands along their dimensions, and the numbers of members there, counted from 1.

    In MATLAB: `plot(time, tensions(:, string_number.s1))`.
    """
    found = recorded(run, water_loads)
    data: dict[str, Any] = {name: values for name, (_, _, _, values) in found.items()}
    for dimension, names in known.labels_of(run.scene).items():
        data[f"{dimension}_names"] = names
        if names:
            data[f"{dimension}_number"] = {name: float(k + 1) for k, name in enumerate(legal_names(names))}
    data["units"] = {name: unit for name, (_, unit, _, _) in found.items()}
    data["about"] = attributes_in_file(run)
    save_mat(path, data)
