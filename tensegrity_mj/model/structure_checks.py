"""Checks of a structure: its members must fit each other."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array, norm
from tensegrity_mj.basics.kinds import LARGEST, MAGNITUDES, SMALLEST, shown
from tensegrity_mj.basics.texts import closest
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.constraints import check_constraints
from tensegrity_mj.model.members import Rod, String, unit_rows

if TYPE_CHECKING:
    from tensegrity_mj.model.structure import Structure

# Initial motions are accepted when they break a rigid constraint by less than this part of the structure's size
# (or of its fastest node): well above the round-off of 17 digits, well below anything that would be seen.
CONSTRAINT_TOLERANCE = 1e-9
# A string's stiffness couples any two of its segments: pairs of them in all strings, 9 numbers each in linear models.
MOST_COUPLES = 1_000_000


def check_structure(structure: Structure) -> None:
    """Raise StructureError if the members of the structure do not fit each other."""
    if not structure.nodes:
        raise StructureError(f"structure '{structure.name}' has no nodes; it needs at least a rod or a point mass")
    if not structure.rods and not structure.point_masses and all(body.held for body in structure.bodies):
        raise StructureError(f"structure '{structure.name}' has neither rods nor point masses: nothing can move")
    _check_unique("rod", (rod.name for rod in structure.rods))
    _check_unique("string", (string.name for string in structure.strings))
    _check_unique("body", (body.name for body in structure.bodies))
    owner = _check_node_roles(structure)
    size = size_of(structure)
    _check_rods(structure, size)
    _ = structure.frames
    along = _check_joints(structure)
    rigid = {rod.name for rod in structure.rods if rod.stiffness is None}
    _check_strings(structure, size, {ends: name for ends, name in along.items() if name in rigid})
    _check_unique("constraint", (one.name for one in structure.constraints))
    for one in structure.constraints:
        for node in one.nodes:
            _check_known(f"constraint '{one.name}'", node, structure.nodes)
    used = set(owner).union(*(string.nodes for string in structure.strings))
    for name in structure.nodes:
        if name not in used:
            raise StructureError(f"node '{name}' is used by no rod, string, body or point mass: remove it or use it")
        if name not in owner:
            raise StructureError(
                f"node '{name}' is an end of strings only and would have no mass: "
                "put it on a rod or a body, give it a point mass, or add it to fixed_nodes"
            )
    check_constraints(structure, CONSTRAINT_TOLERANCE * size)


def size_of(structure: Structure) -> float:
    """Length [m] that tolerances are relative to: the extent, or for a single node its distance from 0, or 1."""
    positions = structure.positions
    return float(np.ptp(positions, axis=0).max()) or float(np.abs(positions).max()) or 1.0


def _check_node_roles(structure: Structure) -> dict[str, str]:
    owner: dict[str, str] = {}
    for rod in structure.rods:
        check_ends(f"rod '{rod.name}'", rod.nodes, structure.nodes)
        for name in rod.nodes:
            owner.setdefault(name, f"rod '{rod.name}'")
    _check_unique("fixed node", structure.fixed_nodes)
    for name in structure.fixed_nodes:
        _check_known("fixed_nodes", name, structure.nodes)
        if name in owner:
            raise StructureError(
                f"fixed node '{name}' is an end of {owner[name]}: pin the rod there instead (support pinned at σ = 0 "
                "or 1); where several rods meet, pin one of them"
            )
        owner[name] = "a fixed node"
    ends = {name for rod in structure.rods for name in rod.nodes}
    for point in structure.point_masses:
        _check_known("point mass", point.node, structure.nodes)
        if point.node in ends and point.plane is not None:
            raise StructureError(
                f"point mass on node '{point.node}': plane = {shown(point.plane)}, but {owner[point.node]} ends there "
                "and carries it, so that it moves as the rod does: leave the plane out"
            )
        if point.node in owner.keys() - ends:
            raise StructureError(
                f"point mass on node '{point.node}', which is {owner[point.node]} already: "
                "point masses stand on nodes of their own"
            )
        owner[point.node] = f"the point mass on node '{point.node}'"
        ends.discard(point.node)
    for body in structure.bodies:
        check_ends(f"body '{body.name}'", body.nodes, structure.nodes)
        for name in body.nodes:
            if name in owner:
                raise StructureError(
                    f"node '{name}' of body '{body.name}' is {owner[name]} already: a body has nodes of its own; join "
                    "them by a stiff string where a joint is meant"
                )
            owner[name] = f"a node of body '{body.name}'"
    return owner


def _check_joints(structure: Structure) -> dict[frozenset[str], str]:
    """The name of the rod between each pair of nodes; raise StructureError unless rods that meet fit each other."""
    along: dict[frozenset[str], str] = {}
    for rod in structure.rods:
        ends = frozenset(rod.nodes)
        if ends in along:
            raise StructureError(
                f"rod '{rod.name}' joins {_nodes_of(rod)} as rod '{along[ends]}' does: give one rod the mass of both"
            )
        along[ends] = rod.name
    for first, *others in structure.clusters:
        for row in others:
            one, two = structure.rods[first].support.plane, structure.rods[row].support.plane
            if not _parallel(one, two):
                raise StructureError(
                    f"rods '{structure.rods[first].name}' and '{structure.rods[row].name}' are joined, but turn in "
                    f"{_plane(one)} and in {_plane(two)}: rods that hang together all turn in one plane, or all in "
                    "space"
                )
    return along


def _parallel(one: ArrayLike | None, two: ArrayLike | None) -> bool:
    if one is None or two is None:
        return one is None and two is None
    return float(np.linalg.norm(np.cross(*unit_rows(np.array([one, two], float))))) <= CONSTRAINT_TOLERANCE


def _plane(normal: ArrayLike | None) -> str:
    return "space" if normal is None else f"the plane of normal {shown(normal)}"


def _check_rods(structure: Structure, size: float) -> None:
    ends = structure.positions[structure.rod_nodes]
    # Below this part of the coordinates, their round-off decides where a rod points.
    lengths = norm(ends[:, 1] - ends[:, 0])
    check_lengths("rod", structure.rods, lengths, 1e-12 * np.abs(ends).max(axis=(1, 2), initial=0.0))
    for rod, (a, b) in zip(structure.rods, ends, strict=True):
        support = rod.support
        if support.values is not None:
            D, r = np.array(support.directions), (1 - support.sigma) * a + support.sigma * b
            gap = np.abs(D @ r - np.array(support.values)) / np.linalg.norm(D, axis=1)
            if not np.all(gap <= CONSTRAINT_TOLERANCE * size):
                raise StructureError(
                    f"rod '{rod.name}': its nodes put D r = {(D @ r).tolist()} at σ = {support.sigma}, but r̄ = "
                    f"{list(support.values)}: move the nodes onto the support, or leave r̄ out to take it from them"
                )
        if support.plane is not None:
            off = abs(float(unit_rows(np.array([support.plane]))[0] @ (b - a)))
            if off > CONSTRAINT_TOLERANCE * size:
                raise StructureError(
                    f"rod '{rod.name}': its direction leaves the plane of normal {support.plane} by {off:.3g} m over "
                    "its length; a planar rod must lie in its plane"
                )


def _check_strings(structure: Structure, size: float, along: dict[frozenset[str], str]) -> None:
    for string in structure.strings:
        check_ends(f"string '{string.name}'", string.nodes, structure.nodes)
    paths = structure.paths
    if (pairs := int(np.sum(paths.counts**2))) > max(MOST_COUPLES, len(structure.strings)):
        longest = structure.strings[int(np.argmax(paths.counts))]
        raise StructureError(
            f"string '{longest.name}' runs through {len(longest.nodes)} nodes: its stiffness couples any two of its "
            f"segments, {pairs} pairs with those of the other strings; at most {MOST_COUPLES} in all: use shorter paths"
        )
    segments = norm(paths.spans(structure.positions))
    pieces = [_Piece(string.name, pair) for string in structure.strings for pair in itertools.pairwise(string.nodes)]
    check_lengths("string", pieces, segments, np.full(len(segments), 1e-12 * size))
    lengths = paths.total(segments)
    seen: dict[tuple[str, ...], str] = {}
    for string, length, rest in zip(structure.strings, lengths.tolist(), structure.rest_lengths.tolist(), strict=True):
        check_prestress(string, length, rest)
        same = seen.setdefault(string.unordered, string.name)
        if same != string.name:
            raise StructureError(
                f"string '{string.name}' joins {_nodes_of(string)} as string '{same}' does: "
                "remove one of them; one string has the tension of both where it has their summed stiffness and "
                "damping, if they are linear and their rest lengths are equal, or a curve that is their sum"
            )
        rods = [along.get(frozenset(pair)) for pair in itertools.pairwise(string.nodes)]
        if all(rods):
            names = " and ".join(f"'{name}'" for name in dict.fromkeys(rods))
            raise StructureError(
                f"string '{string.name}' runs along rod {names} ({_nodes_of(string)}): "
                "its length cannot change; remove it"
            )
        # A string between two fixed points is harmless, and found in published data: it loads nothing that moves.


def check_prestress(string: String, length: float, rest: float) -> None:
    """Raise StructureError unless how a string is taut at a length [m] leaves it a rest length [m] above zero."""
    wanted = string.tension if string.force_density is None else string.force_density * length
    before, last = [0.0, 0.0, *(tension for _, tension in string.curve)][-2:]
    if string.curve and wanted is not None and before == last < wanted:
        raise StructureError(
            f"string '{string.name}': its curve is level at {last:g} N, and its prestress would be {wanted:g} N: no "
            f"stretch has that; give it at most {last:g} N, or a curve that rises"
        )
    if not string.is_linear and not string.is_constant and not rest > 0:
        raise StructureError(
            f"string '{string.name}': its curve leaves it a rest length of {rest:.3g} m at its prestress; it must "
            "be above zero: use a stiffer string, or less prestress"
        )
    for name, most, unit in (("tension", string.stiffness * length, "N"), ("force_density", string.stiffness, "N/m")):
        value = getattr(string, name)
        if string.is_linear and value is not None and value >= most:
            raise StructureError(
                f"string '{string.name}': {name} = {value:g} {unit} leaves it a rest length of "
                f"{length * (1 - value / most):.3g} m, by L0 = L (1 - u/k); it must be below {most:g} {unit} for a "
                "rest length above zero: use a stiffer string, or less prestress"
            )


class _Piece(NamedTuple):
    """A segment of a string, under the string's name."""

    name: str
    nodes: tuple[str, str]


