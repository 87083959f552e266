"""Quantities in which two runs may differ: one table for comparisons, commands, plots and pages."""

from __future__ import annotations

from typing import NamedTuple

from tensegrity_mj.basics.files import table_beside


class Difference(NamedTuple):
    """A quantity that two runs may differ in: what its error is called, what it is of, and the unit of both."""

    words: str
    of: str
    unit: str


DIFFERENCES = {name: Difference(*row) for name, row in table_beside(__file__).items()}
UNITS = tuple(dict.fromkeys(difference.unit for difference in DIFFERENCES.values()))
