"""Entry points of installed packages, in the groups `tensegrity_mj.elements`, `.laws`, `.families` and `.commands`.

Files name these by their names alone, so that a file runs no code that its reader has not installed.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

from tensegrity_mj.errors import OptionError

PACKAGE = "tensegrity_mj"


def installed(group: str) -> dict[str, EntryPoint]:
    """The entry points of a group by their names; nothing is imported."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=f"{PACKAGE}.{group}")}


def load(point: EntryPoint) -> Any:
    """Import the object that an entry point names.

    Raises:
        OptionError: if its package cannot be imported, or has no such name.
    """
    try:
        return point.load()
    except Exception as error:
        owner = f" of package '{point.dist.name}'" if point.dist is not None else ""
        raise OptionError(
            f"entry point '{point.name}' of '{point.group}'{owner}: {point.value} cannot be loaded "
            f"({type(error).__name__}: {error}); repair the package that has it, or remove it"
        ) from error
