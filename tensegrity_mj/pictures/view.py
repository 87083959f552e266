"""What a caller chooses of a picture."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures.opengl import MAX_SIZE

MIN_SIZE = 16  # px


class Layout(enum.Enum):
    """How two runs are shown."""

    OVERLAY = "overlay"
    SIDE_BY_SIDE = "side-by-side"


class Quality(enum.Enum):
    """How edges are smoothed: frames are drawn larger and averaged down.

    FAST not at all; FINE 2 times (3/2 times for two runs side by side, which fill the frame); BEST 3 times, for stills.
    """

    FAST = "fast"
    FINE = "fine"
    BEST = "best"


@dataclass(frozen=True)
class View:
    """What the caller chose of the picture; all angles in degrees, None to have it chosen.

    Attributes:
        size: width and height [px].
        traces, target: whether these are drawn.
        azimuth, elevation: of the camera, in MuJoCo's sense (azimuth 90 looks along +y, elevation -90 down).
        distance: of the camera from the middle of what it sees [m].
        quality: of edges.
        text: whether title, time and legend are drawn.
    """

    size: tuple[int, int] = (1280, 720)
    traces: bool = True
    target: bool = True
    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    quality: Quality = Quality.FINE
    text: bool = True

    def __post_init__(self) -> None:
        check_size(self.size)
        if self.distance is not None and not (math.isfinite(self.distance) and self.distance > 0.0):
            raise OptionError(f"distance={self.distance}: it must be a finite length > 0 [m], or None")
        if not isinstance(self.quality, Quality):
            raise OptionError(f"quality={self.quality!r}: it must be a Quality: {', '.join(str(q) for q in Quality)}")


class ViewOptions(TypedDict, total=False):
    """The fields of `View`, as keyword arguments."""

    size: tuple[int, int]
    traces: bool
    target: bool
    azimuth: float | None
    elevation: float | None
    distance: float | None
    quality: Quality
    text: bool


def check_size(size: tuple[int, int]) -> None:
    """Raise OptionError unless the size is two whole numbers of pixels in the range that can be drawn."""
    whole = isinstance(size, (tuple, list)) and len(size) == 2
    whole = whole and all(isinstance(v, (int, np.integer)) and not isinstance(v, bool) for v in size)
    if not whole or not all(MIN_SIZE <= v <= MAX_SIZE for v in size):
        raise OptionError(
            f"size={size!r}: it must be (width, height), whole numbers of pixels from {MIN_SIZE} to {MAX_SIZE}"
        )
