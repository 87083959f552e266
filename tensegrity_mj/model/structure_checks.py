"""What makes a structure valid: its members, and how they fit each other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.checks import LARGEST, MAGNITUDES, SMALLEST
from tensegrity_mj.basics.values import (
    CONSTRAINT_TOLERANCE,
    check_normal,
    check_number,
    check_text,
    check_vector,
    distance,
    sequence_of,
    shown,
    size_of,
    unit_rows,
)
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.strings import StringLaw

if TYPE_CHECKING:
    from tensegrity_mj.model.structure import Structure


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


def check_rod(structure: Structure, rod: Rod, size: float) -> None:
    what = f"rod '{rod.name}'"
    check_number(f"{what}: mass", rod.mass, "> 0 kg", lambda x: x > 0)
    check_number(f"{what}: radius", rod.radius, "> 0 m", lambda x: x > 0)
    a, b = (np.array(structure.nodes[name], float) for name in rod.nodes)
    length = distance(a, b)
    # Below this part of the coordinates, their round-off decides where a rod points.
    check_length(what, rod, length, 1e-12 * max(float(np.abs(a).max()), float(np.abs(b).max())))
    if rod.section is not None:
        if not isinstance(rod.section, Section):
            raise StructureError(f"{what}: section = {rod.section!r}; use Section, Section.tube or Section.solid")
        rod.section.check(f"{what}: section")
    support = rod.support
    if not isinstance(support, Support):
        raise StructureError(f"{what}: support = {support!r}; use Support.free, Support.pinned or Support.constrained")
    check_number(f"{what}: σ", support.sigma, "within [0, 1]", lambda x: 0 <= x <= 1)
    for number, row in enumerate(sequence_of(f"{what}: D", support.directions)):
        check_vector(f"{what}: row {number} of D", row, unit="no unit")
    D = np.array(support.directions, float).reshape(-1, 3)
    if len(D) > 3 or (len(D) and np.linalg.matrix_rank(unit_rows(D), tol=1e-6) < len(D)):
        raise StructureError(
            f"{what}: the rows of D = {D.tolist()} contradict or repeat each other; they must be independent"
        )
    if support.values is not None:
        values = sequence_of(f"{what}: r̄", support.values)
        if len(values) != len(D):
            raise StructureError(f"{what}: r̄ has {len(values)} values for {len(D)} rows of D; it must have one a row")
        for number, value in enumerate(values):
            check_number(f"{what}: r̄[{number}]", value, "a finite number", lambda x: True)
        r = (1 - support.sigma) * a + support.sigma * b
        gap = np.abs(D @ r - np.array(support.values, float)) / np.linalg.norm(D, axis=1)
        if not np.all(gap <= CONSTRAINT_TOLERANCE * size):
            raise StructureError(
                f"{what}: its nodes put D r = {(D @ r).tolist()} at σ = {support.sigma}, but r̄ = "
                f"{list(values)}: move the nodes onto the support, or leave r̄ out to take it from them"
            )
    if support.plane is not None:
        normal = check_normal(what, support.plane)
        off = abs(float(normal @ (b - a)))
        if off > CONSTRAINT_TOLERANCE * size:
            raise StructureError(
                f"{what}: its direction leaves the plane of normal {support.plane} by {off:.3g} m over its length; "
                "a planar rod must lie in its plane"
            )


def plane_of(normal: ArrayLike | None) -> str:
    return "space" if normal is None else f"the plane of normal {shown(normal)}"


def check_string(structure: Structure, string: String, size: float) -> None:
    what = f"string '{string.name}'"
    check_ends(what, string.nodes, structure)
    check_number(f"{what}: stiffness", string.stiffness, "> 0 N/m", lambda x: x > 0)
    check_number(f"{what}: damping", string.damping, ">= 0 N s/m", lambda x: x >= 0)
    given = [name for name in ("rest_length", "tension", "force_density") if getattr(string, name) is not None]
    if len(given) > 1:
        raise StructureError(f"{what}: {' and '.join(given)} are given; give at most one of them")
    for name in given:
        limit = "a finite number > 0 m" if name == "rest_length" else ">= 0"
        check_number(
            f"{what}: {name}", getattr(string, name), limit, lambda x, n=name: x > 0 if n == "rest_length" else x >= 0
        )
    units = {"max_force_density": "N/m", "min_rest_length": "m", "winch_speed": "m/s", "strength": "N"}
    for name, unit in units.items():
        if getattr(string, name) is not None:
            check_number(f"{what}: {name}", getattr(string, name), f"> 0 {unit}, or absent", lambda x: x > 0)
    a, b = (np.array(structure.nodes[name], float) for name in string.nodes)
    length = distance(a, b)
    check_length(what, string, length, 1e-12 * size)
    for name, most, unit in (("tension", string.stiffness * length, "N"), ("force_density", string.stiffness, "N/m")):
        value = getattr(string, name)
        if value is not None and value >= most:
            raise StructureError(
                f"{what}: {name} = {value:g} {unit} leaves it a rest length of {length * (1 - value / most):.3g} m, by "
                f"L0 = L (1 - u/k); it must be below {most:g} {unit} for a rest length above zero: use a stiffer "
                "string, or less prestress"
            )


def check_length(what: str, member: Rod | String, length: float, limit: float) -> None:
    """Raise StructureError unless a length [m] is above the limit that round-off sets, and of a magnitude that fits."""
    if not limit < length < np.inf:
        raise StructureError(
            f"{what} has length {length:.3g} m between {pair_of(member)}; it must be longer than zero, and finite"
        )
    if not SMALLEST <= length <= LARGEST:
        raise StructureError(f"{what} has length {length:.3g} m between {pair_of(member)}; it must be {MAGNITUDES} m")


def check_ends(what: str, nodes: Sequence[str], structure: Structure) -> None:
    if len(sequence_of(f"{what}: nodes", nodes)) != 2:
        raise StructureError(f"{what}: nodes = {nodes!r}; it must name two nodes")
    for name in nodes:
        check_known(what, name, structure)
    if nodes[0] == nodes[1]:
        raise StructureError(f"{what} starts and ends on node '{nodes[0]}'; it must join two different nodes")


def check_unique(kind: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        check_name(kind, name)
        if name in seen:
            raise StructureError(f"{kind} '{name}' is defined twice; names must be unique")
        seen.add(name)


def check_name(kind: str, name: Any) -> None:
    # Printable: names go into TOML, MJCF and NetCDF, and XML cannot hold control characters.
    if not isinstance(name, str) or not name or not name.isprintable():
        raise StructureError(f"{kind} {name!r}: its name must be a non-empty string of printable characters")


def check_known(what: str, name: Any, structure: Structure) -> None:
    if not isinstance(name, str) or name not in structure.nodes:
        raise StructureError(f"{what}: {unknown_node(name, structure)}")


def pair_of(member: Rod | String) -> str:
    return f"'{member.nodes[0]}' and '{member.nodes[1]}'"


def unknown_node(name: object, structure: Structure) -> str:
    return f"unknown node {name!r}; the nodes are {names_of_nodes(structure)}"


def names_of_nodes(structure: Structure) -> str:
    return names_of(structure.nodes)


def names_of(members: Iterable[str]) -> str:
    """The first dozen names of members, and how many there are."""
    names = list(members)
    shown = ", ".join(f"'{name}'" for name in names[:12])
    return shown if len(names) <= 12 else f"{shown}, ... ({len(names)} in all)"
