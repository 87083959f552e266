"""Files of trajectories: lossless, atomic, readable by xarray; comparisons of them."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
import xarray

import tensegrity_mj as tmj
from evidence.random_structures import random_scene, random_structure
from tensegrity_mj.basics.jsontext import from_exact_json, to_exact_json
from tensegrity_mj.controllers import from_scene
from tensegrity_mj.runs.recorded import VARIABLES


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
    monkeypatch.setattr("tensegrity_mj.runs.stored.to_exact_json", lambda value: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_run_without_samples_is_safe_everywhere(run, tmp_path):
    empty = run.until(0)
    assert empty.energy_balance.shape == empty.target_error().shape == (0,)
    assert empty.energy_residual == empty.max_force_density == 0
    assert math.isnan(empty.min_feasibility_margin)
    loaded = tmj.Trajectory.load(empty.save(tmp_path / "empty.nc"))
    for name in VARIABLES:
        assert getattr(loaded, name).shape == getattr(empty, name).shape, name
    for pair in ((empty, run), (run, empty), (empty, empty)):
        with pytest.raises(tmj.errors.OptionError, match="share 0 output times"):
            tmj.compare(*pair)


def test_json_of_a_run_is_strict_and_lossless(run, tmp_path):
    reports = {"residual": math.nan, "largest": [math.inf, -math.inf, 0.1 + 0.2], "none": None, "text": "NaN"}
    path = replace(run, reports=reports).save(tmp_path / "run.nc")
    with h5netcdf.File(path) as file:
        json.loads(file.attrs["reports"], parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    again = tmj.Trajectory.load(path).reports
    assert math.isnan(again.pop("residual"))
    assert again == {key: value for key, value in reports.items() if key != "residual"}


def test_what_laws_and_engines_report_survives_json(run):
    scene = run.scene
    runs = [
        run,
        tmj.simulate(scene, from_scene(scene), tmj.DAE(), duration=0.02),
        tmj.simulate(scene, None, tmj.MuJoCo(1e-2), duration=0.02),
        tmj.simulate(
            scene,
            from_scene(scene, norm=math.inf),
            tmj.MuJoCo(1e-2),
            duration=0.02,
            actuation=tmj.Actuation.hold_rest_length(1e-2),
        ),
    ]
    for each in runs:
        for kept in (each.cost, each.reports, each.provenance):
            assert from_exact_json(to_exact_json(kept)) == kept


def test_places_where_no_file_can_be_written_are_refused(run, tmp_path):
    (tmp_path / "folder.nc").mkdir()
    os.mkfifo(tmp_path / "pipe.nc")
    (tmp_path / "circle.nc").symlink_to(tmp_path / "circle.nc")
    for path, complaint in (
        (tmp_path / "missing" / "x.nc", "there is no folder"),
        (tmp_path / "folder.nc", "that is a folder"),
        (tmp_path / "pipe.nc", "no regular file"),
        (tmp_path / "circle.nc", "no file can be written there"),
        (tmp_path / ("x" * 300 + ".nc"), "no file can be written there"),
        (tmp_path / "x.txt", r"must end in \.nc"),
        (None, "no path"),
    ):
        with pytest.raises(tmj.errors.OptionError, match=complaint):
            run.save(path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["circle.nc", "folder.nc", "pipe.nc"]


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that takes no new files")
def test_a_file_system_that_takes_no_files_is_refused(run):
    with pytest.raises(tmj.errors.OptionError, match=r"/proc/x\.nc: "):
        run.save("/proc/x.nc")


def test_a_disk_that_is_full_leaves_the_old_file(run, tmp_path, monkeypatch):
    path = run.save(tmp_path / "run.nc")
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(tmj.errors.FormatError, match=r"run\.nc: cannot be written \(No space left on device\)"):
        run.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_save_through_a_link_keeps_the_link(run, tmp_path):
    real, link = tmp_path / "real.nc", tmp_path / "link.nc"
    link.symlink_to(real)
    run.save(link)
    assert link.is_symlink()
    assert len(tmj.Trajectory.load(real).time) == len(run.time)


def test_loading_says_what_is_no_file(tmp_path):
    for path, complaint in ((None, "no path"), (tmp_path, "that is a folder"), (tmp_path / "x.nc", "no such file")):
        with pytest.raises(tmj.errors.FormatError, match=complaint):
            tmj.Trajectory.load(path)


@pytest.mark.parametrize(
    ("attribute", "value", "complaint"),
    [
        ("status", "weird", "'weird'"),
        ("reports", "[]", "reports is a list"),
        ("cost", "{", "not a readable trajectory"),
        ("scene", "format = 1", "'structure' is missing"),
        # The pinned rod has other numbers of nodes, strings and rods than the arrays in the file.
        ("scene", None, r"nodes has shape \(51, 6, 3\)"),
    ],
)
def test_a_trajectory_with_a_wrong_attribute_is_refused(attribute, value, complaint, run, tmp_path):
    from tensegrity_mj.model.text.writing import scene_to_toml

    path = run.save(tmp_path / "run.nc")
    with h5netcdf.File(path, "a") as file:
        file.attrs[attribute] = scene_to_toml(tmj.load_scene("pinned_rod")) if value is None else value
    with pytest.raises(tmj.errors.FormatError, match=rf"run\.nc: .*{complaint}"):
        tmj.Trajectory.load(path)


def changed_file(run, path, name, place, value):
    """A saved run with one number replaced."""
    run.save(path)
    with h5netcdf.File(path, "a") as file:
        values = np.array(file.variables[name][...])
        values[place] = value
        file.variables[name][...] = values
    return path


@pytest.mark.parametrize(
    ("name", "place", "value", "complaint"),
    [
        ("nodes", (7, 2, 1), math.nan, r"nodes is nan m at time 7, node 2, axis 1 .*must be finite"),
        ("tensions", (0, 3), math.inf, r"tensions is inf N at time 0, string 3"),
        ("kinetic_energy", 50, -math.inf, r"kinetic_energy is -inf J at time 50"),
        ("time", 4, math.nan, "time is nan s at time 4"),
        ("time", 5, 0.02, r"time 5 .* is 0\.02 s after 0\.04 s; times must rise"),
        ("time", 5, 0.04, r"time 5 .* is 0\.04 s after 0\.04 s; times must rise"),
    ],
)
def test_a_trajectory_whose_numbers_are_none_or_run_backwards_is_refused(name, place, value, complaint, run, tmp_path):
    from tensegrity_mj.cli import main

    good, bad = run.save(tmp_path / "good.nc"), changed_file(run, tmp_path / "bad.nc", name, place, value)
    with pytest.raises(tmj.errors.FormatError, match=rf"bad\.nc: {complaint}"):
        tmj.Trajectory.load(bad)
    assert main(["compare", str(good), str(run.save(tmp_path / "same.nc"))]) == 0
    for files in ((good, bad), (bad, good), (bad, bad)):
        assert main(["compare", *map(str, files)]) == 2


def test_what_a_law_does_not_report_stays_nan_in_a_file(run, tmp_path):
    quiet = replace(run, lyapunov=np.full_like(run.lyapunov, np.nan))
    assert np.isnan(tmj.Trajectory.load(quiet.save(tmp_path / "quiet.nc")).lyapunov).all()


def test_a_saved_run_says_how_it_ended_and_what_its_arrays_are(run, tmp_path):
    """Read without this package: the message of a run that stopped, and a unit and a meaning of every array."""
    stopped = replace(run, status=tmj.Status.INFEASIBLE, message="no admissible solution at t = 0.5 s")
    path = stopped.save(tmp_path / "stopped.nc")
    with h5netcdf.File(path) as file:
        assert (file.attrs["status"], file.attrs["message"]) == ("infeasible", "no admissible solution at t = 0.5 s")
        for name, (_, unit, meaning) in VARIABLES.items():
            attributes = dict(file.variables[name].attrs)
            assert (attributes.get("units") or attributes["unit_note"], attributes["long_name"]) == (unit, meaning)
            assert ("units" in attributes) == ("law" not in unit)  # a unit is one of udunits, or there is none
    assert tmj.Trajectory.load(path).message == "no admissible solution at t = 0.5 s"


@pytest.mark.parametrize("content", [None, b"", b"not a file of that kind"])
def test_files_that_are_no_trajectories_are_refused(content, tmp_path):
    path = tmp_path / "x.nc"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(tmj.errors.FormatError, match=r"x\.nc"):
        tmj.Trajectory.load(path)


def test_a_netcdf_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "other.nc"
    xarray.Dataset({"a": ("x", [1.0, 2.0])}).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(tmj.errors.FormatError, match="no trajectory"):
        tmj.Trajectory.load(path)


def test_a_run_differs_from_itself_by_nothing_and_from_another_by_what_was_added(run):
    same = tmj.compare(run, run, 1e-6)
    assert same.max_node_error == same.max_energy_error == same.rms_node_error == 0
    assert set(same.first_exceeded.values()) == {None}
    nodes = run.nodes.copy()
    nodes[20:, 3] += (0.0, 3e-3, 4e-3)
    other = tmj.compare(replace(run, nodes=nodes), run, tolerance=1e-3)
    assert other.max_node_error == pytest.approx(5e-3, rel=1e-12)
    assert other.first_exceeded["node_error"] == run.time[20]
    assert other.rms_node_error == pytest.approx(5e-3 * np.sqrt(31 / 51 / 6), rel=1e-12)


def test_nan_exceeds_every_tolerance(run):
    tensions = run.tensions.copy()
    tensions[7, 2] = np.nan
    broken = tmj.compare(replace(run, tensions=tensions), run, tolerance=1e30)
    assert broken.first_exceeded["tension_error"] == run.time[7]
    assert broken.first_exceeded["node_error"] is None
    assert math.isnan(broken.max_tension_error)
    assert broken.max_node_error == 0


def test_every_difference_has_its_documented_maximum(run):
    same = tmj.compare(run, run)
    for name in same.NAMES:
        assert getattr(same, f"max_{name}") == 0
        assert "[" in getattr(tmj.runs.Comparison, f"max_{name}").__doc__  # its unit


@pytest.mark.parametrize("other", [None, "run.nc"])
def test_only_runs_are_compared(other, run):
    for pair in ((run, other), (other, run)):
        with pytest.raises(tmj.errors.OptionError, match="must be a Trajectory"):
            tmj.compare(*pair)


def test_only_common_times_are_compared_and_none_is_made_up(run):
    scene = run.scene
    coarse = tmj.simulate(scene, from_scene(scene), tmj.MuJoCo(1e-2), duration=0.5, output_interval=0.05)
    assert np.array_equal(tmj.compare(run, coarse).time, coarse.time)
    assert tmj.compare(run, coarse).max_node_error == 0
    odd = tmj.simulate(scene, from_scene(scene), tmj.MuJoCo(7e-3), duration=0.49, output_interval=0.245)
    with pytest.raises(tmj.errors.OptionError, match="output_interval"):
        tmj.compare(odd.until(2), coarse.until(2).__class__(**{**vars(coarse), "time": coarse.time + 1e-3}))


def test_times_that_differ_by_more_than_round_off_are_not_common(run):
    """Samples each 10 ms: what is 3 ms, or 1 µs, apart is another time; 1e-12 s is the round-off of a sum of steps."""
    for shift in (3e-3, -3e-3, 1e-6, -1e-6):
        with pytest.raises(tmj.errors.OptionError, match="share 0 output times"):
            tmj.compare(run, replace(run, time=run.time + shift))
    assert len(tmj.compare(run, replace(run, time=run.time + 1e-12)).time) == len(run.time)
    # One sample moved: all others are still compared, that one is not.
    time = run.time.copy()
    time[20] += 3e-3
    assert np.array_equal(tmj.compare(run, replace(run, time=time)).time, np.delete(run.time, 20))


def test_a_difference_of_rod_forces_is_that_of_force_densities_times_the_length():
    """0.01 N/m more is 0.01 ℓ N more, of rods that are not 1 m long."""
    scene = random_scene(np.random.default_rng(1), random_structure(np.random.default_rng(1), rods=3), duration=0.5)
    run = tmj.simulate(scene, None, tmj.MuJoCo(1e-2))
    lengths = run.scene.structure.rod_lengths
    assert np.all(np.abs(lengths - 1) > 1e-3)
    for rod, length in enumerate(lengths):
        densities = run.rod_force_densities.copy()
        densities[30, rod] += 0.01
        other = tmj.compare(replace(run, rod_force_densities=densities), run, tolerance=1e-9)
        # Relative round-off of densities near 1 N/m in a difference of 0.01 N/m.
        assert other.max_rod_force_error == pytest.approx(0.01 * length, rel=1e-12)
        assert other.first_exceeded["rod_force_error"] == run.time[30]


def test_runs_of_different_structures_are_not_compared(run):
    scene = tmj.load_scene("pinned_rod")
    other = tmj.simulate(scene, from_scene(scene), tmj.MuJoCo(1e-2), duration=0.5)
    with pytest.raises(tmj.errors.OptionError, match="different nodes"):
        tmj.compare(run, other)


def test_the_same_command_gives_the_same_numbers(run):
    again = tmj.simulate(run.scene, from_scene(run.scene), tmj.MuJoCo(1e-2), duration=0.5)
    assert np.array_equal(again.nodes, run.nodes)
