"""Strings with mass, ropes: in their structure each is a row of light strings between point masses.

A rope of mass m and n segments is cut into n equal pieces, and the mass of each stands at its middle. So the whole mass
is on nodes of the rope's own, and none on those that it ties, which may be fixed or on rods; n + 1 light strings join
them, the first and the last half as long as the others. The rope "s1" has the nodes s1.1, ..., s1.n behind all others
of the structure, and the strings s1.1, ..., s1.(n+1) in its place. A part φ of a string of rest length L0, stiffness k
and damping c has φ L0, k/φ and c/φ. Frequencies and shapes converge as 1/n² (docs/ropes.md).
"""

from __future__ import annotations

import enum
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.members import PRESTRESS, PointMass, Rod, String, Vector, unit_rows
from tensegrity_mj.model.strings import TensionCurves
from tensegrity_mj.model.structure_checks import check_ends, check_lengths, check_prestress

if TYPE_CHECKING:
    from tensegrity_mj.model.structure import Structure

DEFAULT_SEGMENTS = 10
# Numbers of a part φ of a string from those of the string: x φ^power.
POWERS = {
    **dict.fromkeys(("rest_length", "min_rest_length", "winch_speed"), 1),
    **dict.fromkeys(("tension", "strength"), 0),
    **dict.fromkeys(("stiffness", "damping", "force_density", "max_force_density"), -1),
}
SAME = 1e-12  # what numbers of parts differ by after a few operations; what differs by more was changed by itself


class RopeStart(enum.Enum):
    """Velocities of a rope's points at the start, where supports move and the scene gives none."""

    REST = "rest"
    INTERPOLATED = "interpolated"  # as on a straight line between the rope's ends


class Given(NamedTuple):
    """Members that a structure was made of: ropes are strings among the others, without their points.

    Nodes of a rope are there where one of them stands elsewhere than on the straight line between the rope's ends.
    """

    nodes: dict[str, Vector]
    rods: tuple[Rod, ...]
    strings: tuple[String, ...]
    point_masses: tuple[PointMass, ...]


@dataclass(frozen=True)
class Rope:
    """A string with mass, and the light strings and point masses in its place in a structure.

    Attributes:
        string: as it was given.
        parts: the light strings, n + 1.
        points: the point masses, n.
        straight: where these are on the straight line between the rope's ends, n [m]; None where they stay as they are.
    """

    string: String
    parts: tuple[String, ...]
    points: tuple[PointMass, ...]
    straight: tuple[Vector, ...] | None

    @classmethod
    def of(cls, string: String, nodes: Mapping[str, Vector], plane: Vector | None) -> Rope:
        """Make the rope of a string with mass between two of these nodes; `plane`: that all else moves in, or None."""
        n = string.segments or DEFAULT_SEGMENTS
        start, end = (np.array(nodes[name]) for name in string.nodes)
        length = float(np.linalg.norm(end - start))
        check_lengths("string", [string], np.array([length]), np.zeros(1))
        rest = float(TensionCurves.of([string]).rest_lengths([string], np.array([length]))[0])
        check_prestress(string, length, rest)
        light = replace(string, mass=None, segments=None, rest_length=rest, tension=None, force_density=None)
        names = [f"{string.name}.{number + 1}" for number in range(n + 1)]
        pairs = itertools.pairwise((string.nodes[0], *names[:n], string.nodes[1]))
        shares = part_shares(n).tolist()
        parts = (
            replace(light, name=name, nodes=pair, **_part(light, share))
            for name, pair, share in zip(names, pairs, shares, strict=True)
        )
        places = start + middles(n) * (end - start)
        points = (PointMass(name, (string.mass or 0.0) / n, plane) for name in names[:n])
        return cls(string, tuple(parts), tuple(points), tuple((x, y, z) for x, y, z in places.tolist()))

    def by_rest_length(self) -> Rope:
        """Return the rope given by its rest length, even if it was given by a tension or a force density."""
        rest = sum(part.rest_length or 0.0 for part in self.parts)
        return replace(self, string=replace(self.string, rest_length=rest, tension=None, force_density=None))

    @property
    def nodes(self) -> tuple[str, ...]:
        """(n,) the nodes of its points."""
        return tuple(point.node for point in self.points)

    @property
    def shares(self) -> Array:
        """(n + 1,) part of the rope that each of its strings is."""
        return part_shares(len(self.points))


def part_shares(n: int) -> Array:
    """(n + 1,) part of a rope of n segments that each of its strings is."""
    return np.array([0.5 / n, *[1.0 / n] * (n - 1), 0.5 / n])


