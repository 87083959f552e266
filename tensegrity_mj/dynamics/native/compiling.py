"""Compiled functions: written as Python, compiled by numba when first needed, kept between runs.

numba keeps machine code beside the source (`cache=True`) and compiles anew when that one file changes. What a compiled
function calls in other files, and the constants that it takes from there, become part of its machine code too, and
numba would go on running the old ones. Here a function is known by a digest of all that it uses (`digests`): code and
constants of its own, of what it calls, and so on. Nothing needs to be deleted by hand, and where no folder can be
written, functions are compiled in each process, and one warning says so (`kept`).

Nothing is compiled, and numba is not imported, before something is called that is not kept. A C function that is kept
never needs numba at all: engines call such functions by their address.
"""

from __future__ import annotations

import ctypes
import functools
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tensegrity_mj.dynamics.native import notices
from tensegrity_mj.dynamics.native.beside import taken
from tensegrity_mj.dynamics.native.kept import Code, keep_code, kept_code, shipped_name, write_entry

_compiling = threading.RLock()


class Kernel:
    """A function that numba compiles, for Python and for other compiled functions; numba comes when it is called."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self.targetoptions = function, {"error_model": "numpy"} | options

    @functools.cached_property
    def dispatcher(self) -> Any:
        """Function that Python calls."""
        import numba

        from tensegrity_mj.dynamics.native.numba_cache import cached

        notices.listen()
        return cached(numba.njit(**self.targetoptions)(self.py_func))

    @functools.cached_property
    def _numba_type_(self) -> Any:
        # For other compiled functions: what Python and C would need takes longer to compile than it.
        from tensegrity_mj.dynamics.native.linked import linked

        notices.listen()
        self._linked = linked(self.py_func, self.targetoptions)
        return self._linked._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with these options and the cache of this module; numpy's arithmetic (x / 0 = inf) by default."""
    return lambda function: Kernel(function, options)


njit = compiled()


class Intrinsic:
    """A function whose LLVM code is given: `numba.extending.intrinsic`, made when something that calls it compiles."""

    def __init__(self, definition: Callable[..., Any]) -> None:
        functools.update_wrapper(self, definition)
        self._defn = definition

    @functools.cached_property
    def _numba_type_(self) -> Any:
        from numba.core.registry import cpu_target
        from numba.extending import intrinsic as made

        self._intrinsic = made(self._defn)
        context = cpu_target.typing_context
        context.refresh()
        return context.resolve_value_type(self._intrinsic)

    def __call__(self, *arguments: Any) -> Any:
        raise NotImplementedError(f"{self._defn.__name__} is for compiled functions")


intrinsic = Intrinsic

_C_TYPES: dict[str, Any] = {"void": None, "int64": ctypes.c_int64, "float64": ctypes.c_double}


@functools.cache
def _c_type(signature: str) -> Any:
    returned, _, arguments = signature.rstrip(")").partition("(")
    return ctypes.CFUNCTYPE(_C_TYPES[returned], *(_C_TYPES[one] for one in arguments.split(", ")))


def called_from_c(signature: str, function: Callable[..., Any]) -> tuple[Any, int]:
    """A function of Python as C code calls it, to be kept alive, and its address."""
    made = _c_type(signature)(function)
    return made, ctypes.cast(made, ctypes.c_void_p).value or 0


c_functions: list[CFunction] = []  # of all modules that are imported


class CFunction:
    """A C function, compiled when its address is first needed, unless it is kept.

    Attributes:
        what: it is, in words.
        cache_hits: 1 where it was kept.
    """

    def __init__(self, function: Callable[..., Any], signature: str, what: str) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self.cache_hits = function, 0
        self.what = what or function.__name__.strip("_").replace("_", " ")
        self.signature = signature
        self._options = {"error_model": "numpy"}
        c_functions.append(self)

    @functools.cached_property
    def _code(self) -> tuple[Code, int]:
        with _compiling, taken(self):
            code = kept_code(self.py_func, self.signature, self._options)
            if code is not None:
                address = code.load()
                if not address:  # it needs what numba has
                    _with_numba()
                    address = code.load()
                if address:
                    self.cache_hits = 1
                    return code, address
            code = _compile(self.py_func, self.signature, self._options, self.what)
            keep_code(self.py_func, self.signature, self._options, code)
            return code, code.load()

    @property
    def is_kept(self) -> bool:
        """True where the machine code is already on disk."""
        return kept_code(self.py_func, self.signature, self._options) is not None

    def ship(self, folder: Path) -> None:
        """Write the machine code as an entry of the package: it is to be compiled for any processor.

        Raises:
            OSError: where it cannot be written.
        """
        name = shipped_name(self.py_func, self.signature, self._options)
        assert name is not None, self.py_func
        write_entry(folder, name, self._code[0].entry())

    @property
    def address(self) -> int:
        """Address of the C function."""
        return self._code[1]

    def variable(self, name: str) -> int:
        """The address of a variable of the function's own."""
        return self._code[0].variable(name)

    @functools.cached_property
    def ctypes(self) -> Any:
        """Function of ctypes, which Python can call."""
        return _c_type(self.signature)(self.address)

    def __call__(self, *arguments: Any) -> Any:
        return self.ctypes(*arguments)


def c_function(signature: str, what: str = "") -> Callable[[Callable[..., Any]], Any]:
    """`numba.cfunc` with numpy's arithmetic and the cache of this module; `what` it is, for whoever waits."""
    return lambda function: CFunction(function, signature, what)


def _with_numba() -> None:
    """Bring in what numba gives to compiled functions at run time."""
    from numba.core.registry import cpu_target

    cpu_target.target_context.refresh()
    cpu_target.target_context.codegen()
    from numba.core.runtime import rtsys

    rtsys.initialize(cpu_target.target_context)


def _compile(function: Callable[..., Any], signature: str, options: dict[str, Any], what: str) -> Code:
    """Compile a C function."""
    from numba.core import sigutils

    from tensegrity_mj.dynamics.native import lane_types  # noqa: F401  # which numba must know before it begins
    from tensegrity_mj.dynamics.native.linked import callback

    notices.listen()
    with notices.announced(what):
        made = callback(function, sigutils.normalize_signature(signature), options)
    library = made._library
    module = library._final_module
    declared = [one for one in (*module.functions, *module.global_variables) if one.is_declaration]
    names = sorted(one.name for one in declared if not one.name.startswith("llvm."))
    return Code(made.native_name, names, library._get_compiled_object())