def check_bars_alone(structure: Structure, reason: str) -> None:
    """Raise StructureError with the reason, if a structure has bodies, or strings of more than two nodes."""
    for body in structure.bodies:
        raise StructureError(f"'{body.name}' is a body: {reason}")
    check_two_nodes(structure, reason)


def check_two_nodes(structure: Structure, reason: str) -> None:
    """Raise StructureError with the reason, if a string of the structure runs through more than two nodes."""
    for string in structure.strings:
        if len(string.nodes) > 2:
            raise StructureError(f"string '{string.name}' runs through {len(string.nodes)} nodes: {reason}")


def check_lengths(kind: str, members: Sequence[Rod | String | _Piece], lengths: Array, limits: Array) -> None:
    """Raise StructureError unless lengths [m] are above the limits that round-off sets, and of magnitudes that fit."""
    wrong = ~((lengths > limits) & (lengths >= SMALLEST) & (lengths <= LARGEST))
    for row in np.flatnonzero(wrong)[:1]:
        member, length = members[row], lengths[row]
        need = f"{MAGNITUDES} m" if limits[row] < length else "longer than zero"
        raise StructureError(
            f"{kind} '{member.name}' has length {length:.3g} m between {_nodes_of(member)}; it must be {need}"
        )


def check_ends(what: str, nodes: tuple[str, ...], known: Collection[str]) -> None:
    """Raise StructureError unless a member's nodes are known, and each is another than the one before."""
    for name in nodes:
        _check_known(what, name, known)
    if len(nodes) == 2 and nodes[0] == nodes[1]:
        raise StructureError(f"{what} starts and ends on node '{nodes[0]}'; it must join two different nodes")
    for one, other in itertools.pairwise(nodes):
        if one == other:
            raise StructureError(f"{what} passes node '{one}' twice in a row; name it once there")


def _check_unique(kind: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise StructureError(f"{kind} '{name}' is defined twice; names must be unique")
        seen.add(name)


def _check_known(what: str, name: str, known: Collection[str]) -> None:
    if name not in known:
        raise StructureError(f"{what}: {unknown_node(name, known)}")


def _nodes_of(member: Rod | String | _Piece) -> str:
    return " and ".join(f"'{name}'" for name in member.nodes)


def unknown_node(name: object, known: Collection[str]) -> str:
    meant = closest(name, known) if isinstance(name, str) else ""
    return f"unknown node {name!r}{meant}; the nodes are {names_of(known)}"


def names_of(members: Iterable[str]) -> str:
    """The first dozen names of members, and how many there are."""
    names = list(members)
    shown = ", ".join(f"'{name}'" for name in names[:12])
    return shown if len(names) <= 12 else f"{shown}, ... ({len(names)} in all)"
