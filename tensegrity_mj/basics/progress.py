"""Progress on stderr: a bar on a terminal or below the cell of a notebook, elsewhere a line now and then."""

from __future__ import annotations

import sys
import time
from typing import Any

from tensegrity_mj.errors import printable

SPARSE = 30.0  # s between lines at the beginning


def bar(shown: bool, desc: str, **settings: Any) -> Any:
    """Make a bar of tqdm with its settings; lines of text without a terminal, and nothing unless `shown`."""
    if not shown:
        return NoBar()
    if not (in_notebook() or sys.stderr.isatty()):
        return Lines(printable(desc), settings.get("total"))
    if in_notebook():
        from tqdm.auto import tqdm  # a widget, or text where ipywidgets is not installed
    else:
        from tqdm import tqdm
    return tqdm(desc=printable(desc), file=sys.stderr, **settings)


def in_notebook() -> bool:
    """Return whether this is a kernel of Jupyter, whose stderr is no terminal; as tqdm decides it."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return shell is not None and "IPKernelApp" in shell.config


class NoBar:
    """Progress bar with the methods of tqdm's that shows nothing; importing tqdm takes longer than many a run."""

    n = 0.0

    def update(self, more: float = 1) -> None:
        """Count on."""

    def refresh(self) -> None:
        """Show nothing."""

    def close(self) -> None:
        """End."""

    def __enter__(self) -> NoBar:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Lines(NoBar):
    """Progress as lines: one after half a minute, then each time after as much and a tenth of the time so far."""

    def __init__(self, desc: str, total: float | None) -> None:
        self.desc, self.total, self.begun, self.last = desc, total, time.monotonic(), 0.0

    def update(self, more: float = 1) -> None:
        """Count on, and print a line where it is time."""
        self.n += more
        self.refresh()

    def refresh(self) -> None:
        """Print a line where it is time."""
        elapsed = time.monotonic() - self.begun
        if elapsed - self.last >= SPARSE + 0.1 * elapsed:
            self.last = elapsed
            reached = f"{100 * self.n / self.total:.0f} %" if self.total else f"{self.n:g}"
            print(f"{self.desc}: {reached} after {elapsed:.0f} s", file=sys.stderr, flush=True)
