"""What makes node positions and velocities those of a structure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.checks import LARGEST
from tensegrity_mj.errors import SceneError
from tensegrity_mj.scene import Scene
from tensegrity_mj.structure import Structure
from tensegrity_mj.validation.geometry import CONSTRAINT_TOLERANCE, size_of, unit_rows
from tensegrity_mj.validation.members import names_of_nodes

Array = NDArray[np.float64]


def check_node_array(structure: Structure, what: str, value: Array) -> None:
    count = len(structure.nodes)
    if value.shape != (count, 3):
        raise SceneError(
            f"{what}: shape {value.shape}; it must be ({count}, 3), a row for each of {names_of_nodes(structure)}"
        )
    fits = np.abs(value) <= LARGEST  # NaN does not
    if not np.all(fits):
        row = int(np.argwhere(~fits)[0][0])
        raise SceneError(
            f"{what}: node '{structure.node_names[row]}' has {value[row].tolist()}; it must be finite, and at most "
            f"{LARGEST:g}"
        )


def check_configuration(
    structure: Structure, nodes: Array, where: str, moved: Mapping[str, Array] | None = None
) -> None:
    """Raise SceneError unless node positions keep rod lengths, supports, planes and fixed nodes.

    Supports in `moved` (rod or fixed node -> displacement (3,) [m]) are that far from where the structure has them.
    """
    size = size_of(structure)
    moved = moved or {}
    still = np.zeros(3)
    for name in structure.fixed_nodes:
        row = structure.node_index[name]
        gap = float(np.linalg.norm(nodes[row] - structure.positions[row] - moved.get(name, still)))
        if gap > CONSTRAINT_TOLERANCE * size:
            raise SceneError(f"{where}: fixed node '{name}' is {gap:.3g} m from its place; it must stay there")
    for number, rod in enumerate(structure.rods):
        i, j = structure.rod_nodes[number]
        length = structure.rod_lengths[number]
        stretch = float(np.linalg.norm(nodes[j] - nodes[i]) - length)
        if abs(stretch) > CONSTRAINT_TOLERANCE * size:
            raise SceneError(
                f"{where}: rod '{rod.name}' would be {length + stretch:.12g} m long; its length is {length:.12g} m"
            )
        sigma = rod.support.sigma
        r = (1 - sigma) * nodes[i] + sigma * nodes[j]
        reference = (1 - sigma) * structure.positions[i] + sigma * structure.positions[j]
        rows = rod.support.constraint_rows
        shift = moved.get(rod.name, still)
        broken = np.abs(unit_rows(rows) @ (r - reference - shift)) if len(rows) else np.zeros(0)
        if np.any(broken > CONSTRAINT_TOLERANCE * size):
            raise SceneError(
                f"{where}: rod '{rod.name}' breaks its support by {broken.max():.3g} m at σ = {sigma}: "
                "the point must keep D r = r̄ of the reference nodes"
                + (f", moved by {shift.tolist()} m" if rod.name in moved else "")
            )
        if rod.support.plane is not None:
            off = abs(float(unit_rows(np.array([rod.support.plane]))[0] @ (nodes[j] - nodes[i])))
            if off > CONSTRAINT_TOLERANCE * size:
                raise SceneError(
                    f"{where}: rod '{rod.name}' leaves its plane by {off:.3g} m; its direction must be orthogonal "
                    f"to the normal {rod.support.plane}"
                )
    for point in structure.point_masses:
        if point.plane is not None:
            row = structure.node_index[point.node]
            off = abs(float(unit_rows(np.array([point.plane]))[0] @ (nodes[row] - structure.positions[row])))
            if off > CONSTRAINT_TOLERANCE * size:
                raise SceneError(f"{where}: the point mass on node '{point.node}' is {off:.3g} m out of its plane")


def check_initial_velocities(scene: Scene, moved: Mapping[str, Array]) -> None:
    """Raise SceneError unless velocities keep all constraints; `moved` are the velocities (3,) of moved supports."""
    structure, nodes, velocities = scene.structure, scene.nodes0, scene.velocities0
    speed = max(float(np.abs(array).max(initial=0.0)) for array in (velocities, *moved.values()))
    if speed == 0.0:
        return
    limit = CONSTRAINT_TOLERANCE * speed
    still = np.zeros(3)
    for name in structure.fixed_nodes:
        v = velocities[structure.node_index[name]]
        if name not in moved and np.any(v != 0):
            raise SceneError(f"initial_velocities: fixed node '{name}' has {v.tolist()} m/s; it must be at rest")
        if np.any(np.abs(v - moved.get(name, still)) > limit):
            raise SceneError(
                f"initial_velocities: fixed node '{name}' has {v.tolist()} m/s; its motion starts with "
                f"{moved[name].tolist()} m/s"
            )
    for number, rod in enumerate(structure.rods):
        i, j = structure.rod_nodes[number]
        b = (nodes[j] - nodes[i]) / np.linalg.norm(nodes[j] - nodes[i])
        stretch = float(b @ (velocities[j] - velocities[i]))
        if abs(stretch) > limit:
            raise SceneError(
                f"initial_velocities: rod '{rod.name}' would lengthen at {stretch:.3g} m/s; the velocities of its "
                "nodes must be equal along it"
            )
        sigma = rod.support.sigma
        at_support = (1 - sigma) * velocities[i] + sigma * velocities[j]
        rows = rod.support.constraint_rows
        rate = moved.get(rod.name, still)
        broken = np.abs(unit_rows(rows) @ (at_support - rate)) if len(rows) else np.zeros(0)
        if np.any(broken > limit):
            raise SceneError(
                f"initial_velocities: rod '{rod.name}' would leave its support at {broken.max():.3g} m/s at σ = "
                f"{sigma}; "
                + (f"its motion starts with {rate.tolist()} m/s" if rod.name in moved else "D ṙ must be zero")
            )
        if rod.support.plane is not None:
            off = abs(float(unit_rows(np.array([rod.support.plane]))[0] @ (velocities[j] - velocities[i])))
            if off > limit:
                raise SceneError(f"initial_velocities: rod '{rod.name}' would turn out of its plane at {off:.3g} m/s")
    for point in structure.point_masses:
        if point.plane is not None:
            off = abs(float(unit_rows(np.array([point.plane]))[0] @ velocities[structure.node_index[point.node]]))
            if off > limit:
                raise SceneError(
                    f"initial_velocities: the point mass on '{point.node}' leaves its plane at {off:.3g} m/s"
                )


def check_no_vanishing_string(scene: Scene) -> None:
    lengths = scene.structure.string_lengths(scene.nodes0)
    for row in np.flatnonzero(lengths <= 1e-12 * size_of(scene.structure))[:1]:
        name = scene.structure.strings[row].name
        raise SceneError(f"initial_nodes: string '{name}' has length {lengths[row]:.3g} m; it must be longer")
