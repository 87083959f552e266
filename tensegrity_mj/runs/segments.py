"""Closest points of two straight segments, standing or moving between two samples, compiled: exact for all kinds.

With w = a - c, u = b - a and v = d - c the points a + s u and c + t v are |w + s u - t v| apart, and s and t lie within
[0, 1]. This is least inside both segments, where the line between the points is normal to both,

    s = -((w × v) · n) / |n|²,      t = -((w × u) · n) / |n|²,      n = u × v

or at one of the four ends. All five are tried. Cross products lose no digits to cancellation where the segments are
nearly parallel, and where s and t are beyond all precision there, an end is as near.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.dynamics.native.compiling import njit
from tensegrity_mj.dynamics.native.vectors import cross, dot, minus, plus, row_of, times
from tensegrity_mj.errors import OptionError


@njit
def within(x: float) -> float:
    """x, kept within [0, 1]."""
    return min(max(x, 0.0), 1.0)


@njit
def closest(w: tuple, u: tuple, v: tuple) -> tuple[float, float, float]:  # type: ignore[type-arg]
    """(D, s, t): the least squared distance [m²] of w + s u - t v from zero, and where it is."""
    uu, vv, uv, uw, vw = dot(u, u), dot(v, v), dot(u, v), dot(u, w), dot(v, w)
    best, s_best, t_best = np.inf, 0.0, 0.0
    n = cross(u, v)
    nn = dot(n, n)
    for case in range(5):
        if case == 0:
            if nn <= 0.0:
                continue
            s = within(-dot(cross(w, v), n) / nn)
            t = within(-dot(cross(w, u), n) / nn)
        elif case < 3:
            s = float(case - 1)
            t = within((vw + s * uv) / vv) if vv > 0.0 else 0.0
        else:
            t = float(case - 3)
            s = within((t * uv - uw) / uu) if uu > 0.0 else 0.0
        x = minus(plus(w, times(s, u)), times(t, v))
        D = dot(x, x)
        if best > D:
            best, s_best, t_best = D, s, t
    return best, s_best, t_best


@njit
def _closest_of_all(w: Array, u: Array, v: Array, out: Array) -> None:
    for i in range(len(w)):
        D, s, t = closest(row_of(w, i), row_of(u, i), row_of(v, i))
        out[i, 0], out[i, 1], out[i, 2] = np.sqrt(D), s, t


def closest_points(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> tuple[Array, Array, Array]:
    """Distances of segments from a to b from those from c to d, and where: (distance [m], s, t), each (...).

    The closest points are a + s (b - a) and c + t (d - c); of parallel segments one pair of many. The four arrays
    (..., 3) broadcast against each other.

    Raises:
        OptionError: if they do not, or if a last axis is not of length 3.
    """
    try:
        ends = np.broadcast_arrays(*(np.asarray(x, float) for x in (a, b, c, d)))
        if ends[0].shape[-1:] != (3,):
            raise ValueError(f"their shape is {ends[0].shape}")
    except (TypeError, ValueError) as error:
        raise OptionError(f"ends of segments must be arrays (..., 3) that broadcast; {error}") from None
    shape = ends[0].shape[:-1]
    first, second, third, fourth = (np.ascontiguousarray(x).reshape(-1, 3) for x in ends)
    out = np.empty((len(first), 3))
    _closest_of_all(first - third, second - first, fourth - third, out)
    distance, s, t = (out[:, column].reshape(shape) for column in range(3))
    return distance, s, t


Ends = tuple[int, int, int, int]


class Motion(NamedTuple):
    """A motion as the searches read it: N nodes and E elements at T samples, two or more.

    Attributes:
        P, V: (N, T, 3) [m], [m/s] seen from the mean of all nodes.
        time: (T,) [s].
        way: (E, T) of `paths`.
    """

    P: Array
    V: Array
    time: Array
    way: Array


class Between(NamedTuple):
    """Two elements between a sample and the next.

    Attributes:
        P, V: of `Motion`.
        ends: their four nodes.
        k: the first sample.
        h: [s] to the next.
    """

    P: Array
    V: Array
    ends: Ends
    k: int
    h: float


@njit
def between(motion: Motion, ends: Ends, k: int) -> Between:
    """The elements with these nodes in the interval that begins at the sample k."""
    return Between(motion.P, motion.V, ends, k, motion.time[k + 1] - motion.time[k])


@njit
def point(P: Array, V: Array, n: int, k: int, h: float, x: float) -> tuple[float, float, float]:
    """Node n at the part x of the interval k, of length h: its cubic."""
    y = 1.0 - x
    p0, p1 = y * y * (1.0 + 2.0 * x), x * x * (3.0 - 2.0 * x)
    v0, v1 = h * x * y * y, -h * x * x * y
    placed = plus(times(p0, row_of(P[n], k)), times(p1, row_of(P[n], k + 1)))
    return plus(plus(placed, times(v0, row_of(V[n], k))), times(v1, row_of(V[n], k + 1)))


@njit
def sides(piece: Between, x: float) -> tuple:  # type: ignore[type-arg]
    """(w, u, v) of two segments with these four nodes, see `segments`."""
    P, V, ends, k, h = piece
    a, b = point(P, V, ends[0], k, h, x), point(P, V, ends[1], k, h, x)
    c, d = point(P, V, ends[2], k, h, x), point(P, V, ends[3], k, h, x)
    return minus(a, c), minus(b, a), minus(d, c)


@njit
def moving(piece: Between, x: float) -> tuple[float, float, float]:
    """(D, s, t) at the part x of the interval."""
    w, u, v = sides(piece, x)
    return closest(w, u, v)


@njit
def distance(piece: Between, x: float) -> float:
    """Distance at the part x of the interval [m]."""
    return sqrt(moving(piece, x)[0])


@njit
def at_sample(motion: Motion, ends: Ends, k: int) -> float:
    """Distance at the sample k [m], where the cubics are exact."""
    number = min(k, len(motion.time) - 2)
    return distance(between(motion, ends, number), float(k - number))


@njit
def motion_bounds(piece: Between) -> tuple[float, float]:
    """V and A: the largest first and second derivatives of the four corners' cubics by the part of the interval."""
    P, V, ends, k, h = piece
    speed, bend = 0.0, 0.0
    for i in range(2):
        for j in range(2, 4):
            m, n = ends[i], ends[j]
            q0, q1, q2, s0, s1 = 0.0, 0.0, 0.0, 0.0, 0.0
            for axis in range(3):
                v0 = h * (V[m, k, axis] - V[n, k, axis])
                v1 = h * (V[m, k + 1, axis] - V[n, k + 1, axis])
                moved = (P[m, k + 1, axis] - P[n, k + 1, axis]) - (P[m, k, axis] - P[n, k, axis])
                middle = 3.0 * moved - v0 - v1
                q0 += v0 * v0
                q1 += middle * middle
                q2 += v1 * v1
                s0 += (2.0 * (middle - v0)) ** 2
                s1 += (2.0 * (v1 - middle)) ** 2
            speed = max(speed, q0, q1, q2)
            bend = max(bend, s0, s1)
    return sqrt(speed), sqrt(bend)


