"""One line on stderr that says what is being compiled, and how far it is, for whoever waits."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tensegrity_mj.basics import interrupts

QUIET = 2.0  # s without a word: most functions are compiled by then
EVERY = 10.0  # s between two lines

_state: dict[str, Any] = {"what": "", "begun": 0.0, "said": 0.0, "count": 0, "listening": False}


@contextmanager
def announced(what: str) -> Iterator[None]:
    """Say what is compiled within the block, if it takes long."""
    outer = dict(_state)
    now = time.monotonic()
    _state.update(what=what, begun=now, said=0.0, count=0)
    try:
        yield
        if _state["said"]:
            _say(f"compiled {what} in {time.monotonic() - now:.0f} s")
    finally:
        _state.update({key: outer[key] for key in ("what", "begun", "said", "count")})


def listen() -> None:
    """Have numba say when it has compiled a function. An interrupt that waits is raised there."""
    if _state["listening"]:
        return
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            _step()

        def on_end(self, event: Any) -> None:
            _step()

    event.register("numba:compile", Listener())
    _state["listening"] = True


def _step() -> None:
    interrupts.raise_if_requested()
    if not _state["what"]:
        return
    _state["count"] += 1
    now = time.monotonic()
    if not _state["said"] and now - _state["begun"] > QUIET:
        _state["said"] = now
        _say(f"compiling {_state['what']} (once; it is kept for later runs) ...")
    elif _state["said"] and now - _state["said"] > EVERY:
        _state["said"] = now
        _say(f"compiling {_state['what']}: {_state['count'] // 2} functions in {now - _state['begun']:.0f} s ...")


def _say(text: str) -> None:
    print(f"tensegrity-mj: {text}", file=sys.stderr, flush=True)
