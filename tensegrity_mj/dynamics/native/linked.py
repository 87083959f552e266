"""Compilation of C functions and of what they call: numba's way, without what takes half of its time.

- A function that only compiled ones call gets no machine code: callers take its intermediate code, which LLVM compiles
  as part of theirs.
- Operators and functions of numba's own are typed once for arguments of given types, where numba tries all that it
  knows of `+`, from numbers to sets of strings, at each addition: a fourth of the time.
- Passes for what none of our functions has (closures, `with`, `raise`, `literal_unroll`, `inline=`) are left out.
- Code that several callees share is linked into a function once, where numba links it into each of them first.
- Python collects no garbage meanwhile: a sixth of the time.

All passes of LLVM are numba's, so that results keep their bits and loops their speed. Imported once something compiles.
"""

from __future__ import annotations

import copy
import functools
import gc
from collections.abc import Callable
from typing import Any

import numba
from numba import _dynfunc
from numba.core import typed_passes, types, untyped_passes
from numba.core.ccallback import CFunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import PassManager
from numba.core.typing import Context

_PASSES = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.RewriteSemanticConstants,
    untyped_passes.DeadBranchPrune,
    untyped_passes.GenericRewrites,
    untyped_passes.ReconstructSSA,
    untyped_passes.DeadBranchPrune,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.NopythonRewrites,
    typed_passes.IRLegalization,
    typed_passes.NativeLowering,
    typed_passes.NoPythonBackend,
)


class _Typing(Context):  # type: ignore[misc]
    """numba's, which remembers how it has typed a call of a function of numba's own."""

    _known: dict[Any, tuple[Any, Any]] = {}  # noqa: RUF012  (of the process)

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call."""
        kind: Any = func if isinstance(func, types.Type) else self._lookup_global(func)
        keys = getattr(kind, "_impl_keys", None)
        if keys is None:  # no function of numba's own
            return super().resolve_function_type(func, args, kws)
        call = kind, args, tuple(dict(kws).items())
        if call in self._known:
            signature, keys[signature.args] = self._known[call]
            return signature
        signature = super().resolve_function_type(func, args, kws)
        implementation = keys.get(getattr(signature, "args", None))
        # One that is compiled from Python (`min`) depends on the options of the function that calls it.
        compiled = [getattr(one, "_compiled_overloads", {}).values() for one in kind.templates]
        if implementation is not None and not any(implementation is one for some in compiled for one in some):
            self._known[call] = signature, implementation
        return signature


@functools.cache
def _typing(context: Any) -> Any:
    """Return a context of typing with the tables of another."""
    made = copy.copy(context)
    made.__class__ = _Typing
    return made


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """The code of a function that has an address, with all that it calls."""

    def finalize(self) -> None:
        """Link and compile."""
        self._linking_libraries = _link_all(self, self._final_module)
        super().finalize()


class _Intermediate(JITCodeLibrary):  # type: ignore[misc]
    """The code of a function as it was written, which is compiled in its callers."""

    _whole: Any = None

    def finalize(self) -> None:
        """Leave it to the callers to link what this one calls."""
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        # For a caller that is not compiled here, such as a function of a user's.
        if self._whole is None:
            self._whole = self._final_module.clone()
            for other in _link_all(self, self._whole):
                self._whole.link_in(other._get_module_for_linking(), preserve=True)
            for one in self._final_module.functions:
                if not one.is_declaration:
                    self._whole.get_function(one.name).linkage = "linkonce_odr"
        return self._whole


def _link_all(library: Any, module: Any) -> list[Any]:
    """Link the intermediate code that a library calls, directly or not, once each; return what else it calls."""
    found: list[Any] = [library]
    others: list[Any] = []
    for one in found:
        for called in one._linking_libraries:
            if called not in found and called not in others:
                (found if isinstance(called, _Intermediate) else others).append(called)
    for one in found[1:]:
        names = [function.name for function in one._final_module.functions if not function.is_declaration]
        module.link_in(one._final_module, preserve=True)
        for name in names:
            module.get_function(name).linkage = "linkonce_odr"  # as numba has it: gone where it is inlined
    return others


class _Compiler(Compiler):  # type: ignore[misc]
    """numba's, with what is said above."""

    library = _Library

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.typingctx = _typing(self.state.typingctx)
        self.state.library = self.library(self.state.targetctx.codegen(), "linked")
        self.state.library.enable_object_caching()

    def define_pipelines(self) -> list[Any]:
        """Return the passes."""
        manager = PassManager("nopython")
        for one in _PASSES:
            manager.add_pass(one, one.__name__)
        manager.finalize()
        return [manager]


class _Linked(_Compiler):
    """The same, up to intermediate code."""

    library = _Intermediate

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.targetctx.get_executable = _not_executable  # of numba's copy for the options of this function


def _not_executable(library: Any, described: Any, environment: Any) -> Any:
    """Return what numba knows a compiled function by, without a function in it."""
    return _dynfunc.make_function(described.lookup_module(), described.qualname, "", 0, environment, (library,))


def linked(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return `numba.njit` of a function, for compiled functions alone."""
    return numba.njit(**options, no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=_Linked)(function)


def callback(function: Callable[..., Any], signature: Any, options: dict[str, Any]) -> Any:
    """Return `numba.cfunc` of a function, compiled."""
    made: Any = CFunc(function, signature, locals={}, options=options, pipeline_class=_Compiler)
    collecting = gc.isenabled()
    gc.disable()  # nearly all that numba makes stays in use until the end
    try:
        made.compile()
    finally:
        if collecting:
            gc.enable()
    return made
