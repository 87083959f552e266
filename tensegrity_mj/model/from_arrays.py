"""Members of a structure from arrays of numbers: what `Structure.from_arrays` is made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.node_indices import array_of_shape, index_pairs


def members_from(given: Mapping[str, Any]) -> dict[str, Any]:
    """Nodes and members for the constructor of a structure, of the arguments of `Structure.from_arrays` by name.

    Raises:
        StructureError: for arrays of the wrong shape.
    """
    positions = array_of_shape("nodes", given["nodes"], (-1, 3))
    count = len(positions)
    names = [f"n{i + 1}" for i in range(count)]
    rods = index_pairs("rods", given["rods"], count)
    paths = index_pairs("strings", given["strings"], count, more=True)

    def columns(members: list[tuple[int, ...]], *what: str) -> list[tuple[Any, ...]]:
        """A row of these numbers for each member; None for what is not given."""
        size, found = len(members), []
        for key in what:
            if given[key] is None:
                found.append([None] * size)
            else:
                found.append(np.broadcast_to(array_of_shape(key, given[key], (size,)), (size,)).tolist())
        return list(zip(*found, strict=True))

    def single(what: str, rows: Any) -> list[str]:
        return [names[i] for i, _ in index_pairs(what, [(i, i) for i in rows], count, allow_equal=True)]

    supports = given["supports"]
    held = [Support.free()] * len(rods) if supports is None else list(supports)
    array_of_shape("supports (one a rod)", np.zeros(len(held)), (len(rods),), broadcast=False)
    bars = columns(rods, "rod_mass", "rod_radius")
    strings = columns(paths, "stiffness", "damping", "rest_length", "tension", "force_density")
    massive = [
        {"mass": mass, "segments": given["segments"]} if mass else {} for (mass,) in columns(paths, "string_mass")
    ]
    heavy = dict(given["point_masses"] or {})
    return {
        "nodes": dict(zip(names, map(tuple, positions.tolist()), strict=True)),
        "rods": tuple(
            Rod(f"r{a + 1}", (names[i], names[j]), mass, radius, support)
            for a, ((i, j), (mass, radius), support) in enumerate(zip(rods, bars, held, strict=True))
        ),
        "strings": tuple(
            String(f"s{a + 1}", tuple(names[i] for i in path), *strings[a], **massive[a])
            for a, path in enumerate(paths)
        ),
        "fixed_nodes": tuple(single("fixed_nodes", given["fixed_nodes"])),
        "point_masses": tuple(
            PointMass(name, m) for name, m in zip(single("point_masses", heavy), heavy.values(), strict=True)
        ),
    }
