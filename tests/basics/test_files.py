"""Files are replaced as a whole: whatever ends the writing, the old file is there, and nothing beside it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.files import replacing, write_text

WRITE = """
import sys, time
from tensegrity_mj.basics.files import replacing

with replacing(sys.argv[1]) as part:
    part.write_text("half of the new")
    with replacing(sys.argv[2]) as other:
        print("ready", flush=True)
        time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_process_that_is_ended_leaves_the_old_file_and_nothing_else(number: signal.Signals, tmp_path: Path) -> None:
    path = tmp_path / "run.nc"
    path.write_text("the old")
    with subprocess.Popen(
        [sys.executable, "-c", WRITE, str(path), str(tmp_path / "other.nc")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        assert len(list(tmp_path.glob(".new-*.part.nc"))) == 2
        process.send_signal(number)
        _, reported = process.communicate(timeout=60)
    assert process.returncode == -number  # as ever: who sent the signal sees that it did its work
    assert ("Traceback" in reported) == (number == signal.SIGINT)
    assert path.read_text() == "the old"
    assert [one.name for one in tmp_path.iterdir()] == ["run.nc"]


def test_handlers_are_as_before(tmp_path: Path) -> None:
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    with replacing(tmp_path / "a.txt") as part:
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
        part.write_text("whole")
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "b.txt"):
        _ = 1 / 0
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert [one.name for one in tmp_path.iterdir()] == ["a.txt"]


def test_a_handler_of_somebody_else_stays_theirs(tmp_path: Path) -> None:
    came = []
    signal.signal(signal.SIGTERM, lambda number, frame: came.append(number))
    try:
        with replacing(tmp_path / "a.txt") as part:
            part.write_text("whole")
            signal.raise_signal(signal.SIGTERM)
        assert came == [signal.SIGTERM]
        assert (tmp_path / "a.txt").read_text() == "whole"
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def test_other_threads_write_without_handlers(tmp_path: Path) -> None:
    seen = []

    def write() -> None:
        with replacing(tmp_path / "a.txt") as part:
            seen.append(signal.getsignal(signal.SIGTERM))
            part.write_text("whole")

    thread = threading.Thread(target=write)
    thread.start()
    thread.join()
    assert seen == [signal.SIG_DFL]
    assert (tmp_path / "a.txt").read_text() == "whole"
    assert not issubclass(interrupts.Terminated, Exception)


def test_what_a_killed_process_left_goes_with_the_next_file(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", WRITE, str(tmp_path / "run.nc"), str(tmp_path / "other.nc")],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        left = sorted(tmp_path.glob(".new-*.part.nc"))
        assert len(left) == 2
        for path in left:
            os.utime(path, (0, 0))  # as if it were long ago
        write_text(tmp_path / "a.txt", "while it lives")
        assert sorted(tmp_path.glob(".new-*")) == left
        process.kill()
    assert sorted(tmp_path.glob(".new-*")) == left
    write_text(tmp_path / "b.txt", "when it is dead")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.txt", "b.txt"]


LIMITED = """
import resource, sys
import tensegrity_mj as tmj
from tensegrity_mj.runs.netcdf import opened

run = tmj.simulate("pinned_rod", controller=None, engine="dae", integrator="rk4", timestep=0.01, duration=1.0)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), -1))
for path in sys.argv[2:]:
    try:
        run.save(path)
    except tmj.TensegrityError as error:
        print(error)
"""


@pytest.mark.parametrize("room", [5_000])
def test_a_disk_that_fills_while_a_run_is_written_is_one_message(tmp_path: Path, room: int) -> None:
    paths = [tmp_path / name for name in ("run.nc", "run.csv", "run.mat")]
    for path in paths:
        path.write_text("the old")
    command = [sys.executable, "-c", LIMITED, str(room), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0  # HDF5 ends the process later where a file was open in it
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert len(lines) == len(paths)
    for path, line in zip(paths, lines, strict=True):
        assert re.fullmatch(rf".*/{path.name}: cannot be written \(File too large\); make room .*", line)
        assert path.read_text() == "the old"
    assert len(list(tmp_path.iterdir())) == len(paths)
