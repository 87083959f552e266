"""Studies in processes that are killed, and what they leave on disk."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tensegrity_mj.studies import store
from tensegrity_mj.studies.plain import canonical

TESTS = Path(__file__).resolve().parent
DEADLINE = 60  # s, for what must come about, however slow the machine is


def records(folder: Path) -> list[tuple[str, dict[str, Any]]]:
    """The whole records on disk."""
    content = (folder / store.POINTS).read_bytes() if (folder / store.POINTS).exists() else b""
    found = [store.record_of(line) for line in content.splitlines(keepends=True) if line.endswith(b"\n")]
    return [record for record in found if record is not None]


def result(folder: Path) -> bytes:
    return (folder / store.RESULT).read_bytes()


@contextlib.contextmanager
def study_process(code: str, folder: Path, log: Path) -> Iterator[subprocess.Popen[str]]:
    """A study in a process of its own; `code` finds its folder in `folder`."""
    lines = ["import study_tasks", "from tensegrity_mj.studies.many import run_many"]
    lines += ["from tensegrity_mj.studies.workers import Workers", f"folder = {str(folder)!r}", textwrap.dedent(code)]
    environment = {**os.environ, "PYTHONPATH": str(TESTS), "STUDY_LOG": str(log)}
    with subprocess.Popen(
        [sys.executable, "-c", "\n".join(lines)], stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for(condition: Any) -> None:
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.002)


def size_of(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def computed(log: Path) -> list[tuple[str, int]]:
    """Points and processes that a log holds."""
    lines = log.read_text().splitlines() if log.exists() else []
    return [(line.split()[0], int(line.split()[1])) for line in lines]


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def kill_and_resume(
    code: str, folder: Path, tmp_path: Path, kills: int, seed: int, pause: float, name_of: Callable[[str], str]
) -> int:
    """Start, kill -9 at a random moment, look what was finished, start again, ...; then let it end.

    Nothing that was finished before a start may be computed after it: `name_of` gives the name in the log of a point
    from its outcome. Returns how many kills hit a study that had begun to compute and had not ended.
    """
    generator = random.Random(seed)
    pids: set[int] = set()
    hits = 0
    for number in range(kills + 1):
        log = tmp_path / f"log{number}"
        finished = {canonical(outcome) for _, outcome in records(folder)}
        before = size_of(folder / store.POINTS)
        with study_process(code, folder, log) as process:
            if number < kills:
                if generator.random() < 0.25:
                    time.sleep(generator.uniform(0.0, 1.0))  # anywhere, starting up included
                else:
                    wait_for(
                        lambda at=before, one=process: size_of(folder / store.POINTS) > at or one.poll() is not None
                    )
                    time.sleep(generator.uniform(0.0, pause))
                process.kill()
            _, err = process.communicate()
        if number == kills:
            assert process.returncode == 0, err
        hits += process.returncode == -signal.SIGKILL and size_of(folder / store.POINTS) > before
        again = {name for name, _ in computed(log)} & {name_of(text) for text in finished}
        assert not again, f"start {number} computed finished points again: {sorted(again)[:5]}"
        pids |= {pid for _, pid in computed(log)}
    wait_for(lambda: not any(map(is_alive, pids)))  # killed parents leave no workers behind
    return hits
