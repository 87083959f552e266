"""Files of trajectories: lossless, atomic, readable by xarray; comparisons of them."""

from __future__ import annotations

import numpy as np
import pytest
import xarray
from random_structures import random_scene, random_structure

import tensegrity_mj as tmj
from tensegrity_mj.controllers import from_scene
from tensegrity_mj.trajectory import VARIABLES


@pytest.fixture(scope="module")
def run():
    scene = tmj.load_scene("prism")
    return tmj.simulate(scene, from_scene(scene), tmj.MuJoCo(1e-2), duration=0.5)


def test_a_saved_run_loads_unchanged(run, tmp_path):
    loaded = tmj.Trajectory.load(run.save(tmp_path / "run.nc"))
    for name in VARIABLES:
        assert np.array_equal(getattr(loaded, name), getattr(run, name), equal_nan=True), name
    assert loaded.scene == run.scene
    for name in ("status", "message", "engine", "cost", "reports", "provenance"):
        assert getattr(loaded, name) == getattr(run, name), name


def test_runs_without_rods_or_strings_are_saved_too(tmp_path):
    masses = tmj.Structure("mass", {"n": (0.0, 0.0, 0.0)}, point_masses=(tmj.PointMass("n", 1.0),))
    fall = tmj.simulate(tmj.Scene(masses, gravity=(0, 0, -9.81), duration=1.0), None, tmj.DAE())
    loaded = tmj.Trajectory.load(fall.save(tmp_path / "fall.nc"))
    assert loaded.nodes[-1, 0, 2] == pytest.approx(-9.81 / 2, rel=1e-12)
    rng = np.random.default_rng(0)
    bare = tmj.simulate(random_scene(rng, random_structure(rng, rods=1, strings=0, fixed_nodes=0), duration=0.1))
    assert tmj.Trajectory.load(bare.save(tmp_path / "bare.nc")).tensions.shape == (len(bare.time), 0)


def test_xarray_reads_names_units_and_numbers(run, tmp_path):
    with xarray.open_dataset(run.save(tmp_path / "run.nc"), engine="h5netcdf") as data:
        assert data.nodes.dims == ("time", "node", "axis")
        assert data.tensions.attrs["units"] == "N"
        assert np.array_equal(data.nodes.values, run.nodes)
        assert data.attrs["status"] == "completed"
        assert "prism" in data.attrs["scene"]


def test_a_failed_save_leaves_the_old_file(run, tmp_path, monkeypatch):
    path = run.save(tmp_path / "run.nc")
    before = path.read_bytes()
    monkeypatch.setattr("tensegrity_mj.trajectory.json.dumps", lambda value: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("content", [None, b"", b"not a file of that kind"])
def test_files_that_are_no_trajectories_are_refused(content, tmp_path):
    path = tmp_path / "x.nc"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(tmj.FormatError, match=r"x\.nc"):
        tmj.Trajectory.load(path)


def test_a_netcdf_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "other.nc"
    xarray.Dataset({"a": ("x", [1.0, 2.0])}).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(tmj.FormatError, match="no trajectory"):
        tmj.Trajectory.load(path)


def test_a_run_differs_from_itself_by_nothing_and_from_another_by_what_was_added(run):
    same = tmj.compare(run, run)
    assert same.max_node_error == same.max_energy_error == same.rms_node_error == 0
    assert set(same.first_exceeded.values()) == {None}
    from dataclasses import replace

    nodes = run.nodes.copy()
    nodes[20:, 3] += (0.0, 3e-3, 4e-3)
    other = tmj.compare(replace(run, nodes=nodes), run, tolerance=1e-3)
    assert other.max_node_error == pytest.approx(5e-3, rel=1e-12)
    assert other.first_exceeded["node_error"] == run.time[20]
    assert other.rms_node_error == pytest.approx(5e-3 * np.sqrt(31 / 51 / 6), rel=1e-12)


def test_only_common_times_are_compared_and_none_is_made_up(run):
    scene = run.scene
    coarse = tmj.simulate(scene, from_scene(scene), tmj.MuJoCo(1e-2), duration=0.5, output_interval=0.05)
    assert np.array_equal(tmj.compare(run, coarse).time, coarse.time)
    assert tmj.compare(run, coarse).max_node_error == 0
    odd = tmj.simulate(scene, from_scene(scene), tmj.MuJoCo(7e-3), duration=0.49, output_interval=0.245)
    with pytest.raises(tmj.OptionError, match="output_interval"):
        tmj.compare(odd.until(2), coarse.until(2).__class__(**{**vars(coarse), "time": coarse.time + 1e-3}))


def test_runs_of_different_structures_are_not_compared(run):
    scene = tmj.load_scene("pinned_rod")
    other = tmj.simulate(scene, from_scene(scene), tmj.MuJoCo(1e-2), duration=0.5)
    with pytest.raises(tmj.OptionError, match="different nodes"):
        tmj.compare(run, other)


def test_the_same_command_gives_the_same_numbers(run):
    again = tmj.simulate(run.scene, from_scene(run.scene), tmj.MuJoCo(1e-2), duration=0.5)
    assert np.array_equal(again.nodes, run.nodes)