def middles(n: int) -> Array:
    """(n, 1) where along a rope of n segments its points are, from 0 to 1."""
    return (np.arange(n)[:, None] + 0.5) / n


def _part(string: String, share: float) -> dict[str, Any]:
    """The numbers of a part of a string."""
    given = {key: getattr(string, key) for key in POWERS}
    found = {key: value * share ** POWERS[key] for key, value in given.items() if value is not None}
    curve = tuple((stretch * share, tension) for stretch, tension in string.curve)
    return found | ({"stiffness": None, "curve": curve} if curve else {})


def expanded(structure: Structure) -> dict[str, Any]:
    """The fields of a structure that its ropes change, with what stands for these; nothing without ropes.

    Raises:
        StructureError: where a rope's ends do not fit, or a name that it needs is another's.
    """
    if not isinstance(structure.ropes, tuple) or not all(isinstance(one, Rope) for one in structure.ropes):
        raise StructureError(f"structure '{structure.name}': ropes = {value_text(structure.ropes)}; leave it out")
    if not structure.ropes and all(string.mass is None for string in structure.strings):
        return {}
    given = as_given(structure)
    plane = None if structure.bodies else _plane(given)
    heavy = [string for string in given.strings if string.mass is not None]
    own = {f"{string.name}.{i + 1}" for string in heavy for i in range(string.segments or DEFAULT_SEGMENTS)}
    nodes = {name: place for name, place in given.nodes.items() if name not in own}
    taken = {name for rod in given.rods for name in rod.nodes} | {point.node for point in given.point_masses}
    taken |= {name for body in structure.bodies for name in body.nodes}
    for name in sorted(own & (taken | set(structure.fixed_nodes))):
        raise StructureError(
            f"node '{name}' is of the string with mass '{name.rpartition('.')[0]}', and cannot be on a rod, fixed, or "
            "have another point mass: rename one of them"
        )
    ropes: dict[str, Rope] = {}
    for string in heavy:
        _check_points(string, given.nodes)
        check_ends(f"string '{string.name}'", string.nodes, nodes)
        rope = ropes[string.name] = Rope.of(string, nodes, plane)
        for name, place in zip(rope.nodes, rope.straight or (), strict=True):
            nodes[name] = given.nodes.get(name, place)
    lists = [ropes[string.name].parts if string.name in ropes else (string,) for string in given.strings]
    return {
        "nodes": nodes,
        "strings": tuple(itertools.chain(*lists)),
        "point_masses": (*given.point_masses, *(point for rope in ropes.values() for point in rope.points)),
        "ropes": tuple(ropes.values()),
    }


def _check_points(string: String, nodes: Mapping[str, Vector]) -> None:
    """Raise StructureError where some of the nodes of a rope's points are given, and not all."""
    count = string.segments or DEFAULT_SEGMENTS
    names = [f"{string.name}.{i + 1}" for i in range(count)]
    missing = [name for name in names if name not in nodes]
    if 0 < len(missing) < count:
        found = next(name for name in names if name in nodes)
        raise StructureError(
            f"node '{found}' has the name of a point of the string with mass '{string.name}', whose point "
            f"'{missing[0]}' is not given: give all of '{names[0]}' to '{names[-1]}', where they start, or none, and "
            "rename the node"
        )


def as_given(structure: Structure) -> Given:
    """Return the members that a structure was made of, with each rope in place of its parts.

    A rope has what was changed of all its parts alike. Where they were changed one by one, or some are gone, there is
    no rope any more, and what is left of it stands by itself; where all are gone, so are its points.
    """
    nodes, points = dict(structure.nodes), {point.node: point for point in structure.point_masses}
    rows = {string.name: row for row, string in enumerate(structure.strings)}
    wholes: dict[str, String | None] = {}  # in place of a rope's first part, and None of the others
    for rope in structure.ropes:
        names = [part.name for part in rope.parts]
        at = [rows[name] for name in names if name in rows]
        found = [structure.strings[row] for row in at]
        together = at == list(range(at[0], at[0] + len(names))) if at else False
        whole = _whole(rope, found, [points.get(name) for name in rope.nodes]) if together else None
        if whole is None and found:
            continue
        # Another rope in its place, of as many segments, starts where this one does.
        again = whole or next((one for one in structure.strings if one.name == rope.string.name), rope.string)
        stays = again.mass is not None and again.segments == rope.string.segments and again.nodes == rope.string.nodes
        is_straight = rope.straight is not None and [nodes.get(name) for name in rope.nodes] == list(rope.straight)
        for name in rope.nodes:
            points.pop(name, None)
            if is_straight or not stays:
                nodes.pop(name, None)
        if whole is not None:
            wholes |= {**dict.fromkeys(names), names[0]: whole}
    strings = (wholes.get(string.name, string) for string in structure.strings)
    return Given(nodes, structure.rods, tuple(string for string in strings if string), tuple(points.values()))


