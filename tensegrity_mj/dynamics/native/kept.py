"""Machine code that is kept between runs: the files, their names, and loading.

C functions are kept as object files of the machine; LLVM links them into the process, and numba is not even
imported. Functions that Python calls are kept as numba keeps them. Each entry is one file, named after its
content: processes that compile the same function at the same time do not disturb each other, as they could in numba's
common index.

An entry belongs to a kind of processor. The package may also hold entries for any processor of
its architecture, compiled when the package was built (`scripts/compile_ahead.py --ship`): they are used where no
code was compiled here, with any release of numba.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import glob
import json
import os
import sys
import threading
import uuid
import warnings
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.digests import digest, hashed

SHIPPED = Path(__file__).parent / "shipped"  # entries that came with the package
GENERIC = "generic"  # the processor that they are for: any of its architecture


@functools.cache
def made_by() -> str:
    """The releases that decide the machine code of a function."""
    import llvmlite

    try:
        compiler = version("numba")
    except PackageNotFoundError:
        compiler = "none"
    return f"numba {compiler} llvmlite {llvmlite.__version__} numpy {np.__version__}"


@functools.cache
def processors() -> tuple[str, ...]:
    """Kinds of processors whose code runs here: this one or the one that numba compiles for, and any."""
    import llvmlite.binding as llvm

    triple = llvm.get_process_triple()
    name = os.environ.get("NUMBA_CPU_NAME") or llvm.get_host_cpu_name()
    if name == GENERIC:
        return (f"{triple} {GENERIC}",)
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None:
        features = llvm.get_host_cpu_features().flatten()
    return f"{triple} {name} {features}", f"{triple} {GENERIC}"


def folders(source: str) -> tuple[Path, ...]:
    """Folders that may hold compiled functions of a source file; new ones go to the first that can be written to.

    NUMBA_CACHE_DIR, `__pycache__` in the source's folder, `tensegrity-mj` in XDG_CACHE_HOME or in ~/.cache.
    """
    parent = Path(source).resolve().parent
    part = f"{parent.name}_{hashed(str(parent))[:16]}"
    own = os.environ.get("NUMBA_CACHE_DIR")
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return (*((Path(own) / part,) if own else ()), parent / "__pycache__", users / "tensegrity-mj" / part)


def base_name(function: Any) -> str:
    """Return the first part of the names of a function's entries."""
    name = function.__qualname__.replace("<", "").replace(">", "")
    return f"{Path(function.__code__.co_filename).stem}.{name}.{sys.implementation.cache_tag}"


def entry_name(function: Any, use: str, options: dict[str, Any], compiler: str | None = None) -> str | None:
    """<function>.<use>.<digest>: what an entry is for, and what it is made of. None where another process cannot know.

    `use` has the signature and the processor, and what else separates entries of a function side by side; the
    `compiler` is the one that is installed, unless it does not matter.
    """
    content = digest(function)
    if content is None or " at 0x" in use:
        return None
    chosen = (made_by() if compiler is None else compiler) + repr(sorted(options.items()))
    return f"{base_name(function)}.{hashed(use)[:16]}.{hashed(chosen + content)[:16]}.nbc"


