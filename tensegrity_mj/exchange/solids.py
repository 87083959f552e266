"""The shape of a structure as triangles, in a binary STL file: rods and strings as capsules, point masses as balls.

Each member is a closed body of its own; they overlap at the nodes, as slicers take it.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.model.rods import mass_places
from tensegrity_mj.model.scene import Scene

CORNERS, RINGS = 24, 6  # corners of a circle, and rings of half a ball
STRING_PART = 0.25  # of the thinnest rod's radius, or of a hundredth of the size


def save_stl(scene: Scene, path: str | os.PathLike[str], scale: float = 1.0) -> Path:
    """Write the structure at its start, in millimetres, which printers take STL for; `scale` multiplies it.

    Raises:
        OptionError: for another suffix, a place where no file can be written, or a scale that is not > 0.
        FormatError: if the file cannot be written.
    """
    destination = checked(path, (".stl",), "STL")
    factor = 1000.0 * positive("scale", scale)
    triangles = factor * shape(scene)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    row = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows = np.zeros(len(triangles), row)
    rows["normal"], rows["corners"] = normals, triangles
    with replacing(destination) as part:
        part.write_bytes(b"tensegrity_mj, mm".ljust(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())
    return destination


def shape(scene: Scene) -> Array:
    """Triangles (n, 3, 3) [m] of all members, their corners counterclockwise as seen from outside."""
    structure, nodes = scene.structure, scene.nodes0
    size = float(np.ptp(nodes, axis=0).max(initial=0.0)) or 1.0
    thin = STRING_PART * min((rod.radius for rod in structure.rods), default=0.01 * size)
    parts = [
        _capsule(nodes[pair[0]], nodes[pair[1]], rod.radius)
        for rod, pair in zip(structure.rods, structure.rod_nodes, strict=True)
    ]
    parts += [_capsule(nodes[i], nodes[j], thin) for i, j in structure.paths.nodes]
    for i, j, s, _ in mass_places(structure):
        at = (1 - s) * nodes[i] + s * nodes[j]
        parts.append(_capsule(at, at, 4 * thin))
    parts += [_capsule(nodes[i], nodes[j], 2 * thin) for i, j in structure.body_edges]
    return np.concatenate(parts)


def _capsule(first: Array, second: Array, radius: float) -> Array:
    """Triangles of a capsule between two points, or of a ball where they are one."""
    along = second - first
    length = float(np.linalg.norm(along))
    rotation = rotation_to(along / length) if length > 0 else np.eye(3)
    half = np.linspace(0, np.pi / 2, RINGS + 1)
    angles = np.concatenate([-half[::-1], half])  # from pole to pole
    turns = 2 * np.pi * np.arange(CORNERS) / CORNERS
    heights = radius * np.sin(angles) + np.repeat([0.0, length], len(half))
    across = radius * np.cos(angles)[:, None]
    rings = np.stack(
        [across * np.cos(turns), across * np.sin(turns), np.repeat(heights[:, None], CORNERS, axis=1)], axis=2
    )
    after = np.roll(rings, -1, axis=1)
    sides = [
        np.stack([rings[:-1], after[:-1], after[1:]], axis=2).reshape(-1, 3, 3),
        np.stack([rings[:-1], after[1:], rings[1:]], axis=2).reshape(-1, 3, 3),
    ]
    triangles = np.concatenate(sides)
    # Those at the poles, and between the halves of a ball, have no area.
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    return np.asarray(first + triangles[area > 1e-14 * radius**2] @ rotation.T)
