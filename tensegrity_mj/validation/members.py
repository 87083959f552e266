"""What makes a rod or a string of a structure valid by itself."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.checks import LARGEST, MAGNITUDES, SMALLEST
from tensegrity_mj.errors import StructureError
from tensegrity_mj.section import Section
from tensegrity_mj.structure import Rod, String, Structure, Support
from tensegrity_mj.validation.geometry import CONSTRAINT_TOLERANCE, distance, unit_rows
from tensegrity_mj.validation.values import check_normal, check_number, check_vector, sequence_of, shown


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
