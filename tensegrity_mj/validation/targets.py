"""What makes a target one that a structure can reach."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.checks import LARGEST
from tensegrity_mj.errors import SceneError
from tensegrity_mj.scene import Target
from tensegrity_mj.structure import Structure
from tensegrity_mj.validation.configurations import check_configuration, check_node_array
from tensegrity_mj.validation.geometry import CONSTRAINT_TOLERANCE, size_of

# Between the shapes of a curve a polynomial may stretch rods by this part of the structure's size; targets of rods are
# normalised, so that it is the error of where they are that this bounds.
CURVE_TOLERANCE = 1e-6


def check_target(structure: Structure, target: Any) -> None:
    """Raise SceneError unless every waypoint is a configuration of the structure and times increase."""
    count = len(structure.nodes)
    if target.nodes.ndim != 3 or target.nodes.shape[1:] != (count, 3) or len(target.times) != len(target.nodes):
        raise SceneError(
            f"target: {len(target.times)} times and nodes of shape {target.nodes.shape}; "
            f"it needs nodes (W, {count}, 3), one set of them a time"
        )
    times = np.array(target.times, float)
    if len(times) == 0 or not np.all(np.abs(times) <= LARGEST) or np.any(np.diff(times) <= 0):
        raise SceneError(f"target: times {list(target.times)} must be finite, at most {LARGEST:g}, and increase")
    if target.along is not None:
        _check_curve(structure, target)
        return
    for number, nodes in enumerate(target.nodes):
        where = "target" if len(times) == 1 else f"target waypoint {number} (t = {times[number]} s)"
        check_node_array(structure, where, nodes)
        check_configuration(structure, nodes, where)


def _check_curve(structure: Structure, target: Target) -> None:
    """Raise SceneError unless the shapes are configurations and what lies between them nearly so."""
    curve = target.along
    assert curve is not None
    for number, nodes in enumerate(curve.shapes):
        where = f"target shape {number} (parameter {curve.parameters[number]})"
        check_node_array(structure, where, nodes)
        check_configuration(structure, nodes, where)
    first, last = curve.interval
    lowest, highest = curve.extremes(target.times)
    slack = 1e-12 * (last - first)
    if lowest < first - slack or highest > last + slack:
        raise SceneError(
            f"target: the parameter moves within [{lowest:.12g}, {highest:.12g}], but shapes are known in "
            f"[{first:.12g}, {last:.12g}] only: give shapes beyond, or smaller rates and accelerations"
        )
    between = np.linspace(first, last, 8 * len(curve.parameters) + 1)
    pairs = structure.rod_nodes
    nodes = curve.nodes(between)
    lengths = np.linalg.norm(nodes[:, pairs[:, 1]] - nodes[:, pairs[:, 0]], axis=-1)
    stretch = np.abs(lengths - structure.rod_lengths)
    again = float(np.abs(curve.nodes(curve.parameters) - curve.shapes).max())
    if again > CONSTRAINT_TOLERANCE * size_of(structure) or stretch.max(initial=0.0) > CURVE_TOLERANCE * size_of(
        structure
    ):
        row, rod = np.unravel_index(np.argmax(stretch), stretch.shape) if stretch.size else (0, 0)
        raise SceneError(
            f"target: the polynomial through the {len(curve.parameters)} shapes stretches rods by up to "
            f"{stretch.max(initial=0.0):.3g} m (rod '{structure.rods[rod].name}' at parameter {between[row]:.6g}) and "
            f"misses the shapes by {again:.3g} m: give more shapes, at chebyshev_points of the parameter"
        )
