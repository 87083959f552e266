"""The state of a run's end, `provenance["end"]`, as texts: arrays by names, with their sizes, and the engine's name."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import FormatError

MAY_BE_NAN = "report"  # what laws report


def texts_of(engine: str, parts: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Encode an end as texts, which `parts_of` reads."""
    found = {name: np.array(part, float) for name, part in parts.items()}
    coded = {name: base64.b64encode(part.tobytes()).decode() for name, part in found.items()}
    return {"engine": engine, "sizes": {name: part.size for name, part in found.items()}, **coded}


def parts_of(end: Any, where: str) -> dict[str, Array]:
    """The arrays (size,) of an end.

    Raises:
        FormatError: where it is damaged; `where` begins the message.
    """
    place, parts = "provenance.end", {}
    try:
        if not isinstance(end["engine"], str) or end.keys() != {"engine", "sizes", *end["sizes"]}:
            raise KeyError
        for name, size in end["sizes"].items():
            place = f"provenance.end.{name}"
            parts[name] = np.frombuffer(base64.b64decode(end[name], validate=True))
            if len(parts[name]) != size or not (name == MAY_BE_NAN or np.isfinite(parts[name]).all()):
                raise ValueError
    except (AttributeError, KeyError, TypeError, ValueError):
        raise FormatError(
            f"{where}: {place} is not the state of a run's end: the file is damaged or was changed; simulate that run "
            "again"
        ) from None
    return parts
