"""The process-wide control callback of MuJoCo: who has it, and putting it in and out."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numba
import numpy as np
from numba import types

from tensegrity_mj.dynamics.native.pointers import address_of, integers
from tensegrity_mj.dynamics.native.slots import (
    TABLE_SIZE,
)
from tensegrity_mj.engines.mujoco.callback import DATA, control_stage
from tensegrity_mj.engines.mujoco.clock import profiler_off
from tensegrity_mj.errors import OptionError

ACTIVE = np.zeros(1, np.int64)  # address of the running plant's table, 0 for none


ACTIVE_ADDRESS = address_of(ACTIVE)


_OWN: list[Any] = []  # callbacks that were installed here


_lock = threading.Lock()


Callback = Callable[[], tuple[Any, Any]]  # gives a C function, and the compiled object that it points into


def as_callback(compiled: Any) -> tuple[Any, Any]:
    """A numba cfunc (model, data) as what `mujoco.set_mjcb_control` takes, with what must be kept alive."""
    kind = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64)
    return ctypes.cast(compiled.address, kind), compiled


@cache
def single_run() -> tuple[Any, Any]:
    """The callback of one run.

    It bakes in the address of `ACTIVE`, so this thin shell is compiled anew in each process (the rest is cached).
    """
    active = ACTIVE_ADDRESS

    @numba.cfunc(types.void(types.int64, types.int64), error_model="numpy", _nrt=False)
    def control(model: Any, data: Any) -> None:
        address = integers(active, (1,))[0]
        if address != 0:
            table = integers(address, (TABLE_SIZE,))
            if table[DATA] == data:
                control_stage(table)

    return as_callback(control)


@contextmanager
def installed(table: Any, callback: Callback = single_run) -> Iterator[list[str]]:
    """Install a callback with its table; the previous one is put back. Gives the texts that MuJoCo warns with.

    Meanwhile MuJoCo's profiler is off.
    They are kept from MuJoCo's own handler, which would write a log file into the current folder.

    Raises:
        OptionError: if another thread of this process is simulating: MuJoCo has one callback for all.
    """
    import mujoco

    if not _lock.acquire(blocking=False):
        raise OptionError(
            "another MuJoCo run of this process is under way, in another thread or in the law that called this one; "
            "MuJoCo has one callback a process: run simulations one after the other, or in processes"
        )
    texts: list[str] = []
    try:
        function, _keep = callback()
        previous, previous_handler = mujoco.get_mjcb_control(), mujoco.get_mju_user_warning()
        if previous is not None and any(previous is own for own in _OWN):
            previous = None  # an interrupt came before a former run had taken it out
        if not any(function is own for own in _OWN):
            _OWN.append(function)
        try:
            ACTIVE[0] = address_of(table)
            mujoco.set_mjcb_control(function)
            # Nothing that can raise: an exception in there ends the process.
            mujoco.set_mju_user_warning(texts.append)
            with profiler_off():
                yield texts
        finally:
            mujoco.set_mju_user_warning(previous_handler)
            mujoco.set_mjcb_control(previous)
            ACTIVE[0] = 0
    finally:
        _lock.release()
