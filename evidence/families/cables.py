"""Cables of the thesis' chapter 3: their numbers of elements, and the procedure of §3.6 that chooses one.

scene = cable(elements=refined(4))          # 49 elements, in-line 0.5 Hz
K = suggest_elements(0.8, 2.93).elements
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tensegrity_mj.basics.checks import positive, whole
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import GRAVITY

MARKERS = tuple(0.25 * number for number in range(2, 12))  # Table 3.2: [m] from the top of the rope


@dataclass(frozen=True)
class Elements:
    """Number of equal elements that a cable is to have.

    Attributes:
        elements: K.
        length: length of one element [m].
        frequency: at which one of them swings by itself [Hz], (3.28).
    """

    elements: int
    length: float
    frequency: float


def pendulum_frequency(length: float, gravity: float = GRAVITY) -> float:
    """f [Hz] of a uniform rod [m] that swings about its end by little, (3.28): √(3 g / 2 ℓ) / 2π.

    Raises:
        OptionError: for numbers that are not > 0.
    """
    ratio = positive("gravity", gravity, "m/s²") / positive("length", length, "m")
    return math.sqrt(1.5 * ratio) / (2 * math.pi)


def suggest_elements(frequency: float, length: float, ratio: float = 2.0, gravity: float = GRAVITY) -> Elements:
    """The fewest equal elements of a cable that swing by themselves well above an excitation: the procedure of §3.6.

    Args:
        frequency: frequency of the excitation [Hz].
        length: length of the cable [m].
        ratio: how many times above the excitation an element's own frequency is to be, at least; the thesis recommends
            slightly more than two.
        gravity: [m/s²].

    Raises:
        OptionError: for numbers that are not > 0, or that need more than a million elements.
    """
    least = positive("ratio", ratio) * positive("frequency", frequency, "Hz")
    positive("length", length, "m")
    # (3.28) for ℓ: the frequency of a rod of 1 m, squared, over that of the element, squared.
    longest = (pendulum_frequency(1.0, gravity) / least) ** 2
    if not length / longest <= 1e6:
        raise OptionError(
            f"frequency = {frequency!r} Hz, length = {length!r} m: elements of {longest:.3g} m would be more than a "
            "million; request a lower frequency or ratio"
        )
    # A quotient that is whole up to round-off is whole: elements of exactly `longest` will do.
    count = max(1, math.ceil(length / longest * (1 - 1e-12)))
    return Elements(count, length / count, pendulum_frequency(length / count, gravity))


def refined(divisions: int) -> int:
    """K of §3.5.1: every element of the thirteen but the bottom load divided by 1, 2, ..., 10: 13, 25, ..., 121.

    Raises:
        OptionError: if that is no integer >= 1.
    """
    return 12 * whole("cable: divisions", divisions, 1) + 1
