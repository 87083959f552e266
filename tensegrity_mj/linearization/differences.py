"""Central differences of high order, for functions that are analytic within a known distance."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.structure import Structure

PAIRS = 6


def _weights(pairs: int) -> Array:
    """Weights w of f'(0) h = Σ w (f(k h) - f(-k h)), k = 1 to n: of order 2 n (Lagrange's), zero above n."""
    found = np.zeros(PAIRS)
    for k in range(1, pairs + 1):
        w = math.factorial(pairs) ** 2 / (k * math.factorial(pairs - k) * math.factorial(pairs + k))
        found[k - 1] = -((-1) ** k) * w
    return found


WEIGHTS, FEWER = _weights(PAIRS), _weights(PAIRS - 1)
STEP = 0.022  # of R
# Of that, where rods close loops: what closes them is a root of equations, analytic in a shorter distance. The lowest
# ω² of `net` is 118 with the whole step, and 67.30030945 with this part of it and with a quarter of this.
LOOP_STEP = 0.15
# A function that is analytic within R of the state has f'(0) by n pairs to (n!)² (h/R)^2n of itself: 4e-13 by five of
# them for h = 0.022 R, and 7e-15 by six. SETTLED of five is 1e-12 of six.
SETTLED = 2.4e-11
# Where forces may have kinks near by: of STEP; and of 1 m/s or 1 rad/s, for differences in rates.
NARROW, NARROW_RATE = 0.01, 1e-6


def central(function: Callable[[float], Array], h: float) -> Array:
    """Derivative f'(0) by the points of WEIGHTS."""
    return _both(function, h)[0]


def settled(function: Callable[[float], Array], h: float) -> Array:
    """Derivative f'(0) by the points of WEIGHTS; the step is halved while one pair fewer shows that it is too long.

    In long chains of rods it may be: a rod that much hangs on is analytic in a far shorter distance than its length.
    """
    found, error = _both(function, h)
    while error > SETTLED * np.abs(found).max(initial=0.0):
        h /= 2
        finer, less = _both(function, h)
        if less > error / 8:  # round-off, or a kink: truncation falls to a thousandth
            break
        found, error = finer, less
    return found


def _both(function: Callable[[float], Array], h: float) -> tuple[Array, float]:
    """Derivative f'(0) by all pairs, and the largest difference from that of one pair fewer."""
    found = fewer = np.zeros(())
    for p, (weight, other) in enumerate(zip(WEIGHTS, FEWER, strict=True), start=1):
        change = function(p * h) - function(-p * h)
        found, fewer = found + weight / h * change, fewer + other / h * change
    return found, float(np.abs(found - fewer).max(initial=0.0))


def reach_of(structure: Structure, nodes: Array) -> float:
    """R [m]: the shortest of strings and rods, the distance in which directions change."""
    lengths = np.concatenate([structure.string_lengths(nodes), structure.rod_lengths])
    return float(lengths.min()) if len(lengths) else 1.0
