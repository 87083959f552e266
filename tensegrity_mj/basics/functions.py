"""Functions of many parameters: a class holds them as its fields, documents each, and is called for the result.

@dataclass(frozen=True)
class Tower:
    stages: int
    radius: float = 0.5

    def __call__(self) -> Scene: ...

tower = function_of(Tower)
tower(3, radius=0.4)  # Tower(3, radius=0.4)()
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def function_of(parameters: Callable[P, Callable[[], R]]) -> Callable[P, R]:
    """The function that takes a class' fields and returns what its instance returns when called."""

    @functools.wraps(parameters, updated=())
    def function(*args: P.args, **options: P.kwargs) -> R:
        return parameters(*args, **options)()

    # With the types of the fields, which converters hide.
    own, types = inspect.signature(parameters), getattr(parameters, "__annotations__", {})
    shown = [one.replace(annotation=types.get(name, one.annotation)) for name, one in own.parameters.items()]
    returned = vars(parameters)["__call__"].__annotations__["return"]
    function.__signature__ = own.replace(parameters=shown, return_annotation=returned)  # type: ignore[attr-defined]
    return function
