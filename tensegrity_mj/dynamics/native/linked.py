"""Functions that only compiled functions call: they have no machine code, as their callers hold what they do.

numba makes machine code of every function, although callers take its intermediate code, which LLVM then compiles again
as part of theirs: half of the time that a C function takes to compile. Imported once something compiles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """Intermediate code as it was written, which is optimized in its callers."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Compiler(Compiler):  # type: ignore[misc]
    """numba's, up to intermediate code."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        context = self.state.targetctx  # numba's copy for the options of this function
        self.state.library = _Library(context.codegen(), "linked")
        context.get_executable = _not_executable


def _not_executable(library: Any, described: Any, environment: Any) -> Any:
    """Return what numba knows a compiled function by, without a function in it."""
    return _dynfunc.make_function(described.lookup_module(), described.qualname, "", 0, environment, (library,))


def linked(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return `numba.njit` of a function, for compiled functions alone."""
    return numba.njit(**options, no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=_Compiler)(function)
