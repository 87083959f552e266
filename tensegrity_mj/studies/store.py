"""The folder of a study: every finished point on disk at once, whole or not at all, each exactly once.

study.json     what the study is: written first, compared when the study goes on
points.jsonl   a line for every finished point, appended and synced; each line carries its own checksum
files/         what tasks left, written before the line of their point
result.json    all points in their order with their outcomes, once all are finished
.lock          locked while a process works here; the lock goes when the process does, however it ends
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping
from io import FileIO
from pathlib import Path
from typing import Any

from tensegrity_mj.basics.files import is_left, replacing
from tensegrity_mj.basics.jsontext import from_exact_json, to_exact_json
from tensegrity_mj.errors import FormatError, OptionError
from tensegrity_mj.studies.plain import difference, digest, plain

STUDY, POINTS, FILES, RESULT, LOCK = "study.json", "points.jsonl", "files", "result.json", ".lock"
FORMAT = 1


class Store:
    """An open study folder, or memory in its place; use `opened`.

    Attributes:
        folder: the folder, or None.
        outcomes: of every point that is finished, by key.
    """

    def __init__(self, folder: Path | None, outcomes: dict[str, dict[str, Any]], file: FileIO | None) -> None:
        self.folder, self.outcomes = folder, outcomes
        self._file = file

    def add(self, key: str, outcome: dict[str, Any], files: Mapping[str, bytes]) -> None:
        """Save a finished point: its files, then its line, which makes it finished; raise FormatError if it cannot."""
        if self.folder is not None and self._file is not None:
            for name, content in files.items():
                (self.folder / FILES).mkdir(exist_ok=True)
                write(self.folder / FILES / name, content)
            try:
                record = {"key": key, "outcome": outcome}
                rest = memoryview((to_exact_json(record | {"check": digest(record)}) + "\n").encode())
                while rest:
                    rest = rest[self._file.write(rest) :]
                os.fsync(self._file.fileno())
            except OSError as error:
                where = self.folder / POINTS
                raise FormatError(
                    f"{where}: cannot be written ({error.strerror}); make room there and run the same again"
                ) from error
        self.outcomes[key] = outcome

    def once(self, point: Mapping[str, Any], task: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
        """The outcome of a point: as it was kept, or computed now, in this process, and kept."""
        key = digest(point)
        if key not in self.outcomes:
            self.add(key, plain(task(), "an outcome"), {})
        return self.outcomes[key]

    def stopped(self, finished: str) -> str:
        """Say how many points are kept when the study is stopped, for {} in what is `finished`, and how to go on."""
        if self.folder is None or self._file is None:
            if not self.outcomes:
                return "nothing is kept: give a folder to go on from there another time"
            return f"{finished.format(len(self.outcomes))} and lost: give a folder to keep them"
        # The file counts: an interrupt may have come when a point was there, and not yet among the outcomes.
        self.outcomes = _recovered(self._file)
        finished = finished.format(len(self.outcomes))
        return f"{finished} and kept in {self.folder}; run the same again to go on from there"


def record_of(line: bytes) -> tuple[str, dict[str, Any]] | None:
    """Key and outcome of a line; None where it is torn or damaged."""
    try:
        record = from_exact_json(line.decode())
        check = record.pop("check")
        return (record["key"], record["outcome"]) if digest(record) == check else None
    except (ValueError, LookupError, TypeError, AttributeError):
        return None


@contextlib.contextmanager
def opened(folder: Path | None, study: dict[str, Any]) -> Iterator[Store]:
    """Make the folder of a study, or go on in it.

    Args:
        folder: None keeps everything in memory.
        study: what the study is, as plain values.

    Raises:
        OptionError: if the folder belongs to another study or to something else, cannot be made, or is in use.
        FormatError: if what says which study it is cannot be read.
    """
    if folder is None:
        yield Store(None, {}, None)
        return

    def own(path: str, flags: int) -> int:  # a link would have another file written
        return os.open(path, flags | os.O_NOFOLLOW, 0o666)

    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / STUDY).exists():
            foreign = sorted(entry.name for entry in folder.iterdir() if entry.name != LOCK and not is_left(entry))
            if foreign:
                raise OptionError(
                    f"{folder}: this folder is no study, and not empty (it holds {foreign[0]}); choose another"
                )
        lock = open(folder / LOCK, "a+b", buffering=0, opener=own)  # noqa: SIM115
    except OSError as error:
        raise OptionError(f"{folder}: no study can be kept there ({error.strerror}); choose another folder") from error
    with lock:
        _hold(lock, folder)
        for left in [*folder.iterdir(), *(folder / FILES).glob("*")]:
            if is_left(left):
                left.unlink()
        _compare(folder, study)
        # Unbuffered: closing after a failed write would try again, and hide the error that says what to do.
        with open(folder / POINTS, "a+b", buffering=0) as file:
            yield Store(folder, _recovered(file), file)


def write(path: Path, content: bytes) -> None:
    """Write a file durably: after a crash, of the program or of the machine, the old one is there or the new one.

    Raises:
        FormatError: if it cannot be written.
    """
    with replacing(path) as part, open(part, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    handle = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _hold(lock: FileIO, folder: Path) -> None:
    import fcntl

    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.seek(0)
        who = lock.read().decode(errors="replace").strip() or "another process"
        raise OptionError(
            f"{folder}: {who} works on this study; wait for it to end, or choose another folder"
        ) from None
    with contextlib.suppress(OSError):  # a full disk; who holds it is only for others to read
        lock.truncate(0)
        lock.write(f"process {os.getpid()}\n".encode())


def _compare(folder: Path, study: dict[str, Any]) -> None:
    """Write what the study is, or refuse a folder that holds another."""
    path = folder / STUDY
    ours = {"format": FORMAT, **study}
    if not path.exists():
        write(path, f"{to_exact_json(ours, indent=1)}\n".encode())
        return
    try:
        theirs = from_exact_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FormatError(f"{path}: it cannot be read ({error}); choose another folder, or delete this one") from error
    if found := difference(ours, theirs):
        raise OptionError(
            f"{folder}: this folder holds another study ({found}); choose another folder, or delete this one"
        )


def _recovered(file: FileIO) -> dict[str, dict[str, Any]]:
    """The outcomes in the file; a last line that a crash tore is cut off, and its point is computed again."""
    file.seek(0)
    content = file.read()
    whole = content.rfind(b"\n") + 1
    if whole < len(content):
        file.truncate(whole)
        os.fsync(file.fileno())
    records = [record_of(line) for line in content[:whole].splitlines()]
    return dict(record for record in records if record is not None)
