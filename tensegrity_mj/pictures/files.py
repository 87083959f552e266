"""Output files: checked before the work, and replaced as a whole after it."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from tensegrity_mj.errors import OptionError


def checked(path: str | os.PathLike[str], suffixes: Sequence[str], what: str) -> Path:
    """The path, once it is certain that a file of that kind may be written there.

    Raises:
        OptionError: unknown suffix, missing or unwritable folder, or a folder of that name.
    """
    destination = Path(path)
    if destination.suffix.lower() not in suffixes:
        raise OptionError(f"{what} {path}: the name must end in {' or '.join(suffixes)}")
    if destination.is_dir():
        raise OptionError(f"{what} {path}: that is a folder; name a file in it")
    folder = destination.absolute().parent
    if not folder.is_dir():
        raise OptionError(f"{what} {path}: there is no folder {folder}; create it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OptionError(f"{what} {path}: you may not write in folder {folder}; choose another")
    return destination


@contextlib.contextmanager
def replacing(destination: Path) -> Iterator[Path]:
    """A temporary file beside the destination (with its suffix), which takes its place if the block succeeds.

    Whatever happens, an exception or an interrupt, the destination holds either the old file or the whole new one.
    """
    handle, name = tempfile.mkstemp(
        dir=destination.absolute().parent, prefix=f".{destination.stem}-", suffix=f".part{destination.suffix}"
    )
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        os.replace(temporary, destination)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
