"""The smallest controls that meet one linear equation: Lemma 5.1, in closed form, also above threshold values.

Given v and α, find u with vᵀu = α, u >= ū >= 0, that minimizes ‖u‖_p for p = 1, 2 or ∞. With α' = α - vᵀū, a solution
exists if and only if α' = 0 or max(v/α') > 0, (5.18); that maximum is the feasibility margin. For ū = 0 the
solutions are those of the lemma.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

njit = numba.njit(cache=True, error_model="numpy")


@njit
def feasibility_margin(v: Any, alpha: float, floor: Any) -> float:
    """max(v/α') of (5.18), infinite where α' = 0 (then u = ū solves it)."""
    rest = alpha
    for i in range(len(v)):
        rest -= v[i] * floor[i]
    if rest == 0.0:
        return np.inf
    margin = -np.inf
    for i in range(len(v)):
        margin = max(margin, v[i] / rest)
    return margin


@njit
def least_norm(v: Any, alpha: float, floor: Any, norm: float, u: Any) -> float:
    """Write the minimizer of ‖u‖_norm (norm 1, 2 or inf) into u and return the margin; u = ū where it is <= 0."""
    n = len(v)
    rest, highest = alpha, 0.0
    for i in range(n):
        u[i] = floor[i]
        rest -= v[i] * floor[i]
        highest = max(highest, floor[i])
    margin = feasibility_margin(v, alpha, floor)
    if rest == 0.0 or not margin > 0.0:
        return margin
    if norm == 1.0:
        best = 0
        for i in range(1, n):
            if v[i] / rest > v[best] / rest:
                best = i
        u[best] += rest / v[best]
    elif norm == 2.0:
        _least_squares(v, alpha, rest, floor, u)
    else:
        _least_maximum(v, rest, highest, floor, u)
    return margin


@njit
def _least_squares(v: Any, alpha: float, rest: float, floor: Any, u: Any) -> None:
    # The optimality conditions give u_i = max(ū_i, μ v_i), with μ of the sign of α'. The sum of v_i u_i grows with
    # |μ| piecewise linearly; strings leave their threshold at |μ| = ū_i / |v_i|: walk these breakpoints upwards.
    sign = 1.0 if rest > 0.0 else -1.0
    n = len(v)
    if rest == alpha and not floor.any():
        # Part b) of the lemma as printed: no threshold, no breakpoint.
        square = 0.0
        for i in range(n):
            if sign * v[i] > 0.0:
                square += v[i] * v[i]
        for i in range(n):
            if sign * v[i] > 0.0:
                u[i] = alpha * v[i] / square
        return
    breakpoints = np.empty(n)
    for i in range(n):
        w = sign * v[i]
        breakpoints[i] = floor[i] / w if w > 0.0 else np.inf
    order = np.argsort(breakpoints)
    slope, at_floor = 0.0, sign * (alpha - rest)
    mu = 0.0
    for position in range(n):
        i = order[position]
        if breakpoints[i] == np.inf:
            break
        if slope > 0.0 and (sign * alpha - at_floor) / slope <= breakpoints[i]:
            break
        slope += v[i] * v[i]
        at_floor -= sign * v[i] * floor[i]
    mu = (sign * alpha - at_floor) / slope
    for i in range(n):
        u[i] = max(floor[i], mu * sign * v[i])


@njit
def _least_maximum(v: Any, rest: float, highest: float, floor: Any, u: Any) -> None:
    # Raise every helpful string to one common level y; below the highest threshold the level is not unique, and the
    # part of the way that suffices is taken.
    sign = 1.0 if rest > 0.0 else -1.0
    gain, slack = 0.0, 0.0
    for i in range(len(v)):
        w = sign * v[i]
        if w > 0.0:
            gain += w
            slack += w * (highest - floor[i])
    need = sign * rest
    for i in range(len(v)):
        if sign * v[i] > 0.0:
            if need <= slack:
                u[i] = floor[i] + (highest - floor[i]) * (need / slack)
            else:
                u[i] = highest + (need - slack) / gain
