"""Shadow of a structure on its floor: flat dark pieces under its members, which show where and how it stands.

The light comes along the floor's normal. A shadow is as sharp and dark as its member is near: it widens and pales with
the height, and where a rod's end comes down, a round one darkens to the touch. A shadow map would cost far more.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.model.structure import Structure

PIECES = 4  # of a rod's shadow, each of one darkness
MOST_STRINGS = 60  # whose shadows are drawn
DARKEST = 0.5  # of a rod that lies on the floor: 0 is the floor's colour, 1 that of `palette.SHADE`
TOUCH = 0.15  # of a rod's length: below such a height its end has a round shadow
WIDER = 0.035  # of the height: half the width that a shadow gains
PALER = 0.35  # of the extent: at such a height a shadow has half its darkness
SOFT = ((1.7, 0.5), (1.0, 1.0))  # width and darkness, relative: an outer part, and an inner one over it


class Patch(NamedTuple):
    """A flat dark part of the floor: middle (3,), half length and half width [m], its axes (3, 3), and how dark."""

    middle: Array
    half: tuple[float, float]
    axes: Array
    darkness: float
    round: bool


def patches(
    floor: tuple[Array, Array], structure: Structure, nodes: Array, radii: Array, string: float, extent: float
) -> Iterator[Patch]:
    """Shadows on a floor, a point of it and its normal, of rods of radii (R,) and strings of one [m].

    `extent` [m] is that of the picture, for how fast shadows pale.
    """
    place, up = floor
    heights = (nodes - place) @ up
    flat = nodes - heights[:, None] * up
    members = [(radius, PIECES, 1.0) for radius in radii.tolist()]
    pairs = structure.rod_nodes
    segments = structure.paths.nodes
    if len(segments) <= MOST_STRINGS:
        members += [(string, 1, 0.6)] * len(segments)
        pairs = np.concatenate([pairs, segments])
    along = flat[pairs[:, 1]] - flat[pairs[:, 0]]
    lengths = np.linalg.norm(along, axis=1)
    directions = along / np.maximum(lengths, 1e-300)[:, None]
    level = rotation_to(up)
    directions[lengths <= 1e-9 * extent] = level[:, 0]
    frames = np.stack([directions, np.cross(up, directions), np.broadcast_to(up, directions.shape)], axis=2)
    ends = zip(members, heights[pairs].tolist(), flat[pairs[:, 0]], along, lengths.tolist(), frames, strict=True)
    for (radius, pieces, weight), (low, high), start, way, length, axes in ends:
        for k in range(pieces):
            share = (k + 0.5) / pieces
            height = max(0.0, (1.0 - share) * low + share * high - radius)
            middle = start + share * way
            for wide, dark in SOFT if pieces > 1 else SOFT[1:]:
                half = (0.5 * length / pieces, wide * (radius + WIDER * height))
                darkness = DARKEST / (1.0 + height / (PALER * extent))
                yield Patch(middle, half, axes, weight * dark * darkness, False)
    for pair, radius, length in zip(structure.rod_nodes, radii, structure.rod_lengths, strict=True):
        for node in pair:
            height = max(0.0, float(heights[node]) - radius)
            if height < TOUCH * length:
                near = 1.0 - height / (TOUCH * length)
                for wide, dark in SOFT:
                    half = wide * 1.4 * radius
                    yield Patch(flat[node], (half, half), level, near * dark * min(1.0, 1.6 * DARKEST), True)
