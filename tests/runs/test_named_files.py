"""Files of runs have names along their dimensions, which xarray selects by, and attributes of the CF conventions."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest
import xarray
from maxwell import Maxwell

import tensegrity_mj as tmj
from tensegrity_mj.basics import fields
from tensegrity_mj.controllers import from_scene
from tensegrity_mj.errors import FormatError
from tensegrity_mj.runs.recorded import VARIABLES

OLD = Path(__file__).parents[1] / "data" / "runs" / "without_coordinates.nc"


def test_xarray_selects_by_names(prism_run: tmj.Trajectory, tmp_path: Path) -> None:
    structure = prism_run.scene.structure
    with xarray.open_dataset(prism_run.save(tmp_path / "run.nc"), engine="h5netcdf") as data:
        for number, string in enumerate(structure.strings):
            assert np.array_equal(data.tensions.sel(string=string.name), prism_run.tensions[:, number])
        for number, rod in enumerate(structure.rods):
            assert np.array_equal(data.multipliers.sel(rod=rod.name), prism_run.multipliers[:, number])
        for number, node in enumerate(structure.node_names):
            assert np.array_equal(data.nodes.sel(node=node, axis="z"), prism_run.nodes[:, number, 2])
        assert data.nodes.sel(time=0.05, method="nearest").sel(node="n1").shape == (3,)


def test_attributes_are_those_of_cf_and_depend_on_no_clock(prism_run: tmj.Trajectory, tmp_path: Path) -> None:
    first = prism_run.save(tmp_path / "a.nc").read_bytes()
    time.sleep(1.1)  # a date that HDF5 or an attribute held would have changed by its second
    path = prism_run.save(tmp_path / "b.nc")
    assert path.read_bytes() == first
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        assert data.attrs["Conventions"] == "CF-1.11"
        version = prism_run.provenance["versions"]["tensegrity-mj"]
        assert data.attrs["source"] == f"tensegrity-mj {version}: {prism_run.engine}"
        assert "simulate scene prism, law lyapunov" in data.attrs["history"]
        assert data.attrs["references"] == prism_run.scene.source
        for name in data.variables:
            assert data[name].attrs["long_name"]
        noted = {name for name in VARIABLES if "unit_note" in data[name].attrs}
        assert noted == {name for name, (_, unit, _) in VARIABLES.items() if "law defines" in unit} != set()
        # What udunits2's grammar has for the units that are left: symbols, powers, one slash.
        units = {data[name].attrs["units"] for name in VARIABLES if name not in noted}
        assert all(re.fullmatch(r"(m|s|N|J|1)(/(m|s2|s))?", unit) for unit in units)


def test_states_of_elements_have_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fields, "_KINDS", fields._KINDS | {"maxwell": Maxwell})
    mass = tmj.Structure("mass", {"n": (0.0, 0.0, 0.0)}, point_masses=(tmj.PointMass("n", 1.0),))
    run = tmj.simulate(tmj.Scene(mass, elements=(Maxwell("n", 10.0, 1.0),)), None, tmj.DAE(), duration=0.1)
    path = run.save(tmp_path / "run.nc")
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        assert tuple(data.element_state.values) == run.element_state_names != ()
        assert data.element_states.attrs["unit_note"] == "as the elements define"
    assert np.array_equal(tmj.Trajectory.load(path).element_states, run.element_states)


def test_a_file_from_before_names_loads() -> None:
    with xarray.open_dataset(OLD, engine="h5netcdf") as data:
        assert set(data.coords) == {"time"}
    run = tmj.Trajectory.load(OLD)
    assert np.array_equal(run.time, [0.0, 0.01, 0.02, 0.03])
    again = tmj.simulate(run.scene, from_scene(run.scene), tmj.MuJoCo(1e-2), duration=0.03)
    # Round-off of another processor or library: of coordinates of 1 m, 12 evaluations.
    assert np.allclose(run.nodes, again.nodes, rtol=0, atol=1e-14)


def test_a_file_that_xarray_wrote_again_loads(prism_run: tmj.Trajectory, tmp_path: Path) -> None:
    with xarray.open_dataset(prism_run.save(tmp_path / "run.nc"), engine="h5netcdf") as data:
        data.sel(time=slice(0.0, 0.05)).to_netcdf(tmp_path / "part.nc", engine="h5netcdf")
    part = tmj.Trajectory.load(tmp_path / "part.nc")
    assert np.array_equal(part.nodes, prism_run.nodes[:6])
    assert part.scene == prism_run.scene


def test_a_file_whose_members_were_put_in_another_order_is_refused(prism_run: tmj.Trajectory, tmp_path: Path) -> None:
    """Its arrays would be read in the scene's order, which they no longer have."""
    with xarray.open_dataset(prism_run.save(tmp_path / "run.nc"), engine="h5netcdf") as data:
        data.sortby("string", ascending=False).to_netcdf(tmp_path / "turned.nc", engine="h5netcdf")
    with pytest.raises(FormatError, match=r"turned\.nc: string 0 .* is 's9', in its scene it is 's1': .*another order"):
        tmj.Trajectory.load(tmp_path / "turned.nc")
