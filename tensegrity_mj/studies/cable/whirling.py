"""Whirling: how a motion leaves the plane that it is excited in, and goes around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.errors import OptionError

SATURATED = 0.1  # of the motion in the plane: beyond it growth out of the plane is no longer its own
NOTHING = 1e-12  # of the motion in the plane: round-off


@dataclass(frozen=True)
class Whirl:
    """How a marker moves out of the plane.

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
