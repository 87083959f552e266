"""Base on which a structure stands, and the distance of its centre of mass from tipping over an edge of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.contact import floor_gaps
from tensegrity_mj.model.rods import centre_of_mass
from tensegrity_mj.runs.trajectory import Trajectory


@dataclass(frozen=True)
class Standing:
    """Nodes that stood on the floor at the recorded times of a run.

    Attributes:
        time: (T,) [s].
        bases: the names of the nodes that touch, in the order of the structure, at each time.
        margins: (T,) [m] least distance of the centre of mass from the edges of their convex hull, seen along the
            floor's
            normal: negative outside, where it tips, and NaN where fewer than three nodes touch, or all are in a line.
        path: (T, 3) [m] the centre of mass.
    """

    time: Array
    bases: tuple[tuple[str, ...], ...]
    margins: Array
    path: Array

    def landings(self, rest: float = 0.1) -> list[tuple[float, tuple[str, ...]]]:
        """The bases on which it stood for at least `rest` [s] without a change, three nodes or more: (since [s], base).

        A base that is left and found again without another one between is one.
        """
        found: list[tuple[float, tuple[str, ...]]] = []
        first = 0
        for k in range(1, len(self.time) + 1):
            if k < len(self.time) and self.bases[k] == self.bases[first]:
                continue
            base = self.bases[first]
            if len(base) >= 3 and self.time[k - 1] - self.time[first] >= rest and (not found or found[-1][1] != base):
                found.append((float(self.time[first]), base))
            first = k
        return found


def standing(run: Trajectory, near: float | None = None) -> Standing:
    """Find the nodes on which a run stood.

    Args:
        near: how far above the floor a surface may be and still count as touching [m]; by default the `width` of the
            contact's impedance, by about which it sinks in at rest. What bounces by less stands.

    Raises:
        OptionError: where its scene has no floor.
    """
    structure, contact = run.scene.structure, run.scene.contact
    if contact is None or contact.floor is None:
        raise OptionError(f"scene '{run.scene.name}' has no floor to stand on: give it contact = {{ floor = 0.0 }}")
    names = np.array(structure.node_names)
    near = contact.spring.impedance[2] if near is None else near
    touching = [floor_gaps(structure, contact, nodes) < near for nodes in run.nodes]
    path = centre_of_mass(structure, run.nodes)
    margins = [
        float(min(edge_margins(nodes[on], centre, contact.up), default=np.nan)) if on.sum() >= 3 else np.nan
        for nodes, on, centre in zip(run.nodes, touching, path, strict=True)
    ]
    return Standing(run.time, tuple(tuple(names[on].tolist()) for on in touching), np.array(margins), path)


def edge_margins(corners: ArrayLike, point: ArrayLike, up: Sequence[float] | Array = (0.0, 0.0, 1.0)) -> Array:
    """Distances (E,) [m] of a point inside the edges of the convex hull of corners (C, 3), seen along `up`.

    Corners in a line have none. The edges of three corners are in their order: from the first to the second, and so on.
    """
    normal = np.array(up, float)
    places, at = np.array(corners, float), np.array(point, float)
    centre = places.mean(axis=0)
    if len(places) > 3:
        places = places[_hull_corners(places, centre, normal)]
    ahead = np.roll(places, -1, axis=0) - places
    inward = np.cross(normal, ahead)
    sizes = np.linalg.norm(inward, axis=1)
    if sizes.min() == 0:
        return np.zeros(0)
    inward /= sizes[:, None]
    inside = np.sum(inward * (centre - places), axis=1)
    return np.asarray(np.sign(inside) * np.sum(inward * (at - places), axis=1)) if np.all(inside) else np.zeros(0)


def _hull_corners(places: Array, centre: Array, normal: Array) -> list[int]:
    """The corners of the convex hull in order around it."""
    from scipy.spatial import ConvexHull, QhullError

    flat = (places - centre) @ rotation_to(normal / np.linalg.norm(normal))[:, :2]
    try:
        return [int(k) for k in ConvexHull(flat).vertices]
    except QhullError:  # all in a line
        return [0, 0, 0]