def _whole(rope: Rope, found: Sequence[String], points: Sequence[PointMass | None]) -> String | None:
    """The string with mass whose parts and points were found, None where there is none."""
    masses = {point.mass for point in points if point}
    if len(found) != len(rope.parts) or len(masses) != 1:
        return None
    mass = masses.pop()
    if list(points) != [replace(point, mass=mass) for point in rope.points]:
        return None
    changes: dict[str, Any] = {}
    for key, power in {**POWERS, "group": 0}.items():
        values = [getattr(part, key) for part in found]
        if values == [getattr(part, key) for part in rope.parts]:
            continue
        same = values[0]
        if isinstance(same, float) and None not in values:
            each = np.array(values) / rope.shares**power
            same = float(each.mean())
            values = [same if abs(one - same) <= SAME * abs(same) else None for one in each.tolist()]
        if any(value != same for value in values):
            return None
        changes[key] = same
    if changes.keys() & set(PRESTRESS):
        changes = {**dict.fromkeys(PRESTRESS), **changes}
    if mass != rope.points[0].mass:
        changes["mass"] = mass * len(points)
    others = [key for key in vars(found[0]) if key not in (*POWERS, "group")]
    for one, part in zip(found, rope.parts, strict=True):
        if any(getattr(one, key) != getattr(part, key) for key in others):
            return None
    return replace(rope.string, **changes)


def _plane(given: Given) -> Vector | None:
    """The plane in which everything moves, None where there is none."""
    planes = [rod.support.plane for rod in given.rods] + [point.plane for point in given.point_masses]
    if not planes or None in planes:
        return None
    normals = unit_rows(np.array(planes, float))
    return planes[0] if np.linalg.norm(np.cross(normals, normals[0]), axis=1).max() <= SAME else None


def without_mass(structure: Structure) -> Structure:
    if not structure.ropes:
        return structure
    own = {name for rope in structure.ropes for name in rope.nodes}
    strings = tuple(replace(string, mass=None, segments=None) for string in structure.given.strings)
    for string in strings:
        if tied := sorted(own & set(string.nodes)):
            raise StructureError(
                f"string '{string.name}' is tied to '{tied[0]}', a point of a string with mass: laws take that for one "
                "massless string between its ends; tie it to a node of its own, with a string with mass on each side"
            )
    light = object.__new__(type(structure))  # valid but for this: where all mass is that of ropes, nothing moves
    nodes = {name: place for name, place in structure.nodes.items() if name not in own}
    points = structure.given.point_masses
    changes: dict[str, Any] = {"nodes": nodes, "strings": strings, "point_masses": points, "ropes": ()}
    for one in fields(structure):
        object.__setattr__(light, one.name, changes.get(one.name, getattr(structure, one.name)))
    return light


def moved_ropes(structure: Structure, rows: Array, base: Array) -> Array:
    """Rows (..., N, 3) of `base` (N, 3), but those of ropes: moved with their ends, which are where `rows` has them.

    Each point is moved as far as a straight line between its rope's ends is there.
    """
    out = np.broadcast_to(base, rows.shape).copy()
    for rope in structure.ropes:
        own = [structure.node_index[name] for name in rope.nodes]
        ends = [structure.node_index[name] for name in rope.string.nodes]
        place, away = middles(len(own)), rows[..., ends, :] - base[ends]
        out[..., own, :] += (1 - place) * away[..., :1, :] + place * away[..., 1:, :]
    return out


def with_ropes(structure: Structure, rows: Array, base: Array) -> Array:
    """Rows (..., N, 3), but those of ropes as `moved_ropes` has them."""
    own = [structure.node_index[name] for rope in structure.ropes for name in rope.nodes]
    whole = np.array(rows)
    whole[..., own, :] = moved_ropes(structure, rows, base)[..., own, :]
    return whole


def completed(structure: Structure, rows: Array, base: Array) -> Array:
    """Rows of all nodes, (..., N, 3), from those of the nodes that are no rope's, or from all of them as they are."""
    count, more = len(structure.nodes), sum(len(rope.points) for rope in structure.ropes)
    if not more or rows.shape[-2:] != (count - more, 3):
        return rows
    whole = np.broadcast_to(base, (*rows.shape[:-2], count, 3)).copy()
    whole[..., : count - more, :] = rows
    return with_ropes(structure, whole, base)
