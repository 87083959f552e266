"""Closest points of two straight segments, compiled: exact for skew, parallel, touching, crossing and pointlike ones.

With w = a - c, u = b - a and v = d - c the points a + s u and c + t v are |w + s u - t v| apart, and s and t lie within
[0, 1]. This is least inside both segments, where the line between the points is normal to both,

    s = -((w × v) · n) / |n|²,      t = -((w × u) · n) / |n|²,      n = u × v

or at one of the four ends. All five are tried. Cross products lose no digits to cancellation where the segments are
nearly parallel, and where s and t are beyond all precision there, an end is as near.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
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
