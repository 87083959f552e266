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

LABELS = {"node": ("n1", "λ 2"), "axis": ("x", "y", "z"), "string": tuple(f"s{k}" for k in range(5))}
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
    labels = LABELS | ({empty: ()} if empty in LABELS else {})
    sizes = {"time": 0 if empty == "time" else 4, **{name: len(words) for name, words in labels.items()}}
    rng = np.random.default_rng(5)
    values = {name: rng.normal(size=[sizes[one] for one in dims]) for name, dims in VARIABLES.items()}
    facts = {name: {"units": "m", "long_name": f"λ of {name}"} for name in (*VARIABLES, *LABELS)}
    attributes: dict[str, str | int] = {"format": 2, "scene": "[structure]\nname = 'ß'\n", "message": ""}
    all_of_it: dict[str, Any] = {
        "time": (("time",), values["time"], facts["time"]),
        **{name: ((name,), words, facts[name]) for name, words in labels.items()},
        **{name: (VARIABLES[name], values[name], facts[name]) for name in VARIABLES if name != "time"},
    }
    ours, theirs = tmp_path / "ours.nc", tmp_path / "theirs.nc"
    write_netcdf(ours, all_of_it, attributes)
    with h5netcdf.File(theirs, "w") as file:
        file.dimensions = sizes
        for name, (dimensions, content, _) in all_of_it.items():
            variable = file.create_variable(name, dimensions, h5py.string_dtype() if name in LABELS else float)
            if len(content) and np.size(content):
                variable[...] = np.array(content, object) if name in LABELS else content
            variable.attrs.update(facts[name])
        file.attrs.update(attributes)
    found, expected = described(ours), described(theirs)
    for name in expected:
        if empty and name in all_of_it:  # h5netcdf has chunks of its own choice for what has no length yet
            found[name] = (found[name][0][:3], *found[name][1:])
            expected[name] = (expected[name][0][:3], *expected[name][1:])
        assert found[name] == expected[name], name
    assert list(found) == list(expected)  # in this order
    with xarray.open_dataset(ours, engine="h5netcdf") as data:
        for name, (dimensions, content, _) in all_of_it.items():
            assert list(data[name].values.ravel()) == list(np.ravel(np.array(content, object)))
            assert data[name].dims == dimensions
