"""Frames and numbers of MJCF: rotation matrices, quaternions, and numbers printed so that they read back the same."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array

# Two parallel frames whose places differ by less than 1e-6 m along each axis are one frame to MuJoCo's compiler: what
# stands 9e-7 m from its body's origin, or from its center of mass, then stands there. Frames that are not parallel stay
# apart, so what comes this near is turned, about an axis that does not matter to it. (The limit with some room.)
SNAP = 2e-6  # m
SAME = 1e-14  # of a size: what differs by less stands there, but for round-off
TURNED_SITE = "0.7071067811865476 0.7071067811865476 0 0"  # a site is a point: about x
TURNED_AXIS = "0.7071067811865476 0 0 0.7071067811865476"  # what is round about z: about z, and not as sites


def must_turn(place: ArrayLike, frames: Iterable[ArrayLike], size: float) -> bool:
    """Whether MuJoCo would move a parallel frame at a place (3,) [m] onto one of these, which are elsewhere.

    Places are in the frame of the body; `size` [m] is that of the body, whose round-off is no distance.
    """
    gaps = [float(np.max(np.abs(np.asarray(place, float) - np.asarray(frame, float)))) for frame in frames]
    return any(SAME * size < gap < SNAP for gap in gaps)


def quaternion(rotation: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation matrix, from its largest component for accuracy."""
    r = rotation
    squares = np.array(
        [
            1 + r[0, 0] + r[1, 1] + r[2, 2],
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    products = np.array(
        [
            [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], squares[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], squares[2], r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[3]],
        ]
    )
    q = products[largest] / (2 * math.sqrt(squares[largest]))
    return np.asarray(q / np.linalg.norm(q))


def unit(vector: Iterable[float]) -> Array:
    """The vector (3,) with length 1."""
    array: Array = np.array(tuple(vector), float)
    return array / float(np.linalg.norm(array))


def numbers(values: Iterable[float]) -> str:
    """Values as MJCF has them, with all their digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0
