"""Runs as tables of other programs: xarray, pandas, CSV, MATLAB."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.dependencies import optional
from tensegrity_mj.basics.matfile import legal_names, save_mat
from tensegrity_mj.runs.stored import attributes_in_file, recorded, variables_in_file
from tensegrity_mj.runs.variables import AXES, labels_of

if TYPE_CHECKING:
    import pandas
    import xarray

    from tensegrity_mj.runs.trajectory import Trajectory

# What a column is called after its member: "n1.x", "s1.tension".
VECTORS = {
    "nodes": AXES,
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


def columns_of(run: Trajectory, water_loads: bool = False) -> tuple[list[str], Array]:
    """The names (K,) and the values (T, K) of what `recorded` has, time first; units as in `VARIABLES`."""
    labels, names, values = labels_of(run.scene), [], []
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


def to_xarray(run: Trajectory, water_loads: bool = False) -> xarray.Dataset:
    """Dataset of a run, as `xarray.open_dataset` reads its file, with loads of water where they are wanted."""
    xr = optional("xarray", "run.to_xarray()")
    held = {
        name: (dimensions, np.array(values), attributes)
        for name, (dimensions, values, attributes) in variables_in_file(run, water_loads).items()
    }
    coordinates = {name: held.pop(name) for name in ("time", *labels_of(run.scene))}
    return xr.Dataset(held, coordinates, attributes_in_file(run))


def to_dataframe(run: Trajectory, water_loads: bool = False) -> pandas.DataFrame:
    """A row for each time, which is the index; columns as `columns_of` names them, and loads of water, where wanted."""
    pd = optional("pandas", "run.to_dataframe()")
    names, values = columns_of(run, water_loads)
    return pd.DataFrame(values[:, 1:], index=pd.Index(values[:, 0], name=names[0]), columns=names[1:])


def write_csv(run: Trajectory, path: Path, water_loads: bool = False) -> None:
    """The columns of `columns_of` below their names; every number as exactly as it is."""
    names, values = columns_of(run, water_loads)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(values.tolist())


def write_mat(run: Trajectory, path: Path, water_loads: bool = False) -> None:
    """The arrays of a run, what stands along their dimensions, and the numbers of members there, counted from 1.

    In MATLAB: `plot(time, tensions(:, string_number.s1))`.
    """
    found = recorded(run, water_loads)
    data: dict[str, Any] = {name: values for name, (_, _, _, values) in found.items()}
    for dimension, names in labels_of(run.scene).items():
        data[f"{dimension}_names"] = names
        if names:
            data[f"{dimension}_number"] = {name: float(k + 1) for k, name in enumerate(legal_names(names))}
    data["units"] = {name: unit for name, (_, unit, _, _) in found.items()}
    data["about"] = attributes_in_file(run)
    save_mat(path, data)
