"""Smooth edges: a picture drawn larger by a whole factor is averaged down, and turned the right way up.

Drawing larger and averaging costs no more in software OpenGL than its own multisampling, also smooths thin lines and
shading, and gives the same on every driver.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def shrink(source: Image, factor: int, result: Image) -> None:
    """Average blocks of factor x factor pixels of `source` (factor H, factor W, 3), bottom row first.

    `result` (H, W, 3) has the top row first; it may be a view into a larger picture.
    """
    if factor == 1:
        np.copyto(result, source[::-1])
    elif factor == 2:
        _halve(source, result)
    else:
        _shrink(source, factor, result)


@numba.njit(cache=True, nogil=True)
def _halve(source: Image, result: Image) -> None:
    height, width, _ = result.shape
    last = source.shape[0] - 1
    sums = np.empty(6 * width, np.uint16)
    for y in range(height):
        # Two rows are added first: a loop over neighbours in memory, which the compiler vectorises.
        above, below = source[last - 2 * y].ravel(), source[last - 2 * y - 1].ravel()
        for i in range(6 * width):
            sums[i] = np.uint16(above[i]) + np.uint16(below[i])
        for x in range(width):
            for c in range(3):
                result[y, x, c] = (sums[6 * x + c] + sums[6 * x + 3 + c] + np.uint16(2)) >> np.uint16(2)


@numba.njit(cache=True, nogil=True)
def _shrink(source: Image, factor: int, result: Image) -> None:
    height, width, _ = result.shape
    last = source.shape[0] - 1
    area = factor * factor
    average = np.empty(255 * area + 1, np.uint8)  # a table replaces the division
    for total in range(len(average)):
        average[total] = (total + area // 2) // area
    sums = np.empty(3 * factor * width, np.uint16)
    for y in range(height):
        sums[:] = 0
        for row in range(factor):
            line = source[last - factor * y - row].ravel()
            for i in range(len(sums)):
                sums[i] += line[i]
        for x in range(width):
            first = 3 * factor * x
            for c in range(3):
                total = 0
                for i in range(factor):
                    total += sums[first + 3 * i + c]
                result[y, x, c] = average[total]
