"""Writes NetCDF-4 files of float64 arrays and of names, with named dimensions, straight through HDF5.

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

# Dimensions, values (names, where it is a tuple) and attributes.
Variables = Mapping[str, tuple[tuple[str, ...], Array | tuple[str, ...], Mapping[str, str]]]


def write_netcdf(path: Path, variables: Variables, attributes: Mapping[str, str | int]) -> None:
    """Write a file.

    Args:
        path: where to.
        variables: dimensions, values and attributes of each. Those that are named as their dimension are its
            coordinates, and come first; a dimension of length zero is written as unlimited, as NetCDF has it.
        attributes: of the file.

    Raises:
        OSError, RuntimeError, ValueError: where HDF5 cannot write.
    """
    import h5py

    coordinates = [name for name, (dimensions, _, _) in variables.items() if dimensions == (name,)]
    numbers = {name: np.array(number, np.int32) for number, name in enumerate(coordinates)}
    with h5py.File(path, "w", track_order=True) as file:
        text = f"version=2,hdf5={h5py.version.hdf5_version},h5py={h5py.__version__}"
        file.attrs["_NCProperties"] = np.bytes_(text)
        made = {}
        for name, (_, values, _) in variables.items():
            data = np.asarray(values)
            kind = h5py.string_dtype() if isinstance(values, tuple) else np.dtype(float)
            made[name] = file.create_dataset(name, data=data.astype(kind), track_order=True, **_room(data.shape))
            if name in numbers:
                made[name].make_scale(name)
        for name, (dimensions, _, described) in variables.items():
            variable = made[name]
            if name not in numbers:
                for axis, dimension in enumerate(dimensions):
                    variable.dims[axis].attach_scale(made[dimension])
            variable.attrs["_Netcdf4Coordinates"] = np.array([numbers[dimension] for dimension in dimensions], np.int32)
            if name in numbers or len(made[dimensions[0]]):  # NetCDF notes it when it writes the first values
                variable.attrs["_Netcdf4Dimid"] = numbers[dimensions[0]]
            for key, text in described.items():
                variable.attrs[key] = text
        for key, value in attributes.items():
            file.attrs[key] = value if isinstance(value, str) else np.array([value])


def _room(shape: tuple[int, ...]) -> dict[str, Any]:
    """Contiguous storage, but for what has a dimension without end."""
    return {} if all(shape) else {"maxshape": tuple(size or None for size in shape)}
