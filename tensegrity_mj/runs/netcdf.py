"""Writes NetCDF-4 files of float64 arrays with named dimensions, straight through HDF5.

What makes an HDF5 file a NetCDF-4 file: its objects are kept in the order of their creation; a dimension is a scale,
which has its number; a variable is attached to the scales of its dimensions, and has their numbers
(https://docs.unidata.ucar.edu/netcdf-c/current/file_format_specifications.html). h5netcdf, which reads the files, takes
three times as long to write them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array

NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."


def write_netcdf(
    path: Path,
    sizes: Mapping[str, int],
    variables: Mapping[str, tuple[tuple[str, ...], Array, Mapping[str, str]]],
    attributes: Mapping[str, str | int],
) -> None:
    """Write a file.

    Args:
        path: where to.
        sizes: of the dimensions; one of length zero is written as unlimited, as NetCDF has it.
        variables: dimensions, values and attributes of each. One that is named as its dimension is its coordinates.
        attributes: of the file.

    Raises:
        OSError, RuntimeError, ValueError: where HDF5 cannot write.
    """
    import h5py

    numbers = {name: np.array(number, np.int32) for number, name in enumerate(sizes)}
    with h5py.File(path, "w", track_order=True) as file:
        text = f"version=2,hdf5={h5py.version.hdf5_version},h5py={h5py.__version__}"
        file.attrs["_NCProperties"] = np.bytes_(text)
        scales = {}
        for name, size in sizes.items():
            if name not in variables:
                scale = file.create_dataset(name, (size,), ">f4", track_order=True, **_room((size,)))
                scale.make_scale(f"{NO_VARIABLE}{size:10}")
                scale.attrs["_Netcdf4Dimid"] = numbers[name]
                scales[name] = scale
        made = {}
        for name, (dimensions, values, _) in variables.items():
            data = np.asarray(values, float)
            made[name] = file.create_dataset(name, data=data, track_order=True, **_room(data.shape))
            if dimensions == (name,):
                made[name].make_scale(name)
                scales[name] = made[name]
        for name, (dimensions, _, described) in variables.items():
            variable = made[name]
            if dimensions != (name,):
                for axis, dimension in enumerate(dimensions):
                    variable.dims[axis].attach_scale(scales[dimension])
            variable.attrs["_Netcdf4Coordinates"] = np.array([numbers[dimension] for dimension in dimensions], np.int32)
            if dimensions == (name,) or sizes[dimensions[0]]:  # NetCDF notes it when it writes the first values
                variable.attrs["_Netcdf4Dimid"] = numbers[dimensions[0]]
            for key, text in described.items():
                variable.attrs[key] = text
        for key, value in attributes.items():
            file.attrs[key] = value if isinstance(value, str) else np.array([value])


def _room(shape: tuple[int, ...]) -> dict[str, Any]:
    """Contiguous storage, but for what has a dimension without end."""
    return {} if all(shape) else {"maxshape": tuple(size or None for size in shape)}
