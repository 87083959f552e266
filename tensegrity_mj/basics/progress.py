"""Progress bars: on stderr where that is a terminal, below the cell of a notebook, and nowhere else."""

from __future__ import annotations

import sys
from typing import Any

from tensegrity_mj.errors import printable


def bar(shown: bool, desc: str, **settings: Any) -> Any:
    """A bar of tqdm with its settings, or one that shows nothing where none is to be shown or could be seen."""
    if not (shown and (in_notebook() or sys.stderr.isatty())):
        return NoBar()
    if in_notebook():
        from tqdm.auto import tqdm  # a widget, or text where ipywidgets is not installed
    else:
        from tqdm import tqdm
    return tqdm(desc=printable(desc), file=sys.stderr, **settings)


def in_notebook() -> bool:
    """Whether this is a kernel of Jupyter, whose stderr is no terminal; as tqdm decides it."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return shell is not None and "IPKernelApp" in shell.config


class NoBar:
    """What a bar of tqdm has, and shows nothing; importing tqdm takes longer than many a run."""

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
