"""Switch for MuJoCo's profiler, which reads the clock for `mjData.timer`: that takes 2 to 35 % of a step.

The function that it calls for the time is process-wide; without one it reads no clock. Python's `set_mjcb_time(None)`
puts the default clock back instead of taking it out, so the C variable itself is set.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

LIBRARIES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")


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
    import mujoco

    folder = Path(mujoco.__file__).parent
    for path in sorted(path for pattern in LIBRARIES for path in folder.glob(pattern)):
        with contextlib.suppress(OSError, ValueError):  # another library, or one without the symbol
            return ctypes.c_void_p.in_dll(ctypes.CDLL(str(path)), "mjcb_time")
    return None
