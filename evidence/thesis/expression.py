"""Expressions that rows of the tables measure: `max(sums(a)) / 80`, of the row's runs a, b, c, ... in its order.

An expression is made of numbers, texts, lists, also of `... for name in ...`, arithmetic, comparisons, indices,
attributes of runs, and calls of the measures (`lookup.all_measures`) and of the functions below; nothing else is
evaluated.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from types import CodeType
from typing import Any

import numpy as np

from evidence.families.cables import pendulum_frequency, suggest_elements
from evidence.thesis.landscape import angles
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.runs.trajectory import Trajectory

RUNS = "abcdefgh"
ALLOWED = (
    *(ast.Expression, ast.Constant, ast.Name, ast.Load, ast.List, ast.Tuple, ast.Call, ast.Attribute),
    *(ast.ListComp, ast.comprehension, ast.Store, ast.Subscript, ast.Slice, ast.BinOp, ast.UnaryOp, ast.Compare),
    *(ast.operator, ast.unaryop, ast.cmpop),
)


def largest_of(*values: Any) -> Any:
    """The largest number of an array, or of several."""
    return np.max(values[0]) if len(values) == 1 else max(values)


def of(run: Any, label: str, name: str) -> Array:
    """A value of a label of a study."""
    return np.asarray(run.of(label, name))


def target_error(run: Trajectory) -> Array:
    """(T,) [m] of the node farthest from its target."""
    return run.target_error()


FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "abs": np.abs,
    "all": np.all,
    "angles": angles,
    "cos": np.cos,
    "degrees": np.degrees,
    "diff": np.diff,
    "len": len,
    "log10": math.log10,
    "max": largest_of,
    "mean": np.mean,
    "median": np.median,
    "min": np.min,
    "norm": lambda values: np.linalg.norm(values, axis=-1),
    "of": of,
    "pendulum_frequency": pendulum_frequency,
    "ptp": np.ptp,
    "round": np.round,
    "sin": np.sin,
    "suggest_elements": suggest_elements,
    "sum": np.sum,
    "target_error": target_error,
}


@cache
def compiled(text: str, known: tuple[str, ...]) -> CodeType:
    """An expression, checked.

    Args:
        known: names of measures.

    Raises:
        ValueError: with what is wrong, as the end of a sentence.
    """
    try:
        tree = ast.parse(text, mode="eval")
    except SyntaxError as error:
        raise ValueError(f"is no expression ({error.msg})") from None
    own = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    for node in ast.walk(tree):
        if not isinstance(node, ALLOWED) or (isinstance(node, ast.Attribute) and node.attr.startswith("_")):
            raise ValueError(f"has a part that is not allowed: {ast.unparse(node)}")
        if isinstance(node, ast.Call) and (node.keywords or not isinstance(node.func, ast.Name)):
            raise ValueError(f"has a call that is none of a measure or function: {ast.unparse(node)}")
        if isinstance(node, ast.Name) and node.id not in (*known, *FUNCTIONS, *RUNS, *own):
            raise ValueError(f"has the name '{node.id}', which is none of a measure, a function, or a run a, b, ...")
    return compile(tree, text, "eval")


def evaluate(text: str, measures: Mapping[str, Callable[..., Any]], runs: Sequence[Any]) -> Any:
    """The value of an expression.

    Raises:
        ValueError: as `compiled`.
    """
    code = compiled(text, tuple(measures))
    names = {"__builtins__": {}, **measures, **FUNCTIONS, **dict(zip(RUNS, runs, strict=False))}
    return eval(code, names)
