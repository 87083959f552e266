"""The smallest controls that meet one linear equation: Lemma 5.1, in closed form, also between thresholds and ceilings.

Given v and α, find u with vᵀu = α and ū <= u <= c that minimizes ‖u‖_p for p = 1, 2 or ∞; ū >= 0, and c may be
infinite. Let α' = α - vᵀū be what the thresholds leave to do, w = v sign(α'), and C = Σ max(w, 0)(c - ū) the most
that the ceilings allow. A solution exists if and only if α' = 0 or C >= |α'|. The feasibility margin is

    max(v/α') min(1, C/|α'| - 1) where max(v/α') > 0, else max(v/α').

It is continuous, positive where a solution exists, and max(v/α') of (5.18) while the ceilings leave room for twice of
what is needed, so always without ceilings. It is infinite where α' = 0 (u = ū is the solution), zero where all ceilings
are used up exactly, which counts as infeasible, and -∞ where a ceiling lies below its threshold. Without thresholds
and ceilings the solutions are those of the lemma. `StringLimits` are the ceilings of real strings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.lanes import alone, select
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.strings import string_length
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure


@borrowing
def feasibility_margin(v: Any, alpha: float, floor: Any, ceiling: Any) -> float:
    """The margin of the module's text for v, ū and c (M,) and α."""
    rest = alpha
    for i in range(len(v)):
        rest -= v[i] * floor[i]
    return _margin(v, rest, floor, ceiling)


@borrowing
def _margin(v: Any, rest: float, floor: Any, ceiling: Any) -> float:
    need, sign = (rest, 1.0) if rest > 0.0 else (-rest, -1.0)
    best, capacity = -np.inf, 0.0
    for i in range(len(v)):
        if ceiling[i] < floor[i]:
            return -np.inf
        w = sign * v[i]
        best = max(best, w)
        if w > 0.0:
            capacity += w * (ceiling[i] - floor[i])
    if need == 0.0:
        return np.inf
    margin = best / need
    if margin > 0.0 and capacity < 2.0 * need:
        margin *= capacity / need - 1.0
    return margin


@alone(0.0)
def least_norm(v: Any, alpha: float, floor: Any, ceiling: Any, norm: float, u: Any) -> float:
    """Write the minimizer of ‖u‖_norm (norm 1, 2 or inf) into u and return the margin; u = ū where it is <= 0."""
    n = len(v)
    rest, highest = alpha, 0.0
    for i in range(n):
        u[i] = floor[i]
        rest -= v[i] * floor[i]
        highest = max(highest, floor[i])
    margin = _margin(v, rest, floor, ceiling)
    if rest == 0.0 or not margin > 0.0:
        return margin
    if norm == 1.0:
        _least_sum(v, rest, floor, ceiling, u)
    elif norm == 2.0:
        _least_squares(v, alpha, rest, floor, ceiling, u)
    else:
        _least_maximum(v, rest, highest, floor, ceiling, u)
    return margin


@inlined
def least_squares(v: Any, alpha: float, u: Any) -> float:
    """`least_norm` for norm 2 without thresholds and ceilings, part b) of the lemma: u = α v/Σv² over v of α's sign."""
    need, sign = select(alpha > 0.0, alpha, -alpha), select(alpha > 0.0, 1.0, -1.0)
    best, square = -np.inf, 0.0
    for i in range(len(v)):
        w = sign * v[i]
        best = max(best, w)
        square += max(w, 0.0) * max(w, 0.0)
    idle = (need == 0.0) | (not best > 0.0)
    mu = need / square
    for i in range(len(v)):
        u[i] = select(idle, 0.0, mu * max(sign * v[i], 0.0))
    return select(need == 0.0, np.inf, best / need)


@borrowing
def _least_sum(v: Any, rest: float, floor: Any, ceiling: Any, u: Any) -> None:
    # The most effective string first, each up to its ceiling. One pass a string that is filled; mostly that is one.
    sign = 1.0 if rest > 0.0 else -1.0
    n, need, last = len(v), sign * rest, -1
    while True:
        best = -1
        for i in range(n):
            # Strings in falling order of w, and of equal ones in their own order.
            after = last < 0 or sign * v[i] < sign * v[last] or (v[i] == v[last] and i > last)
            if after and sign * v[i] > 0.0 and (best < 0 or sign * v[i] > sign * v[best]):
                best = i
        if best < 0:
            return  # round-off at the last ceiling
        w = sign * v[best]
        room = w * (ceiling[best] - floor[best])
        if need <= room:
            u[best] = min(floor[best] + need / w, ceiling[best])
            return
        u[best] = ceiling[best]
        need -= room
        last = best


