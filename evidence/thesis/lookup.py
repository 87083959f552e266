"""The measures of the ledger: functions of the modules below, each named once, and expressions of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from inspect import getmembers, isfunction
from typing import Any

from evidence.thesis import measures
from evidence.thesis.appendix_c import measures_c
from evidence.thesis.chapter3 import measures3
from evidence.thesis.chapter7 import measures7
from evidence.thesis.expression import compiled, evaluate
from evidence.thesis.statement import Runs, Statement
from tensegrity_mj.errors import OptionError

MODULES = (measures, measures3, measures7, measures_c)


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


def measured(statement: Statement, runs: Runs) -> float:
    """Our value of a statement, of the runs of one engine.

    Raises:
        OptionError: for a measure that is none.
    """
    measures, text = all_measures(), statement.measure
    if text in measures:
        return float(measures[text](*(runs[name] for name in statement.needs), **statement.arguments))
    try:
        compiled(text, tuple(measures))
    except ValueError as error:
        raise OptionError(f"measure {text!r}: it {error}") from None
    return float(evaluate(text, measures, [runs[name] for name in statement.needs]))
