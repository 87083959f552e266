"""Frames and numbers of MJCF: rotation matrices, quaternions, and numbers printed so that they read back the same."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_to(b: Array) -> Array:
    """A rotation matrix whose z axis is the unit vector b."""
    return np.asarray(rotations_to(b[None])[0])


def rotations_to(b: Array) -> Array:
    """(R, 3, 3): a rotation matrix for each unit vector (R, 3), which is its z axis."""
    rows, axis = np.arange(len(b)), np.argmin(np.abs(b), axis=1)
    x = np.eye(3)[axis] - b[rows, axis][:, None] * b
    x /= np.sqrt(np.sum(x**2, axis=1))[:, None]
    return np.asarray(np.stack([x, np.cross(b, x), b], axis=2))


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
