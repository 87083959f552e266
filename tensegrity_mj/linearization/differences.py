"""Central differences of high order, for functions that are analytic within a known distance."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.structure import Structure

# f'(0) h = Σ w (f(k h) - f(-k h)), k = 1 to n: of order 2 n (Lagrange's weights).
PAIRS = 6
WEIGHTS = tuple(
    -((-1) ** k) * math.factorial(PAIRS) ** 2 / (k * math.factorial(PAIRS - k) * math.factorial(PAIRS + k))
    for k in range(1, PAIRS + 1)
)
STEP = 0.022  # of R
# Of that, where rods close loops: what closes them is a root of equations, analytic in a shorter distance. The lowest
# ω² of `net` is 118 with the whole step, and 67.30030945 with this part of it and with a quarter of this.
LOOP_STEP = 0.15
# Where forces may have kinks near by: of STEP; and of 1 m/s or 1 rad/s, for differences in rates.
NARROW, NARROW_RATE = 0.01, 1e-6


def central(function: Callable[[float], Array], h: float) -> Array:
    """f'(0) by the points of WEIGHTS."""
    total: Any = 0.0
    for p, weight in enumerate(WEIGHTS, start=1):
        total = total + weight / h * (function(p * h) - function(-p * h))
    return np.asarray(total)


def reach_of(structure: Structure, nodes: Array) -> float:
    """R [m]: the shortest of strings and rods, the distance in which directions change."""
    lengths = np.concatenate([structure.string_lengths(nodes), structure.rod_lengths])
    return float(lengths.min()) if len(lengths) else 1.0
