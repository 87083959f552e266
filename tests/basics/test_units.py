"""Numbers as people write them: digits, units, prefixes."""

from __future__ import annotations

import math

import pytest

from tensegrity_mj.basics.units import power_of, quantity, unit_with


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1234.0, "N", "1.23 kN"),
        (999.99, "N", "1000 N"),
        (-1234.0, "N", "-1.23 kN"),
        (0.0045, "m", "4.5 mm"),
        (1.4e-9, "m", "1.4 nm"),
        (0.155, "N/m", "0.155 N/m"),
        (0.0, "m", "0 m"),
        (3600.0, "s", "3600 s"),
        (1e-3, "s", "1 ms"),
        (2e-15, "m", "2e-15 m"),
        (0.0129, "kg", "12.9 g"),
        (12.9, "kg", "12.9 kg"),
        (0.25, "", "0.25"),
        (math.nan, "m", "–"),
        (math.inf, "N", "∞ N"),
    ],
)
def test_quantities_have_prefixes(value, unit, text):
    assert quantity(value, unit) == text


def test_units_without_prefixes_get_powers_of_ten():
    assert power_of(13_000.0, "1/s²") == 3
    assert unit_with(3, "1/s²") == "10³/s²"
    assert power_of(500.0, "1/s²") == 0
    assert unit_with(-6, "kg") == "10⁻⁶ kg"
