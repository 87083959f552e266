"""The maximum response amplitude of §3.3.4: the largest distance of two successive peaks of a motion.

A whirling motion leaves the plane that it is excited in, and goes around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive
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
    """Find the extremes of a motion, at which it turns back.

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
    """A_i of §3.3.4 [m], the largest distance of two successive peaks: `Extremes.amplitude` of `extremes`.

    Args:
        time, values, rates: (T,) [s], [m] and [m/s] of one component of a point, from the first time on that counts.
    """
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


SATURATED = 0.1  # of the motion in the plane: beyond it growth out of the plane is no longer its own
NOTHING = 1e-12  # of the motion in the plane: round-off


@dataclass(frozen=True)
class Whirl:
    """Motion of a marker out of the plane.

    Attributes:
        growth: [1/s] at which the amplitude out of the plane grows while it is small; NaN where it is never. What is
            there from the start, such as the swing of a seed, counts: choose it far below the motion in the plane.
        gain: the largest amplitude out of the plane over that of the first window.
        turning: of the last third of the run: 0 along a line, ±1 around a circle, for an ellipse of half axes a and b
            2 a b / (a² + b²); positive from the first horizontal axis to the second.
    """

    growth: float
    gain: float
    turning: float


def whirl(
    time: ArrayLike,
    in_plane: ArrayLike,
    out_of_plane: ArrayLike,
    window: float,
    rates: tuple[ArrayLike, ArrayLike],
) -> Whirl:
    """Measure the whirling of one marker.

    Args:
        time: (T,) [s], increasing.
        in_plane, out_of_plane: (T,) [m].
        window: [s] over which amplitudes are taken, such as a period of the excitation.
        rates: of both [m/s].

    Raises:
        OptionError: for arrays of other shapes, or a window that fits less than twice into the run.
    """
    t = np.asarray(time, float)
    motion = np.stack([np.asarray(in_plane, float), np.asarray(out_of_plane, float)])
    if t.ndim != 1 or motion.shape != (2, len(t)) or len(t) < 4:
        raise OptionError(f"whirl: times {t.shape} and motions {motion.shape[1:]}; they must be (T,), T >= 4")
    length = positive("whirl: window", window, "s")
    count = int((t[-1] - t[0]) / length * (1 + 1e-9))
    if count < 2:
        raise OptionError(f"whirl: a window of {length:g} s fits less than twice into {t[-1] - t[0]:g} s")
    velocity = np.stack([np.asarray(one, float) for one in rates])
    amplitude = _amplitudes(t, motion, length, count)
    out = amplitude[1]
    gain = float(out.max() / out[0]) if out[0] > 0 else float("nan")
    return Whirl(_growth(amplitude, length), gain, _turning(t, motion, velocity))


def _amplitudes(t: Array, motion: Array, length: float, count: int) -> Array:
    """(2, W) half the range of each component in each window."""
    number = np.minimum(((t - t[0]) / length).astype(int), count - 1)
    edges = np.searchsorted(number, np.arange(count))
    high, low = (np.stack([f.reduceat(one, edges) for one in motion]) for f in (np.maximum, np.minimum))
    return 0.5 * (high - low)


def _growth(amplitude: Array, length: float) -> float:
    """Slope of the logarithm up to the largest amplitude, over the windows in which it is small but not nothing."""
    plane, out = amplitude[0].max(), amplitude[1]
    until = int(np.argmax(out)) + 1
    small = np.flatnonzero((out[:until] < SATURATED * plane) & (out[:until] > NOTHING * plane))
    if len(small) < 3:
        return float("nan")
    return float(np.polyfit(small * length, np.log(out[small]), 1)[0])


def _turning(t: Array, motion: Array, velocity: Array) -> float:
    last = t >= t[-1] - (t[-1] - t[0]) / 3.0
    x, y = motion[:, last] - motion[:, last].mean(axis=1, keepdims=True)
    vx, vy = velocity[:, last] - velocity[:, last].mean(axis=1, keepdims=True)
    size = float(np.sqrt(np.mean(x * x + y * y) * np.mean(vx * vx + vy * vy)))
    return float(np.mean(x * vy - y * vx)) / size if size > 0 else 0.0
