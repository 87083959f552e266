"""One thing at a time, in this process: what is timed must not share the machine with other points of its own study.

Each finished point is on disk at once, and a later call goes on where an earlier one stopped.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import from_exact_json, to_exact_json
from tensegrity_mj.errors import FormatError
from tensegrity_mj.studies import store
from tensegrity_mj.studies.many import bar_of
from tensegrity_mj.studies.plain import digest


class Bench:
    """An open folder of finished points; use `opened`."""

    def __init__(self, kept: store.Store, progress: bool) -> None:
        self.kept, self.progress = kept, progress

    def knows(self, point: dict[str, Any]) -> bool:
        """Whether a point is finished."""
        return digest(point) in self.kept.outcomes

    def once(self, point: dict[str, Any], task: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The outcome of a point: as it was kept, or computed now and kept."""
        key = digest(point)
        if key not in self.kept.outcomes:
            self.kept.add(key, from_exact_json(to_exact_json(task())), {})
        return self.kept.outcomes[key]

    def save_array(self, name: str, array: Array) -> None:
        """Keep an array; before the outcome of its point, which then finds it."""
        buffer = io.BytesIO()
        np.save(buffer, array, allow_pickle=False)
        (self.kept.folder / store.FILES).mkdir(exist_ok=True)
        store.write(self._path(name), buffer.getvalue())

    def load_array(self, name: str) -> Array:
        """An array that was kept.

        Raises:
            FormatError: if it is gone or damaged.
        """
        path = self._path(name)
        try:
            return np.asarray(np.load(path, allow_pickle=False), float)
        except (OSError, ValueError) as error:
            raise FormatError(
                f"{path}: it cannot be read ({error}); delete the folder and run the study again"
            ) from error

    def bar(self, label: str, total: int) -> AbstractContextManager[Any]:
        """A progress bar on stderr; shown only where `progress` is set."""
        return bar_of(label, total, 0, self.progress)

    def _path(self, name: str) -> Path:
        return self.kept.folder / store.FILES / f"{name}.npy"


@contextlib.contextmanager
def opened(folder: Path, study: dict[str, Any], progress: bool) -> Iterator[Bench]:
    """Make the folder of a study, or go on in it.

    Raises:
        OptionError: a folder that holds another study, or is in use.
        KeyboardInterrupt: with a message that says what is kept.
    """
    with store.opened(folder, from_exact_json(to_exact_json(study))) as kept:
        try:
            yield Bench(kept, progress)
        except KeyboardInterrupt:
            finished = len(kept.outcomes)
            raise KeyboardInterrupt(f"{finished} runs are kept in {folder}; run the same again to go on") from None
