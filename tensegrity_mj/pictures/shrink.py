"""Smooth edges: a picture drawn larger is averaged down, and turned the right way up.

Drawing larger and averaging costs no more in software OpenGL than its own multisampling, also smooths thin lines and
shading, and gives the same on every driver.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

Image = NDArray[np.uint8]


def shrink(source: Image, factor: float, result: Image) -> None:
    """Average `source`, drawn `factor` times as large and bottom row first, into `result` (H, W, 3), top row first.

    Factors are 1, 3/2 (H and W even), 2, 3, ...; `result` may be a view into a larger picture. Halves are rounded up.
    """
    upright = source[::-1]
    if factor in (1, 2):  # Pillow's sums and roundings are those below here, and ten times as fast
        np.copyto(result, np.asarray(PillowImage.fromarray(upright).reduce(int(factor))))
        return
    area = 9 if factor == 1.5 else int(factor) ** 2
    rows = _gathered(upright.astype(np.uint16), factor)
    sums = _gathered(rows.swapaxes(0, 1), factor).swapaxes(0, 1)
    np.copyto(result, (sums + np.uint16(area // 2)) // np.uint16(area), casting="unsafe")


def _gathered(lines: Any, factor: float) -> Any:
    """Sums of lines: of each `factor` ones; for 3/2 of three, the middle one half into each of two (times two)."""
    if factor == 1.5:
        first, middle, last = lines[0::3], lines[1::3], lines[2::3]
        return np.stack([2 * first + middle, middle + 2 * last], axis=1).reshape(-1, *lines.shape[1:])
    return sum(lines[k :: int(factor)] for k in range(int(factor)))
