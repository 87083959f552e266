"""The process-wide control callback of MuJoCo: who has it, and putting it in and out.

One run at a time has it. Runs of other threads wait for their turn, which changes no bit of them.

Meanwhile MuJoCo's profiler is off, which reads the clock for `mjData.timer`: that takes 2 to 35 % of a step. The
function that it calls for the time is process-wide; without one it reads no clock. Python's `set_mjcb_time(None)` puts
the default clock back instead of taking it out, so the C variable itself is set.
"""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import mujoco

from tensegrity_mj.dynamics.native.compiling import CFunction, c_function
from tensegrity_mj.dynamics.native.pointers import own_integer
from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.engines.mujoco.callback import control_stage, finish_row
from tensegrity_mj.engines.mujoco.run_view import RunView
from tensegrity_mj.errors import OptionError

ACTIVE = "tensegrity_mj_active"  # variable of each callback: address of the running plant's table, 0 for none
CALLBACK = "void(int64, int64)"  # of an mjModel and an mjData
active_table = own_integer(ACTIVE)
LIBRARIES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")


_free = threading.Condition()
_holders: list[tuple[int, bool]] = []  # thread of the run that has the callback, and whether its caller ends its turn


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
    other = mujoco.get_mjcb_control()
    if other is not None and not _holders and not any(other is own for own in _OWN):
        raise OptionError(
            "a control callback of your own is installed, and MuJoCo has one for the whole process: take it out with "
            "mujoco.set_mjcb_control(None)"
        )


@contextlib.contextmanager
def _turn(lasting: bool) -> Iterator[None]:
    """Wait until no other thread has the callback, and hold it."""
    mine = (threading.get_ident(), lasting)
    try:
        with _free:
            while _holders:
                thread, endless = _holders[0]
                if endless or thread == mine[0]:
                    raise OptionError(
                        "another MuJoCo run of this process is under way, in the law that called this one or within a "
                        "law_in; MuJoCo has one callback a process, and that one ends after this one: run simulations "
                        "one after the other, or in processes"
                    )
                _free.wait()
            _holders.append(mine)
        yield
    finally:
        with _free:
            if any(one is mine for one in _holders):
                _holders.clear()
                _free.notify_all()


@contextlib.contextmanager
def installed(table: Table, callback: CFunction = single_run, lasting: bool = False) -> Iterator[list[str]]:
    """Install a callback with its table; the previous one is put back. Gives the texts that MuJoCo warns with.

    They are kept from MuJoCo's own handler, which would write a log file into the current folder. A run of another
    thread is waited for; `lasting` is for one that ends when its caller wants, for which nobody waits.

    Raises:
        OptionError: within another run, and while one that is lasting is under way.
    """
    texts: list[str] = []
    with _turn(lasting):
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


@contextlib.contextmanager
def profiler_off() -> Iterator[bool]:
    """Stop `mjData.timer` within the block; false, and no change, where MuJoCo's library does not offer its clock."""
    clock = _clock()
    if clock is None:
        yield False
        return
    before = clock.value
    clock.value = None
    try:
        yield True
    finally:
        clock.value = before


@cache
def _clock() -> Any:
    """The C variable `mjcb_time` of the loaded library."""
    folder = Path(mujoco.__file__).parent
    for path in sorted(path for pattern in LIBRARIES for path in folder.glob(pattern)):
        with contextlib.suppress(OSError, ValueError):  # another library, or one without the symbol
            return ctypes.c_void_p.in_dll(ctypes.CDLL(str(path)), "mjcb_time")
    return None
