"""Bending of a tower: the deformation measure of the thesis, section 7.2.3 and figure 7.7.

Where two stages meet, six nodes stand in a hexagon: t of the one and b of the next. Their mean is the centre of that
interconnection. D(i, j) is the distance of the i-th centre from the straight line through the first and the last one,
at the j-th recorded time; the thesis compares runs by its infinity norm, which is here its largest entry.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.trajectory import Trajectory


def is_tower(structure: Structure) -> bool:
    """Return whether nodes have the names of a tower's, of four stages or more."""
    return _stages(structure) >= 4


def interconnections(structure: Structure) -> list[list[int]]:
    """Indices of the six nodes of each interconnection of a tower, from its base to its top.

    Raises:
        OptionError: for a structure whose nodes do not have the names of a tower's, and a tower of fewer than four
            stages, which has no centre off the line through the first and the last.
    """
    stages = _stages(structure)
    if stages < 4:
        raise OptionError(
            f"structure '{structure.name}': it is no tower of four stages or more, whose nodes are b1_1, t1_1 and so "
            "on, with a centre between the first and the last; give the groups of nodes whose centres are wanted"
        )
    index = structure.node_index
    names = [
        [f"{kind}{s + upper}_{i}" for kind, upper in (("t", 0), ("b", 1)) for i in (1, 2, 3)] for s in range(1, stages)
    ]
    return [[index[name] for name in group] for group in names]


def _stages(structure: Structure) -> int:
    """Number of stages of a tower; 0 for any other structure."""
    count, left = divmod(len(structure.nodes), 6)
    wanted = {f"{kind}{s}_{i}" for s in range(1, count + 1) for kind in "bt" for i in (1, 2, 3)}
    return count if not left and wanted == set(structure.nodes) else 0


def centres(nodes: ArrayLike, groups: Sequence[Sequence[int]]) -> Array:
    """Mean positions (..., I, 3) [m] of groups of nodes (..., N, 3)."""
    places = np.asarray(nodes, float)
    return np.stack([places[..., list(group), :].mean(axis=-2) for group in groups], axis=-2)


def distances_from_line(points: ArrayLike) -> Array:
    """Distances (..., I) [m] of points (..., I, 3) from the line through the first and the last of them.

    Where these two are in one place there is no line, and the distance is that from the place.
    """
    places = np.asarray(points, float)
    away = places - places[..., :1, :]
    along = away[..., -1:, :]
    square = np.sum(along * along, axis=-1, keepdims=True)
    part = np.sum(away * along, axis=-1, keepdims=True) / np.where(square > 0, square, 1.0)
    return np.asarray(np.linalg.norm(away - part * along, axis=-1))


def deformation(run: Trajectory, groups: Sequence[Sequence[int]] | None = None) -> Array:
    """D (T, I) [m] of a run.

    Args:
        groups: indices of the nodes of each interconnection; a tower's own by default, see `interconnections`.

    Raises:
        OptionError: where none are given and the structure is no tower of four stages or more.
    """
    chosen = interconnections(run.scene.structure) if groups is None else groups
    return distances_from_line(centres(run.nodes, chosen))
