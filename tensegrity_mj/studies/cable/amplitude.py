"""The maximum response amplitude of §3.3.4: the largest distance of two successive peaks of a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError


@dataclass(frozen=True, eq=False)
class Extremes:
    """The maxima and minima of a motion between its first and its last sample, which alternate.

    Attributes:
        time: (E,) [s].
        value: (E,) [m].
    """

    time: Array
    value: Array

    @property
    def amplitude(self) -> float:
        """The largest peak-to-peak distance of two that follow each other [m]; 0 where there are less than two."""
        return float(np.abs(np.diff(self.value)).max(initial=0.0))


def extremes(time: ArrayLike, values: ArrayLike, rates: ArrayLike) -> Extremes:
    """Where a motion turns back.

    A sign of the rate that changes between two samples marks an extreme, which is that of the cubic with the values and
    rates of both: its value is off by (ω h)⁴/384 of an amplitude of angular frequency ω, h between samples.

    Args:
        time: (T,) [s], increasing.
        values: (T,) [m].
        rates: (T,) [m/s].

    Raises:
        OptionError: for arrays of other shapes, times that do not increase, or numbers that are not finite.
    """
    t, x, v = _series("time", time), _series("values", values), _series("rates", rates)
    if not len(t) == len(x) == len(v) or np.any(np.diff(t) <= 0):
        raise OptionError(
            f"extremes: {len(t)} times, {len(x)} values and {len(v)} rates; they must be as many, at increasing times"
        )
    k = _turns(v)
    h, x0, x1, v0, v1 = t[k + 1] - t[k], x[k], x[k + 1], v[k], v[k + 1]
    # Hermite's cubic on [0, 1] has the slope a s² + b s + c, whose ends have different signs: one root lies between.
    a = 6.0 * (x0 - x1) + 3.0 * h * (v0 + v1)
    b = -6.0 * (x0 - x1) - h * (4.0 * v0 + 2.0 * v1)
    c = h * v0
    s = _root(a, b, c)
    value = x0 + s * (c + s * (0.5 * b + s * a / 3.0))
    return Extremes(t[k] + s * h, value)


def response_amplitude(time: ArrayLike, values: ArrayLike, rates: ArrayLike) -> float:
    """A_i of §3.3.4 [m]: `Extremes.amplitude` of `extremes`."""
    return extremes(time, values, rates).amplitude


def _series(what: str, values: ArrayLike) -> Array:
    array = np.asarray(values, float)
    if array.ndim != 1 or not np.all(np.isfinite(array)):
        raise OptionError(f"extremes: {what} has shape {array.shape}; it must be (T,), all finite")
    return array


def _turns(slopes: Array) -> NDArray[np.int64]:
    """k where the sign of the slopes changes from k to k + 1; zeros keep the sign before them."""
    sign = np.sign(slopes)
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(sign)), 0))
    sign = sign[last]
    return np.flatnonzero(sign[:-1] * sign[1:] < 0)


def _root(a: Array, b: Array, c: Array) -> Array:
    """The root of a s² + b s + c in [0, 1], of which there is one."""
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(np.maximum(b * b - 4.0 * a * c, 0.0)), b))
        first, second = q / a, c / q
    # Of the two, the one that lies within; the other may be infinite, or not a number where a or q is zero.
    off = [np.where(np.isnan(one), np.inf, np.abs(one - 0.5)) for one in (first, second)]
    return np.clip(np.where(off[0] < off[1], first, second), 0.0, 1.0)
