"""Warnings that point at the line of whoever called the package, however deep inside they are found."""

from __future__ import annotations

import sys
import warnings
from contextlib import nullcontext
from typing import Any

INSIDE = "tensegrity_mj."


def warn_caller(text: str, category: type[Warning]) -> None:
    """Warn with the place of the first caller outside the package."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(INSIDE):
        level, frame = level + 1, frame.f_back
    bars: Any = getattr(sys.modules.get("tqdm"), "tqdm", None)  # whose line is cleared meanwhile
    with bars.external_write_mode(sys.stderr) if getattr(bars, "_instances", ()) else nullcontext():
        warnings.warn(text, category, stacklevel=level)
