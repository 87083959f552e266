"""Checks of what builders of scenes are given."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.errors import OptionError


def whole(what: str, value: Any, least: int) -> int:
    """The value as an integer of at least `least`.

    Raises:
        OptionError: naming what it is and its value.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)) or value < least:
        raise OptionError(f"{what} = {value!r}; it must be an integer >= {least}")
    return int(value)
