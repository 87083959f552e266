"""Ctrl-C while compiled code runs: noted at once, raised where it can do no harm. SIGTERM while files are written.

A KeyboardInterrupt raised inside a callback of compiled code is lost, or leaves it with an undefined result. While
`deferred` is active, SIGINT only sets a flag, which engines read between pieces of work; a second one interrupts
wherever Python is.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_requested = False


class Terminated(BaseException):
    """SIGTERM came while something was to be cleaned up; no error, so that nothing but clean-up catches it."""


@contextmanager
def terminating() -> Iterator[None]:
    """SIGTERM raises within the block, which cleans up; after that it ends the process as it does elsewhere."""
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    ):
        yield  # the signal is somebody else's, or cannot reach this thread
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    except Terminated:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.raise_signal(signal.SIGTERM)
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def _note(number: int, frame: FrameType | None) -> None:
    global _requested
    if _requested:
        raise KeyboardInterrupt
    _requested = True


@contextmanager
def deferred() -> Iterator[None]:
    """Note interrupts instead of raising them; one that nobody raised by the end is raised there."""
    global _requested
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield  # the signal is somebody else's, or cannot reach this thread
        return
    _requested = False
    signal.signal(signal.SIGINT, _note)
    try:
        yield
        raise_if_requested()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _requested = False


def requested() -> bool:
    """Return whether an interrupt waits to be raised."""
    return _requested


def raise_if_requested() -> None:
    """Raise the interrupt that waits, if one does."""
    if _requested:
        raise KeyboardInterrupt
