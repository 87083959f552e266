"""Trajectory files from anyone: read, or refused with a message that names what is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import pytest
from extreme_scenes import extreme

from tensegrity_mj import DAE, simulate
from tensegrity_mj.cli import main
from tensegrity_mj.errors import FormatError
from tensegrity_mj.runs.recorded import VARIABLES
from tensegrity_mj.runs.trajectory import Trajectory


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.nc"
    return simulate(extreme(), None, DAE(), duration=0.02).save(path)


@pytest.mark.parametrize("name", ["time", "nodes", "kinetic_energy"])
def test_variables_that_no_memory_holds_are_refused_unread(name: str, run_file: Path, tmp_path: Path) -> None:
    """Declared and never written, a petabyte takes no room in a file."""
    path = tmp_path / "run.nc"
    path.write_bytes(run_file.read_bytes())
    with h5py.File(path, "a") as file:
        names = [name] if name != "time" else sorted(set(VARIABLES) - {"time"})
        for one in {*names, name}:
            shape = (10**14, *file[one].shape[1:])
            del file[one]
            file.create_dataset(one, shape, "f8", chunks=(1024, *shape[1:]))
    with pytest.raises(FormatError, match=r"has shape|bytes cannot hold: it is damaged|not a readable trajectory"):
        Trajectory.load(path)


def test_attributes_that_are_no_text_are_refused(run_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.nc"
    for name in ("message", "engine", "scene", "provenance"):
        path.write_bytes(run_file.read_bytes())
        with h5py.File(path, "a") as file:
            file.attrs[name] = b"\xff\xfe"
        with pytest.raises(FormatError, match="not a readable trajectory"):
            Trajectory.load(path)


@pytest.mark.parametrize(
    ("attribute", "words", "message"),
    [
        ("reports", {"accuracy": [1]}, "reports.accuracy is a list; it must be an object"),
        ("reports", {"accuracy": {"reason": "x"}}, "reports.accuracy.met is missing; it must be true or false"),
        ("reports", {"accuracy": {"met": False, "reason": 5}}, "reports.accuracy.reason is a int"),
        ("reports", {"accuracy": {"met": True, "error_estimate": "x"}}, "reports.accuracy.error_estimate is a str"),
        ("reports", {"warnings": [1]}, "reports.warnings is a list; it must be a list of texts"),
        ("reports", {"warnings": "x"}, "reports.warnings is a str"),
        ("provenance", {"controller": "x"}, "provenance.controller is a str"),
        ("provenance", {"actuation": {"period": 1.0}}, "provenance.actuation.mode is missing"),
        ("provenance", {"actuation": {"mode": "hold rest length"}}, "provenance.actuation.period is missing"),
        ("provenance", {"actuation": {"mode": "hold rest length", "period": None}}, "period is a NoneType"),
        ("cost", {"wall_time": "long"}, "cost.wall_time is a str"),
    ],
    ids=range(11),
)
def test_words_that_commands_read_again_have_their_types(
    attribute: str, words: object, message: str, run_file: Path, tmp_path: Path
) -> None:
    path = tmp_path / "run.nc"
    path.write_bytes(run_file.read_bytes())
    with h5py.File(path, "a") as file:
        file.attrs[attribute] = json.dumps(words)
    with pytest.raises(FormatError, match=message):
        Trajectory.load(path)


def test_control_characters_of_a_run_are_escaped_where_its_warnings_are_printed(
    run_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.nc"
    path.write_bytes(run_file.read_bytes())
    with h5py.File(path, "a") as file:
        file.attrs["engine"] = "\x1b[2J"
        file.attrs["reports"] = json.dumps(
            {"warnings": ["\x1b[31mred"], "accuracy": {"met": False, "reason": "\x9b2J"}}, ensure_ascii=False
        )
    assert main(["compare", str(path), str(run_file)]) == 0
    reported = capsys.readouterr()
    assert "\\x1b[31mred" in reported.err
    assert not {"\x1b", "\x9b"} & set(reported.out + reported.err)
