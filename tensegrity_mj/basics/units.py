"""Numbers with their units as people write them: 1.2 kN and 4.5 mm, not 1.2e+03 N and 0.0045 m."""

from __future__ import annotations

import math

PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
PREFIXED = ("N", "m", "J", "Pa", "W", "s", "Hz", "N/m", "m/s", "N m", "B")  # kg has a prefix already, 1/s² none
LEAST = 0.1  # what is smaller gets a prefix


def power_of(largest: float, unit: str, digits: int = 3) -> int:
    """The power of ten, a multiple of three, that numbers up to `largest` in `unit` are best written in.

    Units without prefixes keep theirs up to 10⁴. A second has no multiples.
    """
    size = abs(largest)
    if not (math.isfinite(size) and size > 0.0):
        return 0
    if unit not in PREFIXED:
        return 0 if 1e-3 <= size < 1e4 else 3 * math.floor(math.log10(size) / 3.0)
    if LEAST <= size < 1e3 or (unit == "s" and size >= 1.0):
        return 0
    # 999.99 in three digits is 1000.
    return min(9, max(-12, 3 * math.floor(math.log10(size * (1.0 + 0.5 * 10.0**-digits)) / 3.0)))


def unit_with(power: int, unit: str) -> str:
    """The unit times 10^power: "kN", "10³/s²"."""
    if power == 0:
        return unit
    if unit in PREFIXED:
        return PREFIXES[power] + unit
    factor = "10" + str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{factor}{unit.removeprefix('1')}" if unit.startswith("1") else f"{factor} {unit}".rstrip()


def quantity(value: float, unit: str = "", digits: int = 3) -> str:
    """Format a number as text: at most `digits` digits and a unit with its prefix; a dash for NaN."""
    if math.isnan(value):
        return "–"
    if unit == "kg" and 1e-12 < abs(value) < LEAST:
        value, unit = 1e3 * value, "g"
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g} {unit}".replace("inf", "∞").rstrip()
    if unit not in PREFIXED or abs(value) < 1e-12 or abs(value) >= 1e13:
        return f"{value:.{digits}g} {unit}".rstrip()
    power = power_of(value, unit, digits)
    scaled = value / 10.0**power
    # Of a number before the point, all digits: 1234 s are no 1.23e+03 s.
    text = f"{scaled:.{digits}g}" if abs(scaled) < 10.0**digits * (1.0 - 0.5 * 10.0**-digits) else f"{scaled:.0f}"
    return f"{text} {unit_with(power, unit)}"
