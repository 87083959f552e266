"""Compiled functions that are kept between runs, and compiled anew when anything that they use has changed.

numba keeps machine code beside the source (`cache=True`) and compiles anew when that one file changes. What a compiled
function calls in other files, and the constants that it takes from there, become part of its machine code too, and
numba would go on running the old ones. The cache here therefore knows a function by a digest of all that it uses:
code and constants of its own, of what it calls, and so on. Nothing needs to be deleted by hand.

Each entry is one file, named after its content: processes that compile the same function at the same time do not
disturb each other, as they could in numba's common index. Where no folder can be written, functions are compiled in
each process, and one warning says so.
"""

from __future__ import annotations

import enum
import functools
import glob
import hashlib
import os
import pickle
import sys
import types
import uuid
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import sigutils
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps
from numba.extending import _Intrinsic

# What numba knows by name, in releases that the cache keeps apart; no source of ours.
_FOREIGN = frozenset({"numba", "numpy", "llvmlite", "scipy"}) | sys.stdlib_module_names


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with these options and the cache of this module; numpy's arithmetic (x / 0 = inf) by default."""
    decorate = numba.njit(**{"error_model": "numpy"} | options)

    def keep(function: Callable[..., Any]) -> Any:
        made: Any = decorate(function)
        if hasattr(made, "py_func"):  # NUMBA_DISABLE_JIT leaves the function as it is
            made._cache = _cache_of(made.py_func, made.targetoptions) or made._cache
        return made

    return keep


njit = compiled()


