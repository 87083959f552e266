"""Files written straight through HDF5 are what h5netcdf would have written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray

from tensegrity_mj.runs.netcdf import write_netcdf

SIZES = {"time": 4, "node": 2, "axis": 3, "string": 5}
VARIABLES = {"time": ("time",), "nodes": ("time", "node", "axis"), "energy": ("time",), "tension": ("time", "string")}


def described(path: Path) -> dict[str, Any]:
    """All that NetCDF sees of an HDF5 file, apart from the values of variables: those are compared besides."""
    found: dict[str, Any] = {}
    with h5py.File(path) as file:
        plist = file.id.get_create_plist()
        found["/"] = plist.get_link_creation_order(), plist.get_attr_creation_order()
        for name, data in file.items():
            attributes = {key: str(value) for key, value in data.attrs.items()}
            places = data.shape, data.maxshape, data.dtype, data.chunks
            found[name] = places, data.is_scale, data.id.get_create_plist().get_attr_creation_order(), attributes
            found[f"{name} along"] = [[scale.name for scale in axis.values()] for axis in data.dims]
        found["attributes"] = {key: str(value) for key, value in file.attrs.items() if key != "_NCProperties"}
    return found


@pytest.mark.parametrize("empty", [None, "string", "time"])
def test_the_file_is_the_one_that_h5netcdf_writes(tmp_path: Path, empty: str | None) -> None:
    sizes = SIZES | ({empty: 0} if empty else {})
    rng = np.random.default_rng(5)
    values = {name: rng.normal(size=[sizes[one] for one in dims]) for name, dims in VARIABLES.items()}
    told = {name: {"units": "m", "long_name": f"λ of {name}"} for name in VARIABLES}
    attributes: dict[str, str | int] = {"format": 2, "scene": "[structure]\nname = 'ß'\n", "message": ""}
    ours, theirs = tmp_path / "ours.nc", tmp_path / "theirs.nc"
    write_netcdf(ours, sizes, {name: (VARIABLES[name], values[name], told[name]) for name in VARIABLES}, attributes)
    with h5netcdf.File(theirs, "w") as file:
        file.dimensions = sizes
        for name, dimensions in VARIABLES.items():
            variable = file.create_variable(name, dimensions, float)
            if values[name].size:
                variable[...] = values[name]
            variable.attrs.update(told[name])
        file.attrs.update(attributes)
    found, expected = described(ours), described(theirs)
    for name in expected:
        if empty and name in VARIABLES:  # h5netcdf has chunks of its own choice for what has no length yet
            found[name] = (found[name][0][:3], *found[name][1:])
            expected[name] = (expected[name][0][:3], *expected[name][1:])
        assert found[name] == expected[name], name
    assert list(found) == list(expected)  # in this order
    with xarray.open_dataset(ours, engine="h5netcdf") as data:
        for name, value in values.items():
            assert np.array_equal(data[name].values, value)
            assert data[name].dims == VARIABLES[name]
