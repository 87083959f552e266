"""Laws of 12 strings that end a run, each in its own way, for tests of what becomes of other runs beside it."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.errors import InfeasibleError


def explosive(time: float, nodes: Any, velocities: Any) -> Any:
    return np.full(12, 1e9)


def wrong(time: float, nodes: Any, velocities: Any) -> Any:
    return np.full(12, np.nan) if time >= 0.1 else np.full(12, 0.1)


def unsolvable(time: float, nodes: Any, velocities: Any) -> Any:
    if time >= 0.1:
        raise InfeasibleError("no more")
    return np.full(12, 0.1)
