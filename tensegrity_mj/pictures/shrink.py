"""Smooth edges: a picture drawn larger is averaged down, and turned the right way up.

Drawing larger and averaging costs no more in software OpenGL than its own multisampling, also smooths thin lines and
shading, and gives the same on every driver. It is compiled: numpy and Pillow take four times as long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.pointers import octets

Image = NDArray[np.uint8]


def shrink(source: Image, factor: float, result: Image) -> None:
    """Average `source`, drawn `factor` times as large and bottom row first, into `result` (H, W, 3), top row first.

    Factors are 1, 3/2 (H and W even), 2, 3, ...; `result` may be a view into a larger picture. Halves are rounded up.
    """
    if factor == 1:
        np.copyto(result, source[::-1])
        return
    height, width, _ = result.shape
    _average(source.ctypes.data, result.ctypes.data, height, width, result.strides[0], round(2.0 * factor))


@c_function("int64(int64, int64, int64, int64, int64, int64)", "smooth edges of pictures")
def _average(source, result, height, width, step, doubled):  # type: ignore[no-untyped-def]
    """Addresses, the result's size and bytes from row to row, and twice the factor."""
    taps = (doubled + 1) // 2
    tall, wide = height * doubled // 2, width * doubled // 2
    pixels, out = octets(source, (tall, wide, 3)), octets(result, height * step)
    area = 9 if doubled == 3 else taps * taps
    for i in range(height):
        first = doubled * i // 2
        if doubled == 4:  # the usual one, which needs no division
            upper, lower = pixels[tall - 1 - first], pixels[tall - 2 - first]
            for j in range(width):
                for k in range(3):
                    pair = np.uint16(upper[2 * j, k]) + np.uint16(upper[2 * j + 1, k])
                    pair += np.uint16(lower[2 * j, k]) + np.uint16(lower[2 * j + 1, k])
                    out[i * step + 3 * j + k] = (pair + np.uint16(2)) >> np.uint16(2)
            continue
        for j in range(width):
            left = doubled * j // 2
            for k in range(3):
                total = area // 2
                for a in range(taps):
                    for b in range(taps):
                        # For 3/2, of three pixels the middle one counts half in each of two results (all times two).
                        down = 2 if doubled == 3 and (i + a) % 2 == 0 else 1
                        across = 2 if doubled == 3 and (j + b) % 2 == 0 else 1
                        total += down * across * np.int64(pixels[tall - 1 - first - a, left + b, k])
                out[i * step + 3 * j + k] = total // area
    return 0
