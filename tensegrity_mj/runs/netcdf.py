"""NetCDF-4 files: opened for reading, and written of float64 arrays and names straight through HDF5.

What makes an HDF5 file a NetCDF-4 file: its objects are kept in the order of their creation; a dimension is a scale,
which has its number; a variable is attached to the scales of its dimensions, and has their numbers
(https://docs.unidata.ucar.edu/netcdf-c/current/file_format_specifications.html). h5netcdf, which reads the files, takes
three times as long to write them.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import FormatError, TensegrityError

SEAL = b"\ntensegrity-mj sha256 "  # and 64 digits: behind the content of HDF5, which reads nothing there
# Dimensions, values (names, where it is a tuple) and attributes.
Variables = Mapping[str, tuple[tuple[str, ...], Array | tuple[str, ...], Mapping[str, str]]]


@contextlib.contextmanager
def opened(path: str | os.PathLike[str], what: str, remedy: str = "") -> Iterator[Any]:
    """A file that is there, to read `what` from it in the block.

    Raises:
        FormatError: where there is no file, or where the block cannot read it: what the libraries of the format raise
            for damaged files is documented nowhere.
    """
    import h5netcdf

    try:
        if Path(path).is_dir():
            raise FormatError(f"{path}: that is a folder; name a .nc file in it")
        if not Path(path).is_file():
            raise FormatError(f"{path}: no such file")
        _check_seal(Path(path))
        with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
            yield file
    except TensegrityError:
        raise
    except (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError) as error:
        raise FormatError(f"{path}: not a readable {what} ({error}){remedy}") from error


def _check_seal(path: Path) -> None:
    """Raise FormatError where the content of a file is not that of its checksum; others' files have none.

    HDF5 may loop for ever in a damaged file, so that it must not see one. A program that changes a file in place drops
    what follows the content of HDF5, and the checksum with it.
    """
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END) - len(SEAL) - 64
        file.seek(max(size, 0))
        if size < 0 or file.read(len(SEAL)) != SEAL:
            return
        promised = file.read()
        file.seek(0)
        digest = hashlib.sha256()
        while size:
            size -= len(piece := file.read(min(size, 1 << 20)))
            digest.update(piece)
    if digest.hexdigest().encode() != promised:
        raise FormatError(f"{path}: its content is not what its checksum says: it is damaged; save or copy it again")


def write_netcdf(path: Path, variables: Variables, attributes: Mapping[str, str | int]) -> None:
    """Write a file.

    Args:
        path: where to.
        variables: dimensions, values and attributes of each. Those that are named as their dimension are its
            coordinates, and come first; a dimension of length zero is written as unlimited, as NetCDF has it.
        attributes: of the file.

    HDF5 makes it in memory: of a disk that fills while it writes a file it ends the process.

    Raises:
        OSError: where it cannot be written.
    """
    import h5py

    coordinates = [name for name, (dimensions, _, _) in variables.items() if dimensions == (name,)]
    numbers = {name: np.array(number, np.int32) for number, name in enumerate(coordinates)}
    with h5py.File(path.name, "w", driver="core", backing_store=False, track_order=True) as file:
        text = f"version=2,hdf5={h5py.version.hdf5_version},h5py={h5py.__version__}"
        file.attrs["_NCProperties"] = np.bytes_(text)
        made = {}
        for name, (_, values, _) in variables.items():
            data = np.asarray(values)
            kind = h5py.string_dtype() if isinstance(values, tuple) else np.dtype(float)
            # Contiguous storage, but for what has a dimension without end.
            most = None if all(data.shape) else tuple(size or None for size in data.shape)
            made[name] = file.create_dataset(name, data=data.astype(kind), track_order=True, maxshape=most)
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
        file.flush()
        content = file.id.get_file_image()
    with open(path, "wb") as out:
        out.write(content)
        out.write(SEAL + hashlib.sha256(content).hexdigest().encode())
