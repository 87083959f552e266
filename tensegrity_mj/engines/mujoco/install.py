"""The process-wide control callback of MuJoCo: who has it, and putting it in and out."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from tensegrity_mj.dynamics.native.compiling import CFunction, c_function
from tensegrity_mj.dynamics.native.pointers import own_integer
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines.mujoco.callback import control_stage, finish_row
from tensegrity_mj.engines.mujoco.clock import profiler_off
from tensegrity_mj.engines.mujoco.run_view import RunView
from tensegrity_mj.errors import OptionError

ACTIVE = "tensegrity_mj_active"  # variable of each callback: address of the running plant's table, 0 for none
CALLBACK = "void(int64, int64)"  # of an mjModel and an mjData
active_table = own_integer(ACTIVE)


_lock = threading.Lock()  # held while a run of ours is under way


@c_function(CALLBACK, "the callback of MuJoCo's steps: strings, law, loads, energy")
def single_run(model, data):  # type: ignore[no-untyped-def]
    """The callback of one run."""
    table = active_table()
    if table != 0 and RunView(table).data == data:
        control_stage(table)


@c_function("int64(int64)", "the end of a row of MuJoCo's")
def finish(table):  # type: ignore[no-untyped-def]
    """`finish_row` of the table at an address, for Python."""
    finish_row(table)
    return 0


@cache
def _installable(callback: CFunction) -> tuple[Any, Any]:
    """A callback as `mujoco.set_mjcb_control` takes it, and its place for the active table."""
    _OWN.append(callback.ctypes)
    return callback.ctypes, ctypes.c_int64.from_address(callback.variable(ACTIVE))


_OWN: list[Any] = []  # callbacks of this package's


def refuse_other_callbacks() -> None:
    """Raise OptionError where a control callback that is not of this package is installed."""
    import mujoco

    other = mujoco.get_mjcb_control()
    if other is not None and not _lock.locked() and not any(other is own for own in _OWN):
        raise OptionError(
            "a control callback of your own is installed, and MuJoCo has one for the whole process: take it out with "
            "mujoco.set_mjcb_control(None)"
        )


@contextmanager
def installed(table: Table, callback: CFunction = single_run) -> Iterator[list[str]]:
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
        function, active = _installable(callback)
        previous, previous_handler = mujoco.get_mjcb_control(), mujoco.get_mju_user_warning()
        if previous is not None and any(previous is own for own in _OWN):
            previous = None  # an interrupt came before a former run had taken it out
        try:
            active.value = table.address
            mujoco.set_mjcb_control(function)
            # Nothing that can raise: an exception in there ends the process.
            mujoco.set_mju_user_warning(texts.append)
            with profiler_off():
                yield texts
        finally:
            mujoco.set_mju_user_warning(previous_handler)
            mujoco.set_mjcb_control(previous)
            active.value = 0
    finally:
        _lock.release()
