"""A second process that compiles beside this one, where there are two cores, and keeps what it compiles.

Either process takes a function before it compiles it: it locks a byte that stands for the function, in a file that only
the two of them have. Locks end with their process: if the second one fails, this one compiles what it does not find.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

from tensegrity_mj.dynamics.native import notices
from tensegrity_mj.dynamics.native.digests import hashed

_locks: list[int] = []  # the file of locks, while there are two processes


@contextlib.contextmanager
def second_process(names: Sequence[str], heard: bool = False) -> Iterator[Any]:
    """Have a second process compile C functions, module:name each, in this order, unless at most one is not kept.

    Its progress and its errors are not written, unless it is `heard`. Yields the process, if there is one.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    todo = [name for name, one in zip(names, _named(names), strict=True) if not one.is_kept] if cores > 1 else []
    if len(todo) < 2:
        yield None
        return
    import subprocess

    locks, process = os.memfd_create("functions"), None
    command = [str(sys.executable), "-P", "-c", f"from {__name__} import _main; _main()", str(locks), *todo]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    errors = None if heard else subprocess.DEVNULL
    with contextlib.suppress(OSError):
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=errors, env=environment, pass_fds=[locks])
    _locks.append(locks)
    try:
        yield process
    finally:
        _locks.remove(locks)
        if process is not None:
            process.kill()
            process.communicate()
        os.close(locks)


def _named(names: Sequence[str]) -> list[Any]:
    return [getattr(importlib.import_module(module), name) for module, name in (one.split(":") for one in names)]


@contextlib.contextmanager
def taken(function: Any, wait: bool = True) -> Iterator[bool]:
    """Take a function for the block; if the other process has it, wait until it does not, or give False."""
    byte = int(hashed(f"{function.__module__}:{function.__qualname__}")[:12], 16)
    with notices.announced(function.what):
        while not (free := _lock(byte)) and wait:
            notices.step()
            time.sleep(0.02)
    try:
        yield free
    finally:
        _lock(byte, free=True)  # of this process alone


def _lock(byte: int, free: bool = False) -> bool:
    if not _locks:
        return True
    import fcntl  # where there are such locks

    with contextlib.suppress(BlockingIOError):
        for file in _locks:
            fcntl.lockf(file, fcntl.LOCK_UN if free else fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
        return True
    return False


def compile_in_turn(functions: Sequence[Any]) -> None:
    """Compile those C functions that are not kept, nor taken by the other process, and say so on stderr."""
    begin, width, end = ("\r", 60, "") if sys.stderr.isatty() else ("", 0, "\n")
    for function in functions:
        with taken(function, wait=False) as free, notices.silent():
            if free and not function.is_kept:
                print(f"{begin}Compiling {function.what:<{width}.60}", end=end, file=sys.stderr, flush=True)
                _ = function.address


def _main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process ends this one, or the end of its input
    threading.Thread(target=lambda: os._exit(len(os.read(0, 1)) or 1), daemon=True).start()
    warnings.filterwarnings("error", "compiled functions cannot be kept")  # it would compile for nobody
    _locks.append(int(sys.argv[1]))
    compile_in_turn(_named(sys.argv[2:]))
