"""numba's cache of the functions that Python calls, with files of our own. Imported once something compiles."""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache
from numba.core.serialize import dumps

from tensegrity_mj.dynamics.native.digests import hashed, used_by
from tensegrity_mj.dynamics.native.kept import base_name, entry_name, folders, warn_once, write_first


class _Cache(FunctionCache):  # type: ignore[misc]
    """numba's cache of one function, with files of our own."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        super().__init__(function)
        self._cache_file = Files(function, options, folders(function.__code__.co_filename))


class Files:
    """The machine code of one function, a file for each signature: <function>.<signature>.<digest>.nbc."""

    def __init__(self, function: Any, options: dict[str, Any], where: Sequence[Path]) -> None:
        self.function, self.options, self.where = function, options, where

    def _name(self, key: tuple[Any, ...]) -> str | None:
        signature, processor, (_, *closure) = key
        return entry_name(self.function, repr((signature, processor, closure)), self.options)

    def load(self, key: tuple[Any, ...]) -> Any:
        """Return what was saved for a key of numba's; None if nothing was, or if it cannot be read."""
        name = self._name(key)
        for folder in self.where if name else ():
            # The file is missing or damaged (any exception): the function is compiled and written again.
            with contextlib.suppress(Exception):
                mark, _, content = (folder / str(name)).read_bytes().partition(b"\n")
                if mark == hashed(content).encode():  # machine code with a wrong byte would end the process
                    return pickle.loads(content)
        return None

    def save(self, key: tuple[Any, ...], data: Any) -> None:
        """Save, and remove what it replaces."""
        name = self._name(key)
        if name is not None:
            content = dumps(data)
            write_first(self.where, name, hashed(content).encode() + b"\n" + content)

    def flush(self) -> None:
        """Remove every entry."""
        for folder in self.where:
            for old in folder.glob(f"{base_name(self.function)}.*.nbc"):
                old.unlink(missing_ok=True)


def cached(dispatcher: Any) -> Any:
    """Give what numba makes of a function our cache."""
    if hasattr(dispatcher, "py_func"):  # NUMBA_DISABLE_JIT leaves the function as it is
        dispatcher._cache = _cache_of(dispatcher.py_func, dispatcher.targetoptions) or dispatcher._cache
    return dispatcher


def adopt(function: Any) -> None:
    """Give a compiled function of the user's, and all that it calls, this module's cache in place of numba's."""
    for one in (function, *used_by(function)):
        if type(getattr(one, "_cache", None)) is FunctionCache:
            found = sum(one.stats.cache_hits.values())
            cached(one)
            if found:
                one.recompile()  # what numba's cache gave may be out of date


def _cache_of(function: Any, options: dict[str, Any]) -> _Cache | None:
    try:
        return _Cache(function, options)
    except RuntimeError:  # numba found no folder
        warn_once(f"neither {Path(function.__code__.co_filename).parent} nor the user's cache folder can be written")
        return None
