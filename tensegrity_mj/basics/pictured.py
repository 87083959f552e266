"""Pictures of what lower rooms make, for notebooks: drawn by a function that the top of the package names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def nothing(item: Any) -> bytes | None:
    """No picture."""
    return None


draw: Callable[[Any], bytes | None] = nothing  # an item as PNG, or None where it cannot be drawn
