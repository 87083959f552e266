"""The water around a structure: a block whose upper face follows the sea, as meshes that are written anew every frame.

Walls reach down from the edges of the surface, so that what is under water is tinted also where it is seen from the
side. Lines on the surface, whole cells apart, give scale and show its shape; its edges are drawn stronger. Vertices
stand at places that stay the same in the world, also where the block goes with a structure that travels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.elements.waves import Sea
from tensegrity_mj.pictures.camera import Camera

Faces = NDArray[np.int64]

MARGIN = 0.15  # of the structure's extent: how far the block stands out around it
BELOW = 0.06  # of the extent: how far it goes on below everything, trough and structure
BOTTOM = 0.3  # of the extent: a bottom that lies at most so much deeper than that is shown
PIECES = 20  # of the shortest wave: chords are then within 1.3 % of its amplitude
MOST_POINTS = 6000  # of the surface; waves too short for that many are coarse
FLATTEST = 0.3  # lines lie on the water, and are widened no more where it is seen from lower
MINOR = 0.05  # of the largest amplitude: components below do not need finer pieces


@dataclass(frozen=True, eq=False)
class Surface:
    """Grid of the vertices of a block of water; the sea gives their heights.

    Attributes:
        x, y: (I,), (J,) of the surface's vertices, ascending [m].
        bottom: z of the lower edge of the walls [m].
        every: vertices from one line to the next.
        line: half the width of lines at the edges, of those along x, and of those along y [m].
        shallow: whether `bottom` is that of the water.
        crest: the highest that the surface can be [m].
    """

    x: Array
    y: Array
    bottom: float
    every: int
    line: tuple[float, float, float]
    shallow: bool
    crest: float

    @classmethod
    def enclosing(cls, nodes: Array, heights: tuple[float, float], cell: float, seas: Sequence[Sea]) -> Surface:
        """The block around a structure.

        Args:
            nodes: (P, 3) everywhere that it is, as the block sees it [m].
            heights: lowest and highest z of it in the world [m]; those of `nodes`, unless the block goes with it.
            cell: between lines [m].
            seas: whose waves are to be shown, at least one.
        """
        extent = float(np.linalg.norm(np.ptp(nodes, axis=0)))
        low, high = nodes.min(axis=0)[:2] - MARGIN * extent, nodes.max(axis=0)[:2] + MARGIN * extent
        first, last = np.floor(low / cell + 1e-6).astype(int), np.ceil(high / cell - 1e-6).astype(int)
        last = np.maximum(last, first + 1)
        crest = max(float(np.sum(sea.amplitude)) for sea in seas)
        shortest = min(_shortest(sea) for sea in seas)
        most = max(1, math.isqrt(MOST_POINTS // int(np.prod(last - first))))
        every = min(most, max(1, math.ceil(min(PIECES * cell / shortest, most))))
        x, y = (np.arange(a * every, b * every + 1) * (cell / every) for a, b in zip(first, last, strict=True))
        bottom = min(heights[0], -crest) - BELOW * extent
        depth = min(sea.depth for sea in seas)
        shallow = -depth >= bottom - BOTTOM * extent
        return cls(x, y, -depth if shallow else bottom, every, (0.0, 0.0, 0.0), shallow, crest)

    def lined(self, width: float, camera: Camera) -> Surface:
        """Return the surface with lines that look about `width` [m] wide from the camera, however low it is."""
        along_x, along_y, _ = camera.axes[:2].T
        across = abs(along_x[0] * along_y[1] - along_x[1] * along_y[0])
        # What is a metre wide on the water looks `across` over the length of a metre of the line.
        x, y = (0.5 * width / max(FLATTEST, across / max(float(np.linalg.norm(v)), 1e-9)) for v in (along_x, along_y))
        return replace(self, line=(0.65 * width, x, y))

    def corners(self, low: float, high: float) -> Array:
        """(8, 3): of the block between two heights [m]."""
        return np.array([[x, y, z] for x in self.x[[0, -1]] for y in self.y[[0, -1]] for z in (low, high)])

    def points(self, sea: Sea, time: float, shift: Array) -> Array:
        """(I, J, 3): the vertices of the surface at a time [s], the block moved by (2,) [m]."""
        x, y = np.meshgrid(self.x + shift[0], self.y + shift[1], indexing="ij")
        return np.stack([x, y, np.broadcast_to(sea.elevation(time, x, y), x.shape)], axis=-1)

    def meshes(self, points: Array) -> list[tuple[Array, Array]]:
        """Vertices and normals (P, 3) of surface, walls and lines, for `points` as the method gives them."""
        slope_x = np.gradient(points[..., 2], points[:, 0, 0], axis=0)
        slope_y = np.gradient(points[..., 2], points[0, :, 1], axis=1)
        normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        up = np.array([0.0, 0.0, 1.0])
        walls, outward, lines = [], [], []
        # The four edges (n, 3), the surface at their left, with normals that point away from it.
        edges = points[-1], points[::-1, -1], points[0, ::-1], points[:, 0]
        for edge, normal in zip(edges, np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]), strict=True):
            walls += [edge * [1.0, 1.0, 0.0] + self.bottom * up, edge]
            outward += [np.broadcast_to(normal, edge.shape)] * 2
            lines += [edge - self.line[0] * up, edge + self.line[0] * up]
        beside = np.array([[0.0, self.line[1], 0.0], [self.line[2], 0.0, 0.0]])
        for rows, side in zip((points[:, :: self.every].swapaxes(0, 1), points[:: self.every]), beside, strict=True):
            for row in rows:
                lines += [row - side, row + side]
        drawn = np.concatenate(lines)
        return [
            (points.reshape(-1, 3), normals.reshape(-1, 3)),
            (np.concatenate(walls), np.concatenate(outward)),
            (drawn, np.broadcast_to(up, drawn.shape)),
        ]

    @cached_property
    def faces(self) -> list[Faces]:
        """Vertices (F, 3) of the triangles of surface, walls and lines, from outside against the clock.

        Surface and lines have two sides; walls are seen from outside only, so that one of them is looked through.
        """
        across, along = len(self.x), len(self.y)
        number = np.arange(across * along).reshape(across, along)
        top = _both(quads(number))
        sides = [along, across, along, across]
        walls = _strips(sides)
        rows = len(self.y[:: self.every]), len(self.x[:: self.every])
        return [top, walls, _both(_strips([*sides, *[across] * rows[0], *[along] * rows[1]]))]


def _shortest(sea: Sea) -> float:
    """Length of the shortest wave that counts [m]; infinite without waves."""
    counts = sea.amplitude > MINOR * np.max(sea.amplitude, initial=0.0)
    return 2.0 * math.pi / float(np.max(sea.number[counts])) if counts.any() else math.inf


def quads(number: Faces) -> Faces:
    """Two triangles a cell of a grid of vertices (I, J), whose second index runs to the left of its first."""
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])


def _strips(lengths: Sequence[int]) -> Faces:
    """Strips between two rows of vertices each, of these lengths, one after the other."""
    starts = np.concatenate([[0], 2 * np.cumsum(lengths)])[:-1]
    return np.concatenate(
        [quads((start + np.arange(2 * n)).reshape(2, n).T) for start, n in zip(starts, lengths, strict=True)]
    )


def _both(faces: Faces) -> Faces:
    """Return the triangles from either side."""
    return np.concatenate([faces, faces[:, ::-1]])
