"""Smooth edges: a picture drawn larger by a whole factor is averaged down, and turned the right way up.

Drawing larger and averaging costs no more in software OpenGL than its own multisampling, also smooths thin lines and
shading, and gives the same on every driver.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@numba.njit(cache=True, nogil=True)
def shrink(source: Image, factor: int, result: Image) -> None:
    """Average blocks of factor x factor pixels of `source` (factor H, factor W, 3), bottom row first.

    `result` (H, W, 3) has the top row first; it may be a view into a larger picture.
    """
    height, width, _ = result.shape
    last = source.shape[0] - 1
    if factor == 1:
        for y in range(height):
            result[y, :, :] = source[last - y]
    elif factor == 2:
        sums = np.empty(6 * width, np.uint16)
        for y in range(height):
            above, below = source[last - 2 * y].ravel(), source[last - 2 * y - 1].ravel()
            for i in range(6 * width):
                sums[i] = np.uint16(above[i]) + np.uint16(below[i])
            for x in range(width):
                for c in range(3):
                    result[y, x, c] = (sums[6 * x + c] + sums[6 * x + 3 + c] + np.uint16(2)) >> np.uint16(2)
    else:
        area = factor * factor
        for y in range(height):
            for x in range(width):
                for c in range(3):
                    total = area // 2
                    for i in range(factor):
                        for j in range(factor):
                            total += source[last - factor * y - i, factor * x + j, c]
                    result[y, x, c] = total // area
