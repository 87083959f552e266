"""Rods and point masses for the compiled equations, without a plant."""

from __future__ import annotations

from typing import Any, NamedTuple


class Members(NamedTuple):
    """Rods and point masses as records, and what they are subject to.

    Attributes:
        rods, points: of `ROD` and `POINT`.
        gravity: (3,) [m/s²].
        forces: (N, 3) [N] on nodes.
        multipliers: (R,) λ, which are written.
        kp, kd: Baumgarte's gains of (3.25), zero for none.
    """

    rods: Any
    points: Any
    gravity: Any
    forces: Any
    multipliers: Any
    kp: float = 0.0
    kd: float = 0.0