def c_function(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.cfunc` with numpy's arithmetic and the cache of this module. It is compiled here and now."""

    def keep(function: Callable[..., Any]) -> Any:
        options = {"error_model": "numpy"}
        made: Any = CFunc(function, sigutils.normalize_signature(signature), locals={}, options=options)
        made._cache = _cache_of(function, options) or made._cache
        made.compile()
        return made

    return keep


def adopt(function: Any) -> None:
    """Give a compiled function of the user's, and all that it calls, this module's cache in place of numba's."""
    for one in (function, *_used_by(function)):
        if type(getattr(one, "_cache", None)) is FunctionCache:
            found = sum(one.stats.cache_hits.values())
            one._cache = _cache_of(one.py_func, one.targetoptions) or one._cache
            if found:
                one.recompile()  # what numba's cache gave may be out of date


# What a function uses ---------------------------------------------------------------------------------------------


class _UnknownValue(Exception):
    """A global that has no digest: what uses it is compiled in every process."""


def digest(function: Any) -> str | None:
    """A digest of all that a compiled function is made of; None if it uses something that has none."""
    try:
        used = {_python(one) for one in (function, *_used_by(function))}
        parts = sorted((one.__module__, one.__qualname__, _own(one)[0]) for one in used)
    except _UnknownValue:
        return None
    return _hash(repr(parts))


def _used_by(function: Any) -> Iterator[Any]:
    """All that a function calls, directly or not, as its code names it."""
    todo, seen = [_python(function)], {_python(function)}
    while todo:
        for one in _own(todo.pop())[1]:
            if _python(one) not in seen:
                seen.add(_python(one))
                todo.append(_python(one))
                yield one


def _python(function: Any) -> types.FunctionType:
    """The function of Python that a compiled one, or an intrinsic, was made from."""
    found: types.FunctionType = getattr(function, "py_func", None) or getattr(function, "_defn", function)
    return found


@functools.cache
def _own(function: types.FunctionType) -> tuple[str, tuple[Any, ...]]:
    """A digest of what a function itself holds, and the functions that it names."""
    calls: list[Any] = []
    names = set(_names(function.__code__))
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    text = [_text(function.__code__, names, calls), _text(tuple(cells), names, calls)]
    text.append(_text(function.__defaults__, names, calls))
    for name in sorted(names & function.__globals__.keys()):
        text.append(f"{name}={_text(function.__globals__[name], names, calls)}")
    return _hash("\n".join(text)), tuple(calls)


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def _text(value: Any, names: set[str], calls: list[Any]) -> str:
    """A value that compiled code may hold, as text that is the same in every process; functions go to `calls`.

    Raises:
        _UnknownValue: for what has no such text.
    """
    again = functools.partial(_text, names=names, calls=calls)
    if isinstance(value, (Dispatcher, _Intrinsic)):
        calls.append(value)
        return f"{_python(value).__qualname__} {sorted(getattr(value, 'targetoptions', {}).items())}"
    if isinstance(value, (types.ModuleType, types.FunctionType, type)) and _root(value) in _FOREIGN:
        return f"{_root(value)} {value.__name__}"
    match value:
        case types.FunctionType():
            calls.append(value)
            return value.__qualname__
        case types.CodeType():
            held = (value.co_code, value.co_names, value.co_varnames, value.co_freevars)
            return f"{held} {[again(constant) for constant in value.co_consts]}"
        case types.ModuleType():
            return repr([(name, again(vars(value)[name])) for name in sorted(names & vars(value).keys())])
        case enum.EnumType():
            members: list[enum.Enum] = list(value)
            return repr([(one.name, again(one.value)) for one in members])
        case type():
            return f"{value.__module__}.{value.__qualname__} {getattr(value, '_fields', '')}"
        case enum.Enum():
            return f"{value.name}={again(value.value)}"
        case tuple() | list():
            return repr([again(one) for one in value])
        case frozenset() | set():
            return repr(sorted(again(one) for one in value))
        case np.ndarray() if not value.dtype.hasobject:
            return f"{value.dtype!r} {value.shape} {_hash(value.tobytes())}"
        case None | bool() | int() | float() | complex() | str() | bytes() | np.generic() | np.dtype() | slice():
            return f"{type(value).__name__} {value!r}"
        case np.ufunc() | types.BuiltinFunctionType():
            return value.__name__
        case numba.types.Type():
            return str(value)
    if callable(value) and _root(value) in _FOREIGN:  # np.linalg.norm and its like
        return f"{_root(value)} {getattr(value, '__name__', '')}"
    if value is Ellipsis:
        return "..."
    raise _UnknownValue(f"{type(value).__name__} {value!r}")


def _root(value: Any) -> str:
    """The package that something belongs to."""
    name = value.__name__ if isinstance(value, types.ModuleType) else getattr(value, "__module__", None)
    return str(name).partition(".")[0]


def _hash(content: str | bytes) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


# Where it is kept -------------------------------------------------------------------------------------------------


class _Cache(FunctionCache):  # type: ignore[misc]
    """numba's cache of one function, with files of our own."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        super().__init__(function)
        self._cache_file = _Files(function, options, Path(self.cache_path))


class _Files:
    """The machine code of one function, a file for each signature: <function>.<signature>.<digest>.nbc."""

    def __init__(self, function: Any, options: dict[str, Any], folder: Path) -> None:
        self.function, self.folder = function, folder
        name = function.__qualname__.replace("<", "").replace(">", "")
        self.base = f"{Path(function.__code__.co_filename).stem}.{name}.{sys.implementation.cache_tag}"
        self.made_by = repr((numba.__version__, np.__version__, sorted(options.items())))

    def _name(self, key: tuple[Any, ...]) -> tuple[str, str] | None:
        """What an entry is for, and what it is made of; None for what cannot be known in another process."""
        content = digest(self.function)
        signature, processor, (_, *closure) = key
        text = repr((signature, processor, closure))
        if content is None or " at 0x" in text:
            return None
        return _hash(text)[:16], _hash(self.made_by + content)[:16]

    def load(self, key: tuple[Any, ...]) -> Any:
        """What was saved for a key of numba's; None if nothing was, or if it cannot be read."""
        name = self._name(key)
        if name is None:
            return None
        try:
            return pickle.loads((self.folder / f"{self.base}.{'.'.join(name)}.nbc").read_bytes())
        except Exception:  # there is none, or whatever a damaged one makes of it: it is compiled and written again
            return None

    def save(self, key: tuple[Any, ...], data: Any) -> None:
        """Save, and remove what it replaces."""
        name = self._name(key)
        if name is None:
            return
        path = self.folder / f"{self.base}.{'.'.join(name)}.nbc"
        part = path.with_name(f"{path.name}.tmp.{uuid.uuid4().hex[:16]}")
        try:
            part.write_bytes(dumps(data))
            os.replace(part, path)
            stale = set(self.folder.glob(f"{glob.escape(self.base)}.{name[0]}.*.nbc")) - {path}
            for old in stale:
                old.unlink(missing_ok=True)
        except OSError as error:
            part.unlink(missing_ok=True)
            _warn(f"{self.folder}: {error.strerror or error}")

    def flush(self) -> None:
        """Remove every entry."""
        for old in self.folder.glob(f"{glob.escape(self.base)}.*.nbc"):
            old.unlink(missing_ok=True)


def cache_folder() -> Path:
    """Where the compiled functions of this folder are kept: the first that numba can write of NUMBA_CACHE_DIR,
    `__pycache__` beside the source, and the user's cache folder (on Linux `numba` in XDG_CACHE_HOME, or in ~/.cache).

    Raises:
        RuntimeError, OSError: if none of these can be written.
    """
    return Path(FunctionCache(cache_folder).cache_path)


def _cache_of(function: Any, options: dict[str, Any]) -> _Cache | None:
    try:
        return _Cache(function, options)
    except (RuntimeError, OSError):  # numba found no folder
        _warn(f"neither {Path(function.__code__.co_filename).parent} nor the user's cache folder can be written")
        return None


def _warn(reason: str) -> None:
    """Say it once: there are hundreds of functions."""
    if not _told:
        _told.append(reason)
        warnings.warn(
            f"compiled functions cannot be kept: {reason}. Each start compiles them again, which may take minutes; "
            "set NUMBA_CACHE_DIR to a folder that you may write in",
            RuntimeWarning,
            stacklevel=2,
        )


_told: list[str] = []
