"""Runs as tables of other programs: numbers by name, xarray, pandas, CSV and MATLAB, each exactly what was recorded."""

from __future__ import annotations

import csv
import re
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import xarray

import tensegrity_mj as tmj
from tensegrity_mj.basics import dependencies
from tensegrity_mj.basics.matfile import KEYWORDS, legal_names
from tensegrity_mj.cli import main
from tensegrity_mj.errors import MissingPackageError, OptionError
from tensegrity_mj.runs.recorded import VARIABLES
from tensegrity_mj.runs.stored import columns_of


def test_members_are_found_by_their_names(prism_run: tmj.Trajectory) -> None:
    structure = prism_run.scene.structure
    for number, node in enumerate(structure.node_names):
        assert np.array_equal(prism_run.position(node), prism_run.nodes[:, number])
        assert np.array_equal(prism_run.velocity(node), prism_run.velocities[:, number])
    for number, string in enumerate(structure.strings):
        assert np.array_equal(prism_run.tension(string.name), prism_run.tensions[:, number])
        assert np.array_equal(prism_run.rest_length(string.name), prism_run.rest_lengths[:, number])
    for number, rod in enumerate(structure.rods):
        force = prism_run.rod_force_densities[:, number] * structure.rod_lengths[number]
        assert np.array_equal(prism_run.rod_force(rod.name), force)


@pytest.mark.parametrize(
    ("call", "name", "message"),
    [
        ("tension", "s33", r"the run of 'prism': there is no string 's33' \(did you mean 's3'\?\); allowed: s1, s2"),
        ("position", "N1", r"there is no node 'N1' \(did you mean 'n1'\?\); allowed: O, n1"),
        ("rod_force", 1, r"there is no rod '1'"),
    ],
)
def test_a_name_that_is_none_is_refused_with_the_likely_one(
    call: str, name: str, message: str, prism_run: tmj.Trajectory
) -> None:
    with pytest.raises(OptionError, match=message):
        getattr(prism_run, call)(name)


def test_xarray_has_what_it_reads_from_the_file(prism_run: tmj.Trajectory, tmp_path: Path) -> None:
    with xarray.open_dataset(prism_run.save(tmp_path / "run.nc"), engine="h5netcdf") as data:
        xarray.testing.assert_identical(prism_run.to_xarray(), data.load())


def test_a_data_frame_has_all_that_was_recorded(prism_run: tmj.Trajectory) -> None:
    frame = prism_run.to_dataframe()
    assert frame.index.name == "time"
    assert np.array_equal(frame.index, prism_run.time)
    assert np.array_equal(frame[["n1.x", "n1.y", "n1.z"]], prism_run.position("n1"))
    assert np.array_equal(frame["n1.vz"], prism_run.velocity("n1")[:, 2])
    assert np.array_equal(frame["s3.tension"], prism_run.tension("s3"))
    assert np.array_equal(frame["kinetic_energy"], prism_run.kinetic_energy)
    numbers = sum(getattr(prism_run, name)[0].size for name in VARIABLES)
    assert frame.shape == (len(prism_run.time), numbers - 1)
    assert frame.columns.is_unique


def test_a_csv_file_holds_every_number_exactly(prism_run: tmj.Trajectory, tmp_path: Path) -> None:
    names, values = columns_of(prism_run)
    with prism_run.save(tmp_path / "run.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == names
    assert np.array_equal(np.array(rows, float), values, equal_nan=True)


def test_a_mat_file_holds_every_number_exactly_below_legal_names(prism_run: tmj.Trajectory, tmp_path: Path) -> None:
    first = prism_run.save(tmp_path / "a.mat").read_bytes()
    time.sleep(1.1)  # a date in it would have changed
    path = prism_run.save(tmp_path / "b.mat")
    assert path.read_bytes() == first
    read = scipy.io.loadmat(path, simplify_cells=True)
    for name, (_, unit, _) in VARIABLES.items():
        assert np.array_equal(read[name], getattr(prism_run, name), equal_nan=True), name
        assert read["units"][name] == unit
    for number, string in enumerate(prism_run.scene.structure.strings):
        assert read["string_names"][number] == string.name
        assert read["string_number"][string.name] == number + 1
    assert read["about"]["engine"] == prism_run.engine
    plain = scipy.io.loadmat(path)
    assert plain["time"].shape == (len(prism_run.time), 1)
    assert plain["string_names"].dtype == object  # a cell array
    assert all(re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,62}", name) for name in plain if not name.startswith("__"))


def test_a_mat_file_of_a_run_without_strings_is_written(tmp_path: Path) -> None:
    mass = tmj.Structure("mass", {"n 1": (0.0, 0.0, 0.0)}, point_masses=(tmj.PointMass("n 1", 1.0),))
    prism_run = tmj.simulate(tmj.Scene(mass, gravity=(0, 0, -9.81)), None, tmj.DAE(), duration=0.1)
    path = prism_run.save(tmp_path / "run.mat")
    assert scipy.io.loadmat(path, simplify_cells=True)["node_number"] == {"n_1": 1}
    assert scipy.io.loadmat(path)["tensions"].shape == (len(prism_run.time), 0)
    names, values = columns_of(prism_run.until(0))
    assert values.shape == (0, len(names))


def test_names_become_legal_and_stay_apart() -> None:
    names = ("s1", "s 1", "s_1", "1", "λ", "end", "", "_a", "n" * 70, "n" * 71, "a.b", "a b")
    legal = legal_names(names)
    assert legal[:6] == ("s1", "s_1_1", "s_1", "x1", "x_", "xend")
    assert len(set(legal)) == len(names)
    assert all(re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,62}", name) and name not in KEYWORDS for name in legal)


@pytest.mark.parametrize(("call", "package"), [("to_xarray", "xarray"), ("to_dataframe", "pandas")])
def test_a_package_that_is_missing_is_named_with_the_command(
    call: str, package: str, prism_run: tmj.Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(f"No module named '{name}'")

    monkeypatch.setattr(dependencies, "import_module", absent)
    with pytest.raises(
        MissingPackageError, match=rf"run\.{call}\(\) needs {package}, .*python -m pip install {package}"
    ):
        getattr(prism_run, call)()


def test_the_command_exports_a_run_as_a_table_or_its_scene(
    prism_run: tmj.Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(prism_run.save(tmp_path / "run.nc"))
    for end in ("csv", "mat"):
        assert main(["export", file, "--out", str(tmp_path / f"by_command.{end}")]) == 0
        by_call = prism_run.save(tmp_path / f"by_call.{end}")
        assert (tmp_path / f"by_command.{end}").read_bytes() == by_call.read_bytes()
    assert main(["export", file, "--out", str(tmp_path / "scene.toml")]) == 0
    assert tmj.load_scene(tmp_path / "scene.toml") == prism_run.scene
    capsys.readouterr()
    assert main(["run", "pinned_rod", "--duration", "0.02", "--out", str(tmp_path / "run.csv")]) == 0
    assert (tmp_path / "run.csv").read_text().startswith("time,")
