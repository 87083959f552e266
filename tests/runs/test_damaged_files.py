"""Files of runs with wrong bytes: the run that was saved, or an error; never another run."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj.errors import FormatError

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
