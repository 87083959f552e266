"""Linear models in other programs: files for MATLAB, systems of python-control."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.io

import tensegrity_mj as tmj
from tensegrity_mj.basics import dependencies
from tensegrity_mj.cli import main
from tensegrity_mj.errors import MissingPackageError
from tensegrity_mj.linearization import Linearization


@pytest.fixture(scope="module")
def model() -> Linearization:
    """Two masses on a line between two pins: ω² = k/m and 3 k/m along it, strings of 1 m stretched to 1.5 m."""
    nodes = {"a": (0.0, 0.0, 0.0), "m.1": (1.5, 0.0, 0.0), "m2": (3.0, 0.0, 0.0), "b": (4.5, 0.0, 0.0)}
    ends = [("a", "m.1"), ("m.1", "m2"), ("m2", "b")]
    strings = [tmj.String(f"s{k + 1}", pair, 8.0, 1.0) for k, pair in enumerate(ends)]
    masses = [tmj.PointMass("m.1", 2.0), tmj.PointMass("m2", 2.0)]
    line = tmj.Structure("line", nodes, strings=strings, fixed_nodes=("a", "b"), point_masses=masses)
    return tmj.linearize(tmj.Scene(line), tmj.DAE())


def test_a_mat_file_has_the_arrays_and_names(model: Linearization, tmp_path: Path) -> None:
    read = scipy.io.loadmat(model.save(tmp_path / "model.mat"), simplify_cells=True)
    for name in ("A", "B", "C", "residual", "frequencies", "velocities", "eigenvalues"):
        assert np.array_equal(read[name], getattr(model, name)), name
    assert read["coordinates"].tolist() == list(model.coordinates)
    assert (read["scene"], read["inputs"], read["equilibrium"]) == ("line", "rest length", 1)
    with np.load(model.save(tmp_path / "model.npz")) as arrays:
        assert set(arrays) == {name for name in read if not name.startswith("__")}
    again = replace(model, gain=np.ones((3, 12)))
    assert scipy.io.loadmat(again.save(tmp_path / "gain.mat"))["gain"].shape == (3, 12)


def test_a_system_of_python_control_is_the_model(model: Linearization) -> None:
    system = model.to_control()
    assert isinstance(system, control.StateSpace)
    assert system.input_labels == ["s1", "s2", "s3"]
    assert system.output_labels[3:6] == ["m_1_x", "m_1_y", "m_1_z"]
    names = [name.replace("m.1", "m_1") for name in model.coordinates]
    assert system.state_labels == [*names, *(f"{name} rate" for name in names)]
    # Of three equal springs in a row the first one's rest length grows by d: each is then stretched by d/3 less.
    gain = system.dcgain()
    rows = [system.output_labels.index(name) for name in ("m_1_x", "m2_x")]
    # Round-off of the inverse of A, whose condition is that of ω² from (8/2)(0.5/1.5) across to 3·8/2: below 100.
    assert np.allclose(gain[rows, 0], [2 / 3, 1 / 3], rtol=0, atol=100 * np.finfo(float).eps * len(model.A))


def test_a_state_that_is_no_equilibrium_warns(model: Linearization) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.to_control()
    with pytest.warns(UserWarning, match=r"no equilibrium, .*model\.residual is not in it"):
        replace(model, residual=np.ones(12)).to_control()


def test_names_that_become_the_same_stay_apart(model: Linearization) -> None:
    twice = replace(model, coordinates=("a.b", "a_b", "c", "d", "e", "f"))
    assert len(set(twice.to_control().state_labels)) == 12


def test_without_python_control_the_command_is_named(model: Linearization, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(f"No module named '{name}'")

    monkeypatch.setattr(dependencies, "import_module", absent)
    with pytest.raises(MissingPackageError, match=r"to_control\(\) needs control, .*python -m pip install control"):
        model.to_control()


def test_the_command_writes_for_matlab(tmp_path: Path) -> None:
    out = tmp_path / "rod.mat"
    assert main(["linearize", "pinned_rod", "--out", str(out)]) == 0
    scene = tmj.load_scene("pinned_rod")
    assert np.array_equal(scipy.io.loadmat(out)["A"], tmj.linearize(scene).A)
