"""The measures of the ledger by their names: functions of the modules below, each named once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from inspect import getmembers, isfunction
from typing import Any

from tensegrity_mj.errors import OptionError
from tensegrity_mj.reproduction import (
    measures,
    measures3,
    measures4,
    measures5,
    measures6,
    measures7,
    measures_c,
    measures_c2,
)

MODULES = (measures, measures3, measures4, measures5, measures6, measures7, measures_c, measures_c2)


@cache
def all_measures() -> Mapping[str, Callable[..., Any]]:
    """Every public function of the modules of measures, by its name."""
    found: dict[str, Callable[..., Any]] = {}
    for module in MODULES:
        for name, function in getmembers(module, isfunction):
            if name.startswith("_") or function.__module__ != module.__name__:
                continue
            assert name not in found, f"{name} is the name of two measures"
            found[name] = function
    return found


def measure_named(name: str) -> Callable[..., Any]:
    """A measure by its name.

    Raises:
        OptionError: for a name that is none.
    """
    if name not in all_measures():
        raise OptionError(f"measure {name!r}: there is none of that name in the modules of measures")
    return all_measures()[name]
