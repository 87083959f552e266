"""One line on stderr that says what is being compiled and why, for whoever waits."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from tensegrity_mj.basics import interrupts

QUIET = 2.0  # s without a word: most functions are compiled by then
OTHERS = "small functions that Python calls"


@dataclass
class _Block:
    """Compilation under way: of what, the seconds spent, the time since when, and whether it was reported."""

    what: str
    spent: float = 0.0
    since: float = 0.0
    said: bool = False


_others = _Block(OTHERS)  # all that is compiled outside of `announced`
_blocks = [_others]
_state = {"listening": False, "silent": False}


@contextmanager
def announced(what: str) -> Iterator[None]:
    """Say what is compiled within the block, once, if it takes long."""
    _blocks.append(_Block(what, since=time.monotonic()))
    try:
        yield
    finally:
        _blocks.pop()


@contextmanager
def silent() -> Iterator[None]:
    """Say nothing within the block: whoever compiles reports it."""
    before = _state["silent"]
    _state["silent"] = True
    try:
        yield
    finally:
        _state["silent"] = before


def listen() -> None:
    """Have numba report when it compiles a function. An interrupt that waits is raised there."""
    if _state["listening"]:
        return
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        depth = 0

        def on_start(self, event: Any) -> None:
            self.depth += 1
            if self.depth == 1:
                _blocks[-1].since = time.monotonic()
            step()

        def on_end(self, event: Any) -> None:
            step()
            self.depth -= 1
            if self.depth == 0:
                _blocks[-1].spent += time.monotonic() - _blocks[-1].since

    event.register("numba:compile", Listener())
    _state["listening"] = True


def step() -> None:
    """Say what is compiled, where it takes long. An interrupt that waits is raised here."""
    interrupts.raise_if_requested()
    block = _blocks[-1]
    if not block.said and not _state["silent"] and block.spent + time.monotonic() - block.since > QUIET:
        block.said = True
        print(
            f"tensegrity-mj: compiling {block.what}, once: none is kept yet for this version, Python and processor",
            file=sys.stderr,
            flush=True,
        )
