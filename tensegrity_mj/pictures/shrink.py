"""Smooth edges: a picture drawn larger is averaged down onto its background, and turned the right way up.

Drawing larger and averaging costs no more in software OpenGL than its own multisampling, also smooths thin lines and
shading, and gives the same on every driver. It is compiled: numpy and Pillow take four times as long.

The background is filled in here, by the opacity that OpenGL leaves with each pixel: drawn as a plate behind everything
it costs a quarter of a frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.pointers import integers, octets

Image = NDArray[np.uint8]

_OPAQUE = -0x00FFFFFF01000000  # the bits of the opacities of two pixels
_EVERY_OTHER = 0x00FF00FF00FF00FF  # bytes: red and blue of two pixels


def behind(color: tuple[int, int, int], alpha: float) -> Image:
    """Return how a background (256, 3) shows through pixels drawn on black, for each value of a pixel's fourth byte.

    OpenGL blends that byte as it does colours: what is translucent changes A into alpha² + (1 - alpha) A. After n such
    layers alpha - A is (1 - alpha)ⁿ times what it was before. So with A = 0 where nothing was drawn, the share of the
    background that comes through all layers is 1 - A / alpha; over an opaque thing, A = 1, A stays above alpha.

    Args:
        color: colour of the background.
        alpha: opacity of all that is translucent; 0 where that has something opaque behind it.
    """
    share = np.maximum(0.0, 1.0 - np.arange(256) / (255.0 * max(alpha, 1e-9)))
    return np.round(share[:, None] * color).astype(np.uint8)


def shrink(source: Image, factor: float, result: Image, background: Image) -> None:
    """Average `source` onto a background into `result` (H, W, 3), top row first.

    Args:
        source: (factor H, factor W, 4), drawn `factor` times as large on black, bottom row first.
        factor: 1, 3/2 (H and W even), 2, 3, ...
        result: may be a view into a larger picture. Halves are rounded up.
        background: from `behind`.
    """
    height, width, _ = result.shape
    places = (one.ctypes.data for one in (source, background, result))
    _average(*places, height, width, result.strides[0], round(2.0 * factor))


@c_function("int64(int64, int64, int64, int64, int64, int64, int64)", "smooth edges of pictures")
def _average(source, background, result, height, width, step, doubled):  # type: ignore[no-untyped-def]
    """Addresses, the result's size and bytes from row to row, and twice the factor."""
    taps = (doubled + 1) // 2
    tall, wide = height * doubled // 2, width * doubled // 2
    pixels, out = octets(source, (tall, wide, 4)), octets(result, height * step)
    through = octets(background, (256, 3))
    pairs = integers(source, (tall, max(wide // 2, 1)))
    area = 9 if doubled == 3 else taps * taps
    half, share = area // 2, (2**24 + area - 1) // area  # to divide by an area < 256, exactly, without a division
    for i in range(height):
        first = tall - 1 - doubled * i // 2
        for j in range(width):
            place = i * step + 3 * j
            if doubled == 4:  # the usual one, whose pixels are taken two at a time
                upper, lower = pairs[first, j], pairs[first - 1, j]
                if upper | lower == 0:
                    for k in range(3):
                        out[place + k] = through[0, k]
                    continue
                if upper == lower and upper >> 32 == (upper << 32) >> 32 and upper & _OPAQUE == _OPAQUE:
                    for k in range(3):
                        out[place + k] = pixels[first, 2 * j, k]
                    continue
                ends = (upper & _EVERY_OTHER) + (lower & _EVERY_OTHER)
                middle = ((upper >> 8) & _EVERY_OTHER) + ((lower >> 8) & _EVERY_OTHER)
                ends, middle = ends + (ends >> 32), middle + (middle >> 32)
                red, green, blue = ends & 0xFFFF, middle & 0xFFFF, (ends >> 16) & 0xFFFF
                if upper & lower & _OPAQUE != _OPAQUE:
                    for pair in (upper, lower):
                        for alpha in ((pair >> 24) & 0xFF, (pair >> 56) & 0xFF):
                            red += through[alpha, 0]
                            green += through[alpha, 1]
                            blue += through[alpha, 2]
                out[place] = min((red + 2) >> 2, 255)
                out[place + 1] = min((green + 2) >> 2, 255)
                out[place + 2] = min((blue + 2) >> 2, 255)
                continue
            left = doubled * j // 2
            red, green, blue = half, half, half
            for a in range(taps):
                # For 3/2, of three pixels the middle one counts half in each of two results (all times two).
                down = 2 if doubled == 3 and (i + a) % 2 == 0 else 1
                for b in range(taps):
                    weight = 2 * down if doubled == 3 and (j + b) % 2 == 0 else down
                    pixel = pixels[first - a, left + b]
                    alpha = pixel[3]
                    red += weight * (np.int64(pixel[0]) + through[alpha, 0])
                    green += weight * (np.int64(pixel[1]) + through[alpha, 1])
                    blue += weight * (np.int64(pixel[2]) + through[alpha, 2])
            for k, total in enumerate((red, green, blue)):
                out[place + k] = min((total * share) >> 24, 255)
    return 0
