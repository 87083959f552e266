"""One unit an axis: what labels of axes, and heads of tables, may end in."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from tensegrity_mj.basics.units import PREFIXED, PREFIXES

# Units without prefixes of their own; of a label that is prefixed, powers of ten stand before them.
PLAIN = ("1", "rad", "rad/s", "1/s", "1/s²", "kg", "kN/m", "ms", "MB", "samples", "°")
FACTOR = re.compile(r"10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+ ?")
FORCES = ("N", "Pa")


def base_of(unit: str) -> str:
    """The unit without its prefix; AssertionError for what is no unit, or a prefix before none."""
    for base in PREFIXED:
        if unit.endswith(base) and unit.removesuffix(base) in PREFIXES.values():
            return base
    plain = FACTOR.sub("", unit)
    assert plain in PLAIN or f"1{plain}" in PLAIN or not plain, f"[{unit}] is no unit"
    return plain


def unit_of(label: str) -> str:
    """What a label ends in, in brackets, or ""; AssertionError for two units."""
    found = re.findall(r"\[([^\[\]]*)\]", label)
    assert len(found) <= 1, f"{label!r} has {len(found)} units"
    assert not found or label.endswith("]"), f"{label!r} goes on after its unit, which gets no prefix"
    return found[0] if found else ""


def check_panels(figure: Any) -> set[str]:
    """Check every axis of a figure, laid out; the units of its linear axes of forces."""
    figure.draw_without_rendering()
    forces = set()
    for panel in figure.axes:
        for axis in (panel.xaxis, panel.yaxis):
            unit = unit_of(axis.label.get_text())
            if unit and base_of(unit) in FORCES and axis.get_scale() == "linear":
                forces.add(unit)
    return forces


def check_one_prefix(units: Iterable[str]) -> None:
    """No N beside kN, and no Pa beside MPa."""
    for base in FORCES:
        found = {unit for unit in units if unit and base_of(unit) == base}
        assert len(found) <= 1, f"one page has {sorted(found)}"
