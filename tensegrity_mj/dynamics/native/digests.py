"""Digest of a compiled function's content: its own code and constants, those of what it calls, and so on."""

from __future__ import annotations

import enum
import functools
import sys
import types
from collections.abc import Iterator
from typing import Any

import numpy as np

try:
    from _blake2 import blake2b  # hashlib imports OpenSSL as well: 4 MB
except ImportError:
    from hashlib import blake2b

# Packages whose functions are known by name: the cache keeps their releases apart.
_FOREIGN = frozenset({"numba", "numpy", "llvmlite", "scipy"}) | sys.stdlib_module_names


class _UnknownValue(Exception):
    """A global that has no digest: what uses it is compiled in every process."""


def digest(function: Any) -> str | None:
    """A digest of all that a compiled function is made of; None if it uses something that has none."""
    try:
        used = {python_function(one) for one in (function, *used_by(function))}
        parts = sorted((one.__module__, one.__qualname__, _own(one)[0]) for one in used)
    except _UnknownValue:
        return None
    return hashed(repr(parts))


def used_by(function: Any) -> Iterator[Any]:
    """List all that a function calls, directly or not, as its code names it."""
    todo, seen = [python_function(function)], {python_function(function)}
    while todo:
        for one in _own(todo.pop())[1]:
            if python_function(one) not in seen:
                seen.add(python_function(one))
                todo.append(python_function(one))
                yield one


def python_function(function: Any) -> types.FunctionType:
    """The function of Python that a compiled one, or an intrinsic, was made from; ours, or numba's own."""
    found: types.FunctionType = getattr(function, "py_func", None) or getattr(function, "_defn", function)
    return found


@functools.cache
def _own(function: types.FunctionType) -> tuple[str, tuple[Any, ...]]:
    """A digest of what a function itself holds, and the functions that it names."""
    calls: list[Any] = []
    names = set(_names(function.__code__))
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    text = [text_of(function.__code__, names, calls), text_of(tuple(cells), names, calls)]
    text.append(text_of(function.__defaults__, names, calls))
    for name in sorted(names & function.__globals__.keys()):
        text.append(f"{name}={text_of(function.__globals__[name], names, calls)}")
    return hashed("\n".join(text)), tuple(calls)


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def text_of(value: Any, names: set[str], calls: list[Any]) -> str:
    """A value that compiled code may hold, as text that is the same in every process; functions go to `calls`.

    Raises:
        _UnknownValue: for what has no such text.
    """
    again = functools.partial(text_of, names=names, calls=calls)
    if not isinstance(value, (type, types.FunctionType)) and isinstance(python_function(value), types.FunctionType):
        calls.append(value)
        return f"{python_function(value).__qualname__} {sorted(getattr(value, 'targetoptions', {}).items())}"
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
            return f"{value.dtype!r} {value.shape} {hashed(value.tobytes())}"
        case None | bool() | int() | float() | complex() | str() | bytes() | np.generic() | np.dtype() | slice():
            return f"{type(value).__name__} {value!r}"
        case np.ufunc() | types.BuiltinFunctionType():
            return value.__name__
    if any(_root(base) == "numba" and base.__name__ == "Type" for base in type(value).__mro__):
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


def hashed(content: str | bytes) -> str:
    """BLAKE2b of 32 bytes, in hexadecimal digits."""
    return blake2b(content.encode() if isinstance(content, str) else content, digest_size=32).hexdigest()
