"""Lengths and directions, and what they are compared with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]

# Initial motions are accepted when they break a rigid constraint by less than this part of the structure's size
# (or of its fastest node): well above the round-off of 17 digits, well below anything that would be seen.
CONSTRAINT_TOLERANCE = 1e-9


def distance(a: Array, b: Array) -> float:
    with np.errstate(over="ignore"):  # infinite is what the caller checks for
        return float(np.linalg.norm(b - a))


def unit_rows(rows: Array) -> Array:
    return rows / np.where(np.linalg.norm(rows, axis=1) > 0, np.linalg.norm(rows, axis=1), 1.0)[:, None]


def size_of(structure: Structure) -> float:
    """What tolerances of lengths are relative to [m]: the extent, or for a single node its distance from 0, or 1."""
    positions = np.array(list(structure.nodes.values()), float).reshape(-1, 3)
    return float(np.ptp(positions, axis=0).max()) or float(np.abs(positions).max()) or 1.0