def write_entry(folder: Path, name: str, content: bytes) -> None:
    """Write an entry whole, and remove what it replaces.

    Raises:
        OSError: where it cannot be written.
    """
    path = folder / name
    part = path.with_name(f"{name}.tmp.{uuid.uuid4().hex[:16]}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        part.write_bytes(content)
        os.replace(part, path)
        same_use = glob.escape(name.rsplit(".", 2)[0])
        for old in set(folder.glob(f"{same_use}.*.nbc")) - {path}:
            old.unlink(missing_ok=True)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise


# C functions ------------------------------------------------------------------------------------------------------

_HEAD = b"tensegrity-mj "
# Functions that numba's own code calls where a function raises, which ours do not, and where memory is freed, which
# functions without allocations do not need. They exist only once numba is imported.
_HELPERS = ("numba_", "NRT_")
_loaded: list[Any] = []  # engines, which the code belongs to
_loading = threading.Lock()


class Code:
    """The machine code of a C function: an object file and the names that lead into it.

    Attributes:
        symbol: of the function.
        externals: symbols that it takes from elsewhere.
        content: the object file.
    """

    def __init__(self, symbol: str, externals: list[str], content: bytes) -> None:
        self.symbol, self.externals, self.content = symbol, externals, content
        self._engine: Any = None

    @classmethod
    def of_entry(cls, entry: bytes) -> Code:
        """Read what `entry` wrote.

        Raises:
            ValueError: for a damaged one.
        """
        head, _, content = entry.partition(b"\n")
        if not head.startswith(_HEAD):
            raise ValueError("no entry")
        header = json.loads(head.removeprefix(_HEAD))
        if header["size"] != len(content) or header["hash"] != hashed(content):
            raise ValueError("damaged")
        return cls(header["symbol"], header["externals"], content)

    def entry(self) -> bytes:
        """Return the code as the content of a file."""
        header: dict[str, Any] = {"symbol": self.symbol, "externals": self.externals}
        header |= {"size": len(self.content), "hash": hashed(self.content)}
        return _HEAD + json.dumps(header).encode() + b"\n" + self.content

    def load(self) -> int:
        """Link the code into the process; return the function's address, 0 where a symbol that it needs is missing."""
        import llvmlite.binding as llvm

        with _loading:
            with contextlib.suppress(RuntimeError):
                llvm.initialize()  # needed below llvmlite 0.45, refused from there on
            llvm.initialize_native_target()
            llvm.initialize_native_asmprinter()
            # An engine each: names of different functions never meet. It also opens what this process has of symbols.
            machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(jit=True)
            empty = llvm.parse_assembly("")
            engine = llvm.create_mcjit_compiler(empty, machine)
            engine.remove_module(empty)  # to compile it, empty as it is, takes 5 MB and some ms
            missing = [name for name in self.externals if not llvm.address_of_symbol(name)]
            if any(not name.startswith(_HELPERS) or "alloc" in name or "_new" in name for name in missing):
                return 0
            for name in missing:
                llvm.add_symbol(name, _failing()[1])
            engine.add_object_file(llvm.ObjectFileRef.from_data(self.content))
            engine.finalize_object()
            self._engine = engine
            _loaded.append(engine)
        return int(engine.get_function_address(self.symbol))

    def variable(self, name: str) -> int:
        """The address of a variable of its own, once it is loaded."""
        return int(self._engine.get_global_value_address(name))


@functools.cache
def _failing() -> tuple[Any, int]:
    """Make the stub that replaces numba's runtime helpers; any call of it ends the process."""

    def fail() -> None:
        print("tensegrity-mj: compiled code raised an exception: please report this", file=sys.stderr, flush=True)
        os.abort()

    function = ctypes.CFUNCTYPE(None)(fail)
    return function, ctypes.cast(function, ctypes.c_void_p).value or 0


def kept_code(function: Any, signature: str, options: dict[str, Any]) -> Code | None:
    """The machine code of a C function that is kept for this processor, or came with the package."""
    for path in _places(function, signature, options):
        try:
            return Code.of_entry(path.read_bytes())
        except (OSError, ValueError, LookupError, TypeError):
            continue  # there is none, or a damaged one: it is compiled and written again
    return None


def keep_code(function: Any, signature: str, options: dict[str, Any], code: Code) -> None:
    """Keep the machine code of a C function, compiled for the first of `processors`."""
    name = entry_name(function, f"C {signature} {processors()[0]}", options)
    if name is not None:
        write_first(folders(function.__code__.co_filename), name, code.entry())


def write_first(where: Sequence[Path], name: str, content: bytes) -> None:
    """Write an entry into the first of these folders that takes it; where none does, one warning says so."""
    reasons = []
    for folder in where:
        try:
            write_entry(folder, name, content)
            return
        except OSError as error:
            reasons.append(f"{folder}: {error.strerror or error}")
    warn_once("; ".join(reasons))


def shipped_name(function: Any, signature: str, options: dict[str, Any]) -> str | None:
    """Return the file name of an entry that comes with the package; it does not depend on the compiler."""
    return entry_name(function, f"C {signature} {processors()[-1]}", options, compiler="shipped")


def _places(function: Any, signature: str, options: dict[str, Any]) -> Iterator[Path]:
    for processor in processors():
        name = entry_name(function, f"C {signature} {processor}", options)
        if name is not None:
            yield from (folder / name for folder in folders(function.__code__.co_filename))
    name = shipped_name(function, signature, options) if SHIPPED.is_dir() else None
    if name is not None:
        yield SHIPPED / name


def warn_once(reason: str) -> None:
    """Warn once that compiled code cannot be cached."""
    if not _warned:
        _warned.append(reason)
        warnings.warn(
            f"compiled functions cannot be kept: {reason}. Each start compiles them again, which may take minutes; "
            "set NUMBA_CACHE_DIR to a folder that you may write in",
            RuntimeWarning,
            stacklevel=2,
        )


_warned: list[str] = []
