"""Smooth edges: a picture drawn larger is averaged down, and turned the right way up.

Drawing larger and averaging costs no more in software OpenGL than its own multisampling, also smooths thin lines and
shading, and gives the same on every driver.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.dynamics.native.compiling import compiled

Image = NDArray[np.uint8]


def shrink(source: Image, factor: float, result: Image) -> None:
    """Average `source`, drawn `factor` times as large and bottom row first, into `result` (H, W, 3), top row first.

    Factors are 1, 3/2 (H and W even), 2, 3, ...; `result` may be a view into a larger picture.
    """
    if factor == 1:
        np.copyto(result, source[::-1])
    elif factor == 1.5:
        _shrink_by_two_thirds(source, result)
    elif factor == 2:
        _halve(source, result)
    else:
        _shrink(source, int(factor), result)


@compiled(nogil=True, error_model="python")
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


@compiled(nogil=True, error_model="python")
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


@compiled(nogil=True, error_model="python")
def _shrink_by_two_thirds(source: Image, result: Image) -> None:
    height, width, _ = result.shape
    last = source.shape[0] - 1
    size = 9 * (width // 2)
    average = np.empty(255 * 9 + 1, np.uint8)
    for total in range(len(average)):
        average[total] = (total + 4) // 9
    upper, lower = np.empty(size, np.uint16), np.empty(size, np.uint16)
    for block in range(height // 2):
        # Of three rows, the middle one goes half into each of two; likewise of three columns.
        first = source[last - 3 * block].ravel()
        middle = source[last - 3 * block - 1].ravel()
        third = source[last - 3 * block - 2].ravel()
        for i in range(size):
            upper[i] = 2 * first[i] + middle[i]
            lower[i] = middle[i] + 2 * third[i]
        for x in range(width // 2):
            for c in range(3):
                a, b, d = 9 * x + c, 9 * x + 3 + c, 9 * x + 6 + c
                result[2 * block, 2 * x, c] = average[2 * upper[a] + upper[b]]
                result[2 * block, 2 * x + 1, c] = average[upper[b] + 2 * upper[d]]
                result[2 * block + 1, 2 * x, c] = average[2 * lower[a] + lower[b]]
                result[2 * block + 1, 2 * x + 1, c] = average[lower[b] + 2 * lower[d]]
