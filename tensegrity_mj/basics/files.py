"""Output files: checked before the work, and replaced as a whole after it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import tempfile
import time
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tensegrity_mj.basics import interrupts
from tensegrity_mj.errors import FormatError, OptionError

NEW = ".new-"  # what the names of temporary files begin with
LEFT = 60.0  # [s]: one that is older has the lock of the process that writes it, if that lives


def checked(path: str | os.PathLike[str], suffixes: Sequence[str], what: str) -> Path:
    """Check that a file of that kind may be written at a path, and return the path.

    Raises:
        OptionError: no path, unknown suffix, missing or unwritable folder, or something there that is no writable file.
    """
    try:
        destination = Path(path)
    except TypeError:
        raise OptionError(f"{what} {path!r}: that is no path; give the name of a file") from None
    if destination.suffix.lower() not in suffixes:
        raise OptionError(f"{what} {path}: the name must end in {' or '.join(suffixes)}")
    try:
        mode = _mode(destination)
        if mode is not None and stat.S_ISDIR(mode):
            raise OptionError(f"{what} {path}: that is a folder; name a file in it")
        target = destination.resolve()
        folder = target.parent
        if not folder.is_dir():
            raise OptionError(f"{what} {path}: there is no folder {folder}; create it first")
        if mode is not None and not stat.S_ISREG(mode):
            raise OptionError(f"{what} {path}: something that is no regular file is there; choose another name")
        # Files are replaced as a whole, which needs no right to write the old one; what was made read-only stays.
        if mode is not None and not os.access(target, os.W_OK):
            raise OptionError(f"{what} {path}: the file there is read-only; choose another name or make it writable")
        # Only trying shows it: rights say nothing of file systems that take no new files.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OptionError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle; a null character
        if isinstance(error, PermissionError):
            raise OptionError(f"{what} {path}: you may not write in its folder; choose another") from error
        raise OptionError(f"{what} {path}: no file can be written there ({_reason(error)}); choose another") from error
    return destination


def path_of(path: str | os.PathLike[str], name: str = "a file") -> Path:
    """The path, or FormatError; `name` says of what it is the name."""
    try:
        return Path(path)
    except TypeError:
        raise FormatError(f"{path!r}: that is no path; give the name of {name}") from None


def content_of(path: Path, most_bytes: int) -> bytes:
    """The content of a regular file of at most so many bytes.

    Devices and pipes are refused before they are opened: reading from them may never end.

    Raises:
        FormatError: if there is no such file, or it is larger, of another kind, or cannot be read.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise FormatError(f"{path}: that is a folder; name a file in it")
        if not stat.S_ISREG(mode):
            raise FormatError(f"{path}: that is no regular file (a device, a pipe or a socket); name a file")
        # Non-blocking: a pipe may have come in its place meanwhile.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            content = file.read(most_bytes + 1)
    except FormatError:
        raise
    except FileNotFoundError:
        raise FormatError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        raise FormatError(f"{path}: cannot be read ({_reason(error)})") from error
    if len(content) > most_bytes:
        raise FormatError(
            f"{path}: the file has more than {most_bytes / 1e6:g} MB, the most that is read; make it smaller"
        )
    return content


def said_in_comments(lines: Iterable[str]) -> dict[str, Any]:
    """Read lines such as `# step = 0.01` as TOML; other comments are skipped."""
    found: dict[str, Any] = {}
    for line in lines:
        if line.startswith("#"):
            with contextlib.suppress(ValueError, RecursionError):  # as TOML raises both
                found |= tomllib.loads(line[1:])
    return found


def table_beside(module: str) -> dict[str, Any]:
    """Read the data of a module: the TOML file with the name of its `__file__`, in the same folder."""
    return tomllib.loads(Path(module).with_suffix(".toml").read_text(encoding="utf-8"))


def made_folder(path: str | os.PathLike[str]) -> Path:
    """The folder, made with those above it where it is not there yet.

    Raises:
        OptionError: where none can be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a null character
        raise OptionError(f"{folder}: no folder can be made there ({_reason(error)}); choose another") from error
    return folder


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary file in the destination's folder (with its suffix), which takes its place if the block succeeds.

    After an exception, an interrupt or SIGTERM, too, the destination holds either the old file or the whole new
    one, and the temporary file is gone.
    A link stays a link: the file that it names is replaced. Temporary files of processes that were killed are removed.

    Raises:
        FormatError: if the file cannot be written, in the block or after it.
    """
    destination = path_of(path)
    with interrupts.terminating():
        yield from _replaced(destination)


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    """Write a text file in UTF-8, as a whole or not at all (`replacing`); returns the path.

    Raises:
        FormatError: if the file cannot be written.
    """
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def _replaced(destination: Path) -> Iterator[Path]:
    temporary, handle = None, None
    try:
        target = destination.resolve()
        mode = _mode(destination)
        if mode is not None and not stat.S_ISREG(mode):
            raise FormatError(f"{destination}: cannot be written (it is no regular file); choose another name")
        _remove_left(target.parent)
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=NEW, suffix=f".part{destination.suffix}")
        temporary = Path(name)
        fcntl.flock(handle, fcntl.LOCK_EX)  # until the process ends, however it does
        yield temporary
        mask = os.umask(0)  # mkstemp makes it private; give it the rights of any new file
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        os.replace(temporary, target)
    except BaseException as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise FormatError(
                f"{destination}: cannot be written ({_reason(error)}); make room and rights there, or choose another "
                "folder"
            ) from error
        raise
    finally:
        if handle is not None:
            os.close(handle)


def is_left(path: Path) -> bool:
    """Return whether a path has the name of a temporary file, which a process that was killed may have left."""
    return path.name.startswith(NEW) and ".part" in path.name


def _remove_left(folder: Path) -> None:
    """Remove the temporary files of killed processes: nobody holds their locks, and they are no longer new."""
    for path in filter(is_left, folder.glob(f"{NEW}*")):
        with contextlib.suppress(OSError), open(path, "rb") as file:
            if time.time() - path.stat().st_mtime > LEFT:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()


def _mode(path: Path) -> int | None:
    """Return the mode of the file at a path, None for no file; OSError for circular links, which `exists` may hide."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