@borrowing
def _least_squares(v: Any, alpha: float, rest: float, floor: Any, ceiling: Any, u: Any) -> None:
    # The optimality conditions give u_i = min(max(ū_i, μ w_i), c_i) with w = v sign(α') and μ > 0. The sum of w_i u_i
    # grows with μ piecewise linearly: string i leaves its threshold at ū_i / w_i and meets its ceiling at c_i / w_i.
    sign = 1.0 if rest > 0.0 else -1.0
    n = len(v)
    resting = True
    for i in range(n):
        resting = resting and floor[i] == 0.0
    if resting:
        # Where no ceiling is reached, no breakpoint.
        least_squares(v, alpha, u)
        within = True
        for i in range(n):
            within = within and u[i] <= ceiling[i]
        if within:
            return
    # Between which breakpoints μ lies: each pass halves what is left of them, or nearly, about their mean.
    mu, beyond = 0.0, np.inf
    while True:
        count, total, least, most = 0, 0.0, np.inf, 0.0
        for i in range(n):
            w = sign * v[i]
            if w > 0.0:
                for point in (floor[i] / w, ceiling[i] / w):
                    if mu < point < beyond:
                        count += 1
                        total += point
                        least, most = min(least, point), max(most, point)
        if count == 0:
            break
        middle = min(max(total / count, least), most)
        given = 0.0
        for i in range(n):
            w = sign * v[i]
            given += w * (min(max(floor[i], middle * w), ceiling[i]) if w > 0.0 else floor[i])
        if given >= sign * alpha:
            beyond = middle
        else:
            mu = middle
    slope, given = 0.0, 0.0
    for i in range(n):
        w = sign * v[i]
        if w > 0.0 and floor[i] / w <= mu < ceiling[i] / w:
            slope += w * w
        elif w > 0.0 and ceiling[i] / w <= mu:
            given += w * ceiling[i]
        else:
            given += w * floor[i]
    if slope > 0.0:
        mu = (sign * alpha - given) / slope
    for i in range(n):
        u[i] = min(max(floor[i], mu * sign * v[i]), ceiling[i])


@borrowing
def _least_maximum(v: Any, rest: float, highest: float, floor: Any, ceiling: Any, u: Any) -> None:
    # Raise every helpful string to one common level y or its ceiling; below the highest threshold the level is not
    # unique, and the part of the way that suffices is taken.
    sign = 1.0 if rest > 0.0 else -1.0
    n, need, slack = len(v), sign * rest, 0.0
    for i in range(n):
        if sign * v[i] > 0.0:
            slack += sign * v[i] * (min(highest, ceiling[i]) - floor[i])
    if need <= slack:
        for i in range(n):
            if sign * v[i] > 0.0:
                u[i] = floor[i] + (min(highest, ceiling[i]) - floor[i]) * (need / slack)
        return
    # `given` is concave in the level, so that Newton's steps rise to the solution and never beyond: each but the
    # last passes a ceiling. Mostly there is one.
    level = highest
    while True:
        gain, given, top = 0.0, 0.0, np.inf
        for i in range(n):
            w = sign * v[i]
            if w > 0.0:
                if ceiling[i] > level:
                    gain += w
                    given += w * (level - floor[i])
                    top = min(top, ceiling[i])
                else:
                    given += w * (ceiling[i] - floor[i])
        if gain == 0.0:
            break  # round-off at the last ceiling
        level += (need - given) / gain
        if level <= top:
            break
    for i in range(n):
        if sign * v[i] > 0.0:
            u[i] = min(level, ceiling[i])


@alone(None)
def write_ceilings(nodes: Any, segments: Any, ranges: Any, limits: Any, out: Any) -> None:
    """Write the ceilings at node positions (N, 3) into out (M,); limits are the rows of `StringLimits.packed`."""
    for m in range(len(ranges)):
        highest, k, shortest = limits[0, m], limits[1, m], limits[2, m]
        if shortest > -np.inf:
            length = string_length(nodes, segments, ranges[m])
            highest = min(highest, max(k * (1.0 - shortest / length), 0.0))
        out[m] = highest


@dataclass(frozen=True, eq=False)
class StringLimits:
    """Ceilings of the strings' force densities, min(u_max, k (1 - L0_min/L)) and at least 0.

    A string shorter than its smallest rest length hangs slack, whence u = 0.

    Attributes:
        structure: whose strings.
        max_force_density: u_max (M,) [N/m], ∞ where there is none.
        min_rest_length: L0_min (M,) [m], -∞ where there is none.
    """

    structure: Structure
    max_force_density: Array
    min_rest_length: Array

    @classmethod
    def of(cls, structure: Structure, maximum: ArrayLike = np.inf, respect_strings: bool = True) -> StringLimits:
        """A law's own ceiling u_max, a number or (M,), and the strings' own limits where they are to be respected.

        Raises:
            OptionError: for a ceiling that is not >= 0, or of another shape.
        """
        size = len(structure.strings)
        try:
            if np.ndim(maximum) and np.shape(maximum) != (size,):
                raise ValueError
            highest = np.broadcast_to(np.asarray(maximum, float), (size,))
            if not np.all(highest >= 0):
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            raise OptionError(
                f"maximum_force_density = {maximum!r}; it must be a number >= 0 or an array of shape ({size},) [N/m], "
                "inf for no limit"
            ) from None
        if not respect_strings:
            return cls(structure, np.array(highest), np.full(size, -np.inf))
        return cls(
            structure,
            np.minimum(highest, structure.limits("max_force_density")),
            structure.limits("min_rest_length"),
        )

    @property
    def of_state(self) -> bool:
        """True where the ceilings depend on the strings' lengths."""
        return bool(np.any(self.min_rest_length > -np.inf))

    @cached_property
    def packed(self) -> Array:
        """u_max, k and L0_min as rows (3, M), for compiled code."""
        return np.array([self.max_force_density, self.structure.stiffness, self.min_rest_length])

    def ceilings(self, nodes: Array) -> Array:
        """The largest admissible u (M,) [N/m] at node positions (N, 3) [m]."""
        out = np.empty(len(self.structure.strings))
        paths = self.structure.paths
        write_ceilings(np.asarray(nodes, float), paths.nodes, paths.ranges, self.packed, out)
        return out
