"""The colours of all pictures: red, green and blue from 0 to 1."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Color = tuple[float, float, float]

BACKGROUND: Color = (0.973, 0.976, 0.980)
TEXT: Color = (0.13, 0.15, 0.18)
FAINT_TEXT: Color = (0.42, 0.45, 0.50)
WARNING: Color = (0.75, 0.10, 0.10)
FLOOR: Color = (0.80, 0.825, 0.85)
FLOOR_LINE: Color = (0.93, 0.94, 0.95)
SHADE: Color = (0.16, 0.18, 0.21)
GRID: Color = (0.86, 0.875, 0.89)
WATER: Color = (0.32, 0.62, 0.84)
WATER_LINE: Color = (0.10, 0.36, 0.60)
ROD: Color = (0.33, 0.37, 0.43)
SUPPORT: Color = (0.10, 0.11, 0.13)
GUIDE: Color = (0.55, 0.58, 0.62)
POINT_MASS: Color = (0.80, 0.58, 0.13)
SLACK: Color = (0.10, 0.62, 0.60)
TARGET: Color = (0.20, 0.66, 0.33)
GHOST: Color = (0.16, 0.44, 0.90)
AXES: tuple[Color, Color, Color] = ((0.82, 0.20, 0.18), (0.20, 0.60, 0.22), (0.16, 0.36, 0.80))

# The thesis' order for rods and strings: blue, green, red, and four more: those of Okabe and Ito, which readers who do
# not see all colours can distinguish. Curves differ by `STYLES` too, which stay in grey print.
CYCLE: tuple[Color, ...] = (
    (0.000, 0.447, 0.698),
    (0.000, 0.620, 0.451),
    (0.835, 0.369, 0.000),
    (0.337, 0.706, 0.914),
    (0.680, 0.380, 0.560),
    (0.902, 0.624, 0.000),
    (0.000, 0.000, 0.000),
)
BAND: Color = (0.84, 0.85, 0.865)  # of curves without names

STYLES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (5, 1.4, 1.2, 1.4)), (0, (9, 2)))
MARKERS = "osv^DPX"


def color_of(number: int) -> Color:
    """The colour of the curve of that number."""
    return CYCLE[number % len(CYCLE)]


def look_of(number: int) -> tuple[Color, Any]:
    """Colour and line style of the curve of that number; 35 in a row differ in one of the two, neighbours in both."""
    return color_of(number), STYLES[number % len(STYLES)]


def marker_of(number: int) -> str:
    """The mark on the curve of that number, where line styles mean something else."""
    return MARKERS[number % len(MARKERS)]


# Tension from none to the largest: dark blue, violet, red, orange. It gets lighter all the way, so that it also reads
# in grey, and stays clear of the background.
_RAMP = np.array(
    [
        [0.17, 0.20, 0.62],
        [0.45, 0.16, 0.68],
        [0.74, 0.16, 0.52],
        [0.91, 0.30, 0.32],
        [0.98, 0.56, 0.14],
    ]
)


def tension_colors(fraction: ArrayLike) -> NDArray[np.float32]:
    """Colours (..., 3) of tensions given as a fraction of the scale's end; beyond it, the end's."""
    position = np.clip(np.asarray(fraction, float), 0.0, 1.0) * (len(_RAMP) - 1)
    low = np.minimum(position.astype(int), len(_RAMP) - 2)
    weight = (position - low)[..., None]
    return ((1.0 - weight) * _RAMP[low] + weight * _RAMP[low + 1]).astype(np.float32)


@dataclass(frozen=True)
class TensionScale:
    """The colour scale of string tension: from 0 to `end` [N].

    Attributes:
        end: a round number [N].
        exceeded: whether some tension lies beyond it, as a short peak may.
    """

    end: float
    exceeded: bool = False

    @classmethod
    def of(cls, tensions: NDArray[np.float64]) -> TensionScale:
        """The scale for all tensions of a film, any shape [N].

        It ends at the largest, unless that is a rare peak (above three times what 99 % stay below).
        """
        values = tensions[tensions > 0.0]
        if values.size == 0:
            return cls(1.0)
        largest, usual = float(np.max(values)), float(np.quantile(values, 0.99))
        end = round_up(usual if largest > 3.0 * usual else largest)
        return cls(end, largest > end * (1.0 + 1e-6))

    def colors(self, tensions: NDArray[np.float64]) -> NDArray[np.float32]:
        """Colours (..., 3) of tensions (...) [N]."""
        return tension_colors(tensions / self.end)


def round_up(value: float, steps: tuple[float, ...] = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)) -> float:
    """The next number of the form step · 10ⁿ that is at least `value` > 0."""
    exponent = math.floor(math.log10(value))
    for step in (*steps, 10.0 * steps[0]):
        # Division by a power of ten rounds once, so that 0.15 is 0.15.
        candidate = step * 10.0**exponent if exponent >= 0 else step / 10.0**-exponent
        if candidate >= value * (1.0 - 1e-9):
            return candidate
    raise AssertionError(f"{value} has no decimal exponent")


def mixed(color: Color, other: Color, weight: float) -> Color:
    """`color` with the share `weight` of `other`."""
    r, g, b = ((1.0 - weight) * x + weight * y for x, y in zip(color, other, strict=True))
    return (r, g, b)


def to_bytes(color: Color) -> tuple[int, int, int]:
    """Return the color as bytes, for Pillow."""
    r, g, b = (round(255 * c) for c in color)
    return (r, g, b)
