"""What makes a structure valid: its members, and how they fit each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tensegrity_mj.errors import StructureError
from tensegrity_mj.strings import StringLaw
from tensegrity_mj.structure import PointMass, Rod, String, Structure
from tensegrity_mj.validation.geometry import CONSTRAINT_TOLERANCE, size_of, unit_rows
from tensegrity_mj.validation.members import (
    check_ends,
    check_known,
    check_name,
    check_rod,
    check_string,
    check_unique,
    pair_of,
    plane_of,
)
from tensegrity_mj.validation.values import check_normal, check_number, check_text, check_vector


def check_structure(structure: Structure) -> None:
    """Raise StructureError if the structure is not valid."""
    check_text("name of the structure", structure.name, StructureError)
    nodes = structure.nodes
    if not isinstance(nodes, Mapping):
        raise StructureError(f"nodes: a {type(nodes).__name__}; it must map each node's name to its position")
    for what, members, kind in (
        ("rods", structure.rods, Rod),
        ("strings", structure.strings, String),
        ("point_masses", structure.point_masses, PointMass),
    ):
        for number, member in enumerate(members):
            if not isinstance(member, kind):
                raise StructureError(f"{what}[{number}] = {member!r}; it must be a {kind.__name__}")
    if not nodes:
        raise StructureError(f"structure '{structure.name}' has no nodes; it needs at least a rod or a point mass")
    for name, position in nodes.items():
        check_name("node", name)
        check_vector(f"node '{name}'", position)
    if not isinstance(structure.string_law, StringLaw):
        allowed = ", ".join(f"StringLaw.{law.name}" for law in StringLaw)
        raise StructureError(f"string_law = {structure.string_law!r}; allowed: {allowed}")
    if not structure.rods and not structure.point_masses:
        raise StructureError(f"structure '{structure.name}' has neither rods nor point masses: nothing can move")
    check_unique("rod", (rod.name for rod in structure.rods))
    check_unique("string", (string.name for string in structure.strings))

    owner = _check_node_roles(structure)
    size = size_of(structure)
    for rod in structure.rods:
        check_rod(structure, rod, size)
    along = _check_joints(structure)
    for point in structure.point_masses:
        check_number(f"point mass on node '{point.node}': mass", point.mass, "> 0 kg", lambda x: x > 0)
        if point.plane is not None:
            check_normal(f"point mass on node '{point.node}'", point.plane)
    seen: dict[frozenset[str], str] = {}
    for string in structure.strings:
        check_string(structure, string, size)
        ends = frozenset(string.nodes)
        if ends in seen:
            raise StructureError(
                f"string '{string.name}' joins {pair_of(string)} as string '{seen[ends]}' does: "
                "remove one of them, or give one string their summed stiffness"
            )
        seen[ends] = string.name
        if ends in along:
            raise StructureError(
                f"string '{string.name}' runs along rod '{along[ends]}' ({pair_of(string)}): "
                "its length cannot change; remove it"
            )
        # A string between two fixed points is harmless, and found in published data: it loads nothing that moves.
    used = set(owner) | {name for string in structure.strings for name in string.nodes}
    for name in nodes:
        if name not in used:
            raise StructureError(f"node '{name}' is used by no rod, string or point mass: remove it or use it")
        if name not in owner:
            raise StructureError(
                f"node '{name}' is an end of strings only and would have no mass: "
                "put it on a rod, give it a point mass, or add it to fixed_nodes"
            )


def _check_node_roles(structure: Structure) -> dict[str, str]:
    owner: dict[str, str] = {}
    for rod in structure.rods:
        check_ends(f"rod '{rod.name}'", rod.nodes, structure)
        for name in rod.nodes:
            owner.setdefault(name, f"rod '{rod.name}'")
    check_unique("fixed node", structure.fixed_nodes)
    for name in structure.fixed_nodes:
        check_known("fixed_nodes", name, structure)
        if name in owner:
            raise StructureError(
                f"fixed node '{name}' is an end of {owner[name]}: pin the rod there instead (support pinned at σ = 0 "
                "or 1); where several rods meet, pin one of them"
            )
        owner[name] = "a fixed node"
    for point in structure.point_masses:
        check_known("point mass", point.node, structure)
        if point.node in owner:
            raise StructureError(
                f"point mass on node '{point.node}', which is {owner[point.node]} already: "
                "point masses stand on nodes of their own"
            )
        owner[point.node] = f"the point mass on node '{point.node}'"
    return owner


def _check_joints(structure: Structure) -> dict[frozenset[str], str]:
    """The name of the rod between each pair of nodes; raise StructureError unless rods that meet fit each other."""
    along: dict[frozenset[str], str] = {}
    joined: dict[str, str] = {}  # node -> the node that stands for all nodes of its cluster

    def root(name: str) -> str:
        while joined.get(name, name) != name:
            joined[name] = joined.get(joined[name], joined[name])
            name = joined[name]
        return name

    for rod in structure.rods:
        ends = frozenset(rod.nodes)
        if ends in along:
            raise StructureError(
                f"rod '{rod.name}' joins {pair_of(rod)} as rod '{along[ends]}' does: give one rod the mass of both"
            )
        along[ends] = rod.name
        joined[root(rod.nodes[0])] = root(rod.nodes[1])
    first: dict[str, Rod] = {}
    for rod in structure.rods:
        other = first.setdefault(root(rod.nodes[0]), rod)
        one, two = other.support.plane, rod.support.plane
        parallel = one is None and two is None
        if one is not None and two is not None:
            normals = unit_rows(np.array([one, two], float))
            parallel = float(np.linalg.norm(np.cross(*normals))) <= CONSTRAINT_TOLERANCE
        if not parallel:
            raise StructureError(
                f"rods '{other.name}' and '{rod.name}' are joined, but turn in {plane_of(one)} and in {plane_of(two)}: "
                "rods that hang together all turn in one plane, or all in space"
            )
    return along
