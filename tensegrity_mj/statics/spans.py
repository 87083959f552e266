"""Forces and stiffness of what depends on the spans between two nodes, by the coordinates of the nodes."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray


def add_spans(out: Array, pairs: IntArray, pulls: Array) -> None:
    """Add to (3N,) forces that grow with the spans of members: plus at the second node, minus at the first."""
    places = out.reshape(-1, 3)
    np.add.at(places, pairs[:, 1], pulls)
    np.subtract.at(places, pairs[:, 0], pulls)


def block_places(first: IntArray, second: IntArray) -> tuple[IntArray, IntArray]:
    """Rows and columns of the four blocks of (3, 3) that couple two spans, of a member or of two: ii, jj, ij, ji."""
    k, m = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    rows, columns = 3 * first[:, [0, 1, 0, 1]], 3 * second[:, [0, 1, 1, 0]]
    return (rows[:, :, None] + k).reshape(-1), (columns[:, :, None] + m).reshape(-1)


def block_values(blocks: Array) -> Array:
    """The numbers at these places, of one block (3, 3) each that couples the spans themselves."""
    flat = blocks.reshape(-1, 1, 9)
    return np.concatenate([flat, flat, -flat, -flat], axis=1).reshape(-1)
