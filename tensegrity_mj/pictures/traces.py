"""The lines that nodes leave behind, cut into as few straight pieces as look smooth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.pictures.motion import Motion

MAX_PIECES = 400  # drawn at a time; where a run leaves more, the oldest vanish
MAX_SAMPLES = 6000  # of a path before it is simplified


@dataclass(frozen=True, eq=False)
class Traces:
    """Straight pieces of all traces in the order in which they are completed.

    Attributes:
        starts, ends: (P, 3) [m].
        times: (P,) when each is complete [s], ascending.
        nodes: (P,) the node that leaves it.
        corners: for each traced node's row, the times (C,) and positions (C, 3) of the corners of its trace.
    """

    starts: Array
    ends: Array
    times: Array
    nodes: NDArray[np.int64]
    corners: dict[int, tuple[Array, Array]]

    @classmethod
    def of(cls, motion: Motion, rows: NDArray[np.int64], tolerance: float) -> Traces:
        """Traces of the nodes `rows`, off the true path by at most `tolerance` [m]."""
        # The times of a film's frames are not known here: sample finely enough that Hermite pieces look smooth.
        fine = 4 if len(motion.time) < MAX_SAMPLES // 4 else 1
        count = min((len(motion.time) - 1) * fine + 1, MAX_SAMPLES)
        times = np.interp(np.linspace(0, len(motion.time) - 1, count), np.arange(len(motion.time)), motion.time)
        paths = motion.positions(times)
        pieces = [(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64))]
        corners: dict[int, tuple[Array, Array]] = {}
        for row in rows:
            kept = simplify(paths[:, row], tolerance)
            points = paths[kept, row]
            corners[int(row)] = (times[kept], points)
            pieces.append((points[:-1], points[1:], times[kept][1:], np.full(len(kept) - 1, row)))
        starts, ends, done, nodes = (np.concatenate(column) for column in zip(*pieces, strict=True))
        order = np.argsort(done, kind="stable")
        return cls(starts[order], ends[order], done[order], nodes[order], corners)


def moving_rows(motion: Motion, tolerance: float) -> NDArray[np.int64]:
    """Rows of the nodes of members as given that move farther than `tolerance` [m] from where they start."""
    index = motion.structure.node_index
    carried = set(motion.structure.rod_nodes.ravel().tolist())
    carried |= {index[mass.node] for mass in motion.structure.given.point_masses}
    carried |= {int(row) for frame in motion.structure.moving_frames for row in frame.rows}
    travel = np.max(np.linalg.norm(motion.nodes - motion.nodes[0], axis=-1), axis=0)
    return np.array([row for row in sorted(carried) if travel[row] > tolerance], np.int64)


def simplify(path: Array, tolerance: float) -> NDArray[np.int64]:
    """Indices of the points (P, 3) to keep so that no other is farther than `tolerance` from the line through them.

    The method of Douglas and Peucker: split at the farthest point until all are near.
    """
    keep = np.zeros(len(path), bool)
    keep[[0, -1]] = True
    pending = [(0, len(path) - 1)]
    while pending:
        first, last = pending.pop()
        if last - first < 2:
            continue
        inner = path[first + 1 : last] - path[first]
        chord = path[last] - path[first]
        length = float(chord @ chord)
        share = np.clip(inner @ chord / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(inner))
        distance = np.linalg.norm(inner - share[:, None] * chord, axis=1)
        farthest = int(np.argmax(distance))
        if distance[farthest] > tolerance:
            middle = first + 1 + farthest
            keep[middle] = True
            pending += [(first, middle), (middle, last)]
    return np.flatnonzero(keep)
