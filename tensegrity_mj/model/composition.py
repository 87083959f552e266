"""Structures moved, mirrored, merged, or with other strings, for `Structure.moved` and others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance, real_array, shape_of
from tensegrity_mj.errors import OptionError, StructureError
from tensegrity_mj.model.bodies import Body
from tensegrity_mj.model.constraints import Constraint
from tensegrity_mj.model.members import LIMITS, PRESTRESS, PointMass, Rod, String, Support
from tensegrity_mj.model.structure_checks import CONSTRAINT_TOLERANCE, names_of, size_of, unknown_node

if TYPE_CHECKING:
    from tensegrity_mj.model.structure import Structure


def rotation_matrix(rotation: Any) -> Array:
    """(3, 3) of a rotation vector (3,) [rad], a matrix (3, 3) or SciPy's `Rotation`; None turns nothing.

    Raises:
        OptionError: for what is none of these.
    """
    if rotation is None:
        return np.eye(3)
    given = rotation.as_matrix() if hasattr(rotation, "as_matrix") else rotation
    if shape_of(given) != (3, 3):
        from scipy.spatial.transform import Rotation  # slow to load

        vector = real_array("rotation", given, (3,), "rad, or a matrix (3, 3)", scalar=False)
        return np.asarray(Rotation.from_rotvec(np.array(vector)).as_matrix())
    matrix = real_array("rotation", given, (3, 3))
    if np.abs(matrix.T @ matrix - np.eye(3)).max() > CONSTRAINT_TOLERANCE or np.linalg.det(matrix) < 0:
        raise OptionError(
            f"rotation = {matrix.tolist()}; its columns must be orthogonal, of length 1 and right-handed (mirror images"
            " are made by mirrored)"
        )
    return matrix


def mapped(structure: Structure, matrix: Array, shift: Array) -> Structure:
    """The structure with its nodes at `matrix` x + `shift`, an orthogonal matrix (3, 3) and (3,) [m]; supports too."""

    def turned(row: ArrayLike) -> Any:
        return tuple((matrix @ np.asarray(row)).tolist())

    def plane_of(held: Support | PointMass) -> Any:
        return None if held.plane is None else turned(held.plane)

    def support_of(rod: Rod) -> Support:
        rows = rod.support.directions
        if len(rows) < 3:  # three rows hold a point whichever way they look
            rows = tuple(turned(row) for row in rows)
        return Support(rod.support.sigma, rows, None, plane_of(rod.support))  # r̄ is what the nodes give

    def constraint_of(one: Constraint) -> Constraint:
        return replace(one, direction=turned(one.direction), value=None)

    given = structure.given
    places = (np.array(list(given.nodes.values())).reshape(-1, 3) @ matrix.T + shift).tolist()
    return replace(
        structure,
        nodes=dict(zip(given.nodes, places, strict=True)),
        rods=tuple(replace(rod, support=support_of(rod)) for rod in given.rods),
        strings=given.strings,
        point_masses=tuple(replace(point, plane=plane_of(point)) for point in given.point_masses),
        constraints=tuple(map(constraint_of, structure.constraints)),
        bodies=tuple(body.mapped(matrix, shift) for body in structure.bodies),
    )


def with_strings(structure: Structure, changes: Mapping[str, ArrayLike | None]) -> Structure:
    optional = (*PRESTRESS, *LIMITS, "strength")
    allowed = ("stiffness", "damping", *optional)
    for key in changes:
        if key not in allowed:
            raise StructureError(f"with_strings: '{key}' is no property of strings; allowed: {', '.join(allowed)}")
    members = structure.strings
    if structure.ropes and all(np.size(x) in (1, len(structure.given.strings)) for x in changes.values()):  # type: ignore[arg-type]
        members = structure.given.strings
    count = len(members)
    columns: dict[str, list[float | None]] = {}
    if set(changes) & set(PRESTRESS):
        columns = {key: [None] * count for key in PRESTRESS}
    for key, values in changes.items():
        if values is None and key in optional:
            columns[key] = [None] * count
        else:
            columns[key] = real_array(key, values, (count,), error=StructureError).tolist()
    columns.setdefault("stiffness", [string.stiffness for string in members])
    if changes.get("rest_length") is not None:
        for row, string in enumerate(members):  # which `rest_lengths` has as 0
            if string.is_constant and columns["rest_length"][row] == 0:
                columns["rest_length"][row], columns["tension"][row] = None, string.tension
    strings = (
        string.scaled_to(**{key: column[row] for key, column in columns.items()})  # type: ignore[arg-type]
        for row, string in enumerate(members)
    )
    ropes = structure.ropes
    if members is structure.strings and changes.get("rest_length") is not None:
        ropes = tuple(rope.by_rest_length() for rope in ropes)
    return replace(structure, strings=tuple(strings), ropes=ropes)


def merged(one: Structure, other: Structure, join: Mapping[str, str] | bool, prefix: str) -> Structure:
    instance("merged: other", other, type(one), "it must be a Structure")
    instance("merged: join", join, (bool, Mapping), "it must be True, False, or a table {node of the other: node}")
    instance("merged: prefix", prefix, str, "it must be a text, as 'b_'")
    if one.string_law is not other.string_law:
        laws = [string.string_law or other.string_law for string in other.strings]
        strings = (replace(string, string_law=law) for string, law in zip(other.strings, laws, strict=True))
        other = replace(other, strings=tuple(strings), string_law=one.string_law)
    joined = dict(join) if isinstance(join, Mapping) else _meeting(one, other) if join else {}
    names = {name: joined.get(name, f"{prefix}{name}") for name in other.nodes}
    new = {names[name]: place for name, place in other.given.nodes.items() if name not in joined}
    if twice := [name for name in new if name in one.nodes]:
        raise StructureError(
            f"merged: both have nodes {names_of(twice)}; give the names of the other a prefix, as in merged(other, "
            "prefix='b_'), and join nodes that are to be one"
        )
    for name, own in joined.items():
        for node, structure in ((name, other), (own, one)):
            if node not in structure.nodes:
                raise StructureError(f"merged: join, in '{structure.name}': {unknown_node(node, structure.nodes)}")
        away = np.subtract(one.nodes[own], other.nodes[name])
        if np.linalg.norm(away) > CONSTRAINT_TOLERANCE * max(size_of(one), size_of(other)):
            raise StructureError(
                f"merged: join: node '{name}' is {np.linalg.norm(away):.3g} m from '{own}'; joined nodes stand at one "
                f"place: other.moved(translation={away.tolist()}) is there"
            )

    def renamed(member: Any) -> Any:
        if isinstance(member, PointMass):
            return replace(member, node=names[member.node])
        if isinstance(member, Constraint):
            weights = {names[node]: weight for node, weight in member.nodes.items()}
            return replace(member, name=prefix + member.name, nodes=weights)
        return replace(member, name=prefix + member.name, nodes=tuple(names[node] for node in member.nodes))

    members: dict[str, Any] = {}
    for kind in ("rods", "strings", "point_masses", "constraints", "bodies"):
        own, others = (getattr(whole.given, kind, getattr(whole, kind)) for whole in (one, other))
        known = {_nameless(member) for member in own}
        added = [renamed(member) for member in others]
        members[kind] = (*own, *(member for member in added if _nameless(member) not in known))
    fixed = (*one.fixed_nodes, *(names[node] for node in other.fixed_nodes))
    return replace(one, nodes={**one.given.nodes, **new}, fixed_nodes=tuple(dict.fromkeys(fixed)), **members)


def _meeting(one: Structure, other: Structure) -> dict[str, str]:
    """Nodes of the other that stand where one of this structure does -> that one."""
    from scipy.spatial import KDTree

    limit = CONSTRAINT_TOLERANCE * max(size_of(one), size_of(other))
    here, there = one.given.nodes, other.given.nodes
    gaps, rows = KDTree(list(here.values())).query(list(there.values()))
    pairs = zip(there, rows.tolist(), (gaps <= limit).tolist(), strict=True)
    return {name: list(here)[row] for name, row, meets in pairs if meets}


def _nameless(member: Any) -> Any:
    """Return a form of a member that is equal for two members with different names but the same meaning.

    A string has no direction, a normal and a row of D none either, and r̄ is what the nodes give.
    """

    def unsigned(row: Any) -> Any:
        return None if row is None else max(row, tuple(-x for x in row))

    if isinstance(member, String):
        return replace(member, name="any", nodes=member.unordered)
    if isinstance(member, PointMass):
        return replace(member, plane=unsigned(member.plane))
    if isinstance(member, Constraint):
        return frozenset(member.nodes.items()), unsigned(tuple(member.unit))
    if isinstance(member, Body):
        return replace(member, name="any")
    held = member.support
    support = Support(held.sigma, tuple(map(unsigned, held.directions)), None, unsigned(held.plane))
    return replace(member, name="any", support=support)
