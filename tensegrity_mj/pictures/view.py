"""Options of a picture that a caller chooses."""

from __future__ import annotations

import contextlib
import enum
from typing import Any, TypedDict

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.pictures.opengl import MAX_SIZE

MIN_SIZE = 16  # px


class Layout(enum.Enum):
    """Layouts of two runs in one picture."""

    OVERLAY = "overlay"
    SIDE_BY_SIDE = "side-by-side"


class Quality(enum.Enum):
    """Qualities of edges: to smooth them, frames are drawn larger and averaged down.

    FAST not at all; FINE 2 times (3/2 times for two runs side by side, which fill the frame); BEST 3 times, for stills.
    """

    FAST = "fast"
    FINE = "fine"
    BEST = "best"


def _size(given: Any) -> tuple[int, ...]:
    """(width, height) in the range that can be drawn."""
    pixels = kinds.whole(MIN_SIZE, MAX_SIZE)
    with contextlib.suppress(kinds.Wrong):
        size = kinds.tuple_of(pixels.plain, given)
        if len(size) == 2:
            return size
    raise kinds.not_allowed(given, f"(width, height), whole numbers of pixels from {MIN_SIZE} to {MAX_SIZE}")


@value("view", OptionError)
class View:
    """Options of a picture; all angles in degrees, None to have it chosen.

    Attributes:
        size: width and height [px].
        traces, target: whether these are drawn.
        azimuth, elevation: angles of the camera, in MuJoCo's sense (azimuth 90 looks along +y, elevation -90 down).
        distance: distance of the camera from the middle of what it sees [m].
        quality: smoothness of edges.
        text: whether title, time and legend are drawn.
        thickness: whether strings are as thick as they pull.
    """

    size: tuple[int, int] = field(kinds.Kind(_size), default=(1280, 720))
    traces: bool = True
    target: bool = True
    azimuth: float | None = field(kinds.finite("deg"), default=None, none="None")
    elevation: float | None = field(kinds.within(-90, 90, "deg"), default=None, none="None")
    distance: float | None = field(kinds.positive("m"), default=None, none="None")
    quality: Quality = Quality.FINE
    text: bool = True
    thickness: bool = False


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
    thickness: bool