@njit
def lower_bound(left: float, right: float, width: float, speed: float, bend: float, reach: float) -> float:
    """Lower bound of the distance over a stretch, from those at its ends, as far as it falls below `reach` at all."""
    K = 2.0 * speed * speed + 2.0 * (reach + speed * width) * bend
    K *= width * width
    low, high = left * left, right * right
    if K <= 0.0 or abs(low - high) >= 0.5 * K:
        return min(left, right)
    D = 0.5 * (low + high) - 0.125 * K - 0.5 * (low - high) ** 2 / K
    return sqrt(D) if D > 0.0 else 0.0


@njit
def paths(P: Array, V: Array, time: Array, pairs: IntArray, out: Array) -> None:
    """Write to out (E, T) a bound of the distance [m] that any point of an element has travelled up to each sample."""
    for e in range(len(pairs)):
        total = 0.0
        out[e, 0] = 0.0
        for k in range(len(time) - 1):
            h = time[k + 1] - time[k]
            longest = 0.0
            for end in range(2):
                n = pairs[e, end]
                l0, l1, l2 = 0.0, 0.0, 0.0
                for axis in range(3):
                    v0, v1 = h * V[n, k, axis] / 3.0, h * V[n, k + 1, axis] / 3.0
                    middle = P[n, k + 1, axis] - P[n, k, axis] - v0 - v1
                    l0 += v0 * v0
                    l1 += middle * middle
                    l2 += v1 * v1
                longest = max(longest, sqrt(l0) + sqrt(l1) + sqrt(l2))
            total += longest
            out[e, k + 1] = total


@njit
def interval_of(time: Array, when: float) -> int:
    """The interval between two samples that a time is in, or is nearest to."""
    before = int(np.searchsorted(time, when, side="right")) - 1
    return min(max(before, 0), len(time) - 2)
