"""Pictures of objects in notebooks, for rooms below `pictures`: the package sets the function that draws them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def nothing(item: Any) -> bytes | None:
    """No picture."""
    return None


draw: Callable[[Any], bytes | None] = nothing  # an item as PNG, or None where it cannot be drawn
