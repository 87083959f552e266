"""Structures as MATLAB data: arrays by the names of STEDY and MOTES, which `import` reads, too."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics import matfile
from tensegrity_mj.basics.files import checked, replacing
from tensegrity_mj.errors import StructureError
from tensegrity_mj.exchange.draft import AXES, held_axes
from tensegrity_mj.exchange.tables import left_out
from tensegrity_mj.model.rods import own_masses
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure_checks import check_bars_alone

STRING_RADIUS = 1e-3  # m: STEDY has strings by radius and modulus, of which only E π r² counts
KEPT = ("gravity", "initial_nodes", "initial_velocities", "constraints")


def save_mat(scene: Scene, path: str | os.PathLike[str]) -> tuple[Path, list[str]]:
    """Write N, C_b, C_s and what else STEDY and MOTES need; returns the path, and what the file does not hold.

    Raises:
        OptionError: for another suffix, or a place where no file can be written.
        FormatError: if the file cannot be written.
    """
    destination = checked(path, (".mat",), "MATLAB data")
    structure = scene.structure
    check_bars_alone(
        structure,
        "MATLAB data of STEDY and MOTES have two nodes a member, in C_b and C_s; save the scene as MJCF",
    )
    for string in structure.strings:
        if string.is_constant:
            raise StructureError(
                f"string '{string.name}' pulls with a constant force: MATLAB data of STEDY and MOTES have a "
                "stiffness for each string; save the scene as MJCF or CSV"
            )
    # Where supports move, the start is that of their motion, which is left out.
    start, speeds = (scene.nodes0, scene.velocities0) if not scene.motions else (structure.positions, 0 * scene.nodes0)
    nodes = start.T
    held, notes = held_axes(structure)
    lengths, rest = structure.string_lengths(start), structure.rest_lengths
    bars, strings = (_connectivity(pairs, nodes.shape[1]) for pairs in (structure.rod_nodes, structure.string_nodes))
    radii = np.array([rod.radius for rod in structure.rods])
    density = own_masses(structure) / (math.pi * radii**2 * structure.rod_lengths)
    fixed = np.array([[float(axis in held.get(name, ())) for name in structure.node_names] for axis in AXES])
    masses = {point.node: point.mass for point in structure.point_masses}
    ends = {name for rod in structure.rods for name in rod.nodes}
    lone = np.array([masses.get(name, 0.0) for name in structure.node_names if name not in ends])
    loose = [name for name in structure.node_names if name not in ends and held.get(name) != frozenset(AXES)]
    area = math.pi * STRING_RADIUS**2
    values: dict[str, Any] = {
        "N": nodes,
        "C_b": bars,
        "C_s": strings,
        "Cb": bars,
        "Cs": strings,
        "Nd0": speeds.T,
        "node_names": tuple(structure.node_names),
        "bar_names": tuple(rod.name for rod in structure.rods),
        "string_names": tuple(string.name for string in structure.strings),
        "fixedNodes": fixed,
        "g": np.array(scene.gravity)[:, None],
        "m": own_masses(structure),
        "k": structure.stiffness,
        "c": structure.damping,
        "s_0": rest,
        "ms": np.array([masses[name] for name in loose if name in masses]),
        "Mp_STEDY": lone,  # one for each node without a bar, fixed ones included
        "bars": {"r": radii, "rho": density},
        "strings": {
            "r": np.full(len(rest), STRING_RADIUS),
            "E": structure.stiffness * rest / area,
            "rLP": rest / lengths,
        },
        "tf": scene.duration,
    }
    if scene.loads and not callable(scene.loads) and all(load.angular_frequency == 0 for load in scene.loads):
        values["W"] = scene.nodal_forces(float(scene.start_time)).T
        notes += left_out(scene, (*KEPT, "loads"))
    else:
        notes += left_out(scene, KEPT)
    if ends & masses.keys():
        notes.append("point masses where rods end are left out")
    if any(rod.section is not None for rod in structure.rods):
        notes.append("sections of rods are left out")
    if structure.elastic.any():
        notes.append("bars are rigid in the file: what rods have of stiffness, damping and rest length is left out")
    with replacing(destination) as part:
        matfile.save_mat(part, values)
    return destination, notes


def _connectivity(pairs: Any, count: int) -> Any:
    matrix = np.zeros((len(pairs), count))
    rows = np.arange(len(pairs))
    matrix[rows, pairs[:, 0]], matrix[rows, pairs[:, 1]] = -1.0, 1.0
    return matrix
