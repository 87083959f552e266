"""Files of runs with wrong bytes: the run that was saved, or an error; never another run."""

from __future__ import annotations

import base64
import copy
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import tensegrity_mj as tmj
from tensegrity_mj.errors import FormatError, OptionError

DRAWS = 150


def same(one: tmj.Trajectory, other: tmj.Trajectory) -> bool:
    names = ("time", "nodes", "velocities", "tensions", "rest_lengths")
    equal = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
    return equal and (one.status, one.message, one.engine) == (other.status, other.message, other.engine)


def test_a_file_with_wrong_bytes_is_never_another_run(tmp_path: Path, prism_run: tmj.Trajectory) -> None:
    path, rng = prism_run.save(tmp_path / "run.nc"), np.random.default_rng(8)
    whole = path.read_bytes()
    refused = changed = 0
    for draw in range(DRAWS):
        content = bytearray(whole)
        if draw % 3:  # a bit, or a block of zeros
            content[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
        else:
            begin = int(rng.integers(len(whole) - 64))
            content[begin : begin + 64] = bytes(64)
        changed += content != whole  # zeros may be there already
        (tmp_path / "damaged.nc").write_bytes(content)
        try:
            loaded = tmj.Trajectory.load(tmp_path / "damaged.nc")
        except FormatError:
            refused += 1
        else:
            assert same(loaded, prism_run), draw
    # The checksum is of all of the file but its own 86 bytes.
    assert refused >= changed - 5 > DRAWS / 2


def test_a_number_that_another_program_changed_in_place_is_read(tmp_path: Path, prism_run: tmj.Trajectory) -> None:
    path = prism_run.save(tmp_path / "run.nc")
    with h5py.File(path, "r+") as file:
        file["nodes"][0, 0, 0] += 1e-3
    assert tmj.Trajectory.load(path).nodes[0, 0, 0] == prism_run.nodes[0, 0, 0] + 1e-3


def _zeros(count: int) -> str:
    return base64.b64encode(bytes(8 * count)).decode()


# What becomes of the kept state of a run's end, and the entry that the message names.
DAMAGE: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "a list": (lambda end: [1, 2], "end"),
    "a number": (lambda end: 3.0, "end"),
    "nothing in it": (lambda end: {}, "end"),
    "no engine": (lambda end: {k: v for k, v in end.items() if k != "engine"}, "end"),
    "an engine of another type": (lambda end: end | {"engine": 7}, "end"),
    "sizes as a list": (lambda end: end | {"sizes": list(end["sizes"])}, "end"),
    "a part missing": (lambda end: {k: v for k, v in end.items() if k != "winch"}, "end"),
    "a part more": (lambda end: end | {"more": _zeros(1)}, "end"),
    "a part of another type": (lambda end: end | {"winch": [0.0, 0.0, 0.0]}, "end.winch"),
    "a part that is no code": (lambda end: end | {"winch": "é"}, "end.winch"),
    "a part of half a number": (lambda end: end | {"winch": base64.b64encode(bytes(12)).decode()}, "end.winch"),
    "a part of another shape": (lambda end: end | {"winch": _zeros(2)}, "end.winch"),
    "a part that is NaN": (lambda end: end | {"winch": base64.b64encode(np.full(3, np.nan)).decode()}, "end.winch"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_end_is_refused_by_name(damage: str, tmp_path: Path) -> None:
    change, named = DAMAGE[damage]
    mass = tmj.Structure("mass", {"n": (0.0, 0.0, 0.0)}, point_masses=(tmj.PointMass("n", 1.0),))
    run = tmj.simulate(tmj.Scene(mass, gravity=(0.0, 0.0, -9.81)), timestep=0.01, duration=0.02)
    run.provenance["end"] = change(run.provenance["end"])
    path = run.save(tmp_path / "run.nc")
    with pytest.raises(FormatError, match=rf"run\.nc: provenance\.{re.escape(named)} .*simulate that run again"):
        tmj.Trajectory.load(path)
    with pytest.raises(FormatError, match=rf"the run to go on from: provenance\.{re.escape(named)} "):
        tmj.simulate(run, timestep=0.01, duration=0.02)


def test_an_end_without_a_part_and_its_size_is_refused() -> None:
    mass = tmj.Structure("mass", {"n": (0.0, 0.0, 0.0)}, point_masses=(tmj.PointMass("n", 1.0),))
    run = tmj.simulate(tmj.Scene(mass), timestep=0.01, duration=0.02)
    for name in ("winch", "qpos", "suspended"):
        end = copy.deepcopy(run.provenance["end"])
        del end[name], end["sizes"][name]
        again = replace(run, provenance=run.provenance | {"end": end})
        with pytest.raises(OptionError, match=f"has 0 numbers of {name}, and this one"):
            tmj.simulate(again, timestep=0.01, duration=0.02)
