"""Structures: nodes, rods, strings and supports. Topology and physics, validated, immutable.

Rods that name the same node are joined there by a ball joint without friction. SI units, radians; the world frame is
right-handed with z up. Positions are in that frame [m].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import checked, real_array, sequence_of, shape_of
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import choice, direction, mapping, names, parts, printable_name, text, vector
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.bodies import Body, Frame, frame_of
from tensegrity_mj.model.composition import mapped, merged, rotation_matrix, with_strings
from tensegrity_mj.model.constraints import Constraint, constraint_rows
from tensegrity_mj.model.members import LIMITS, PointMass, Rod, String, StringLaw, Support, Vector, lumps_of
from tensegrity_mj.model.ropes import Given, Rope, as_given, expanded, without_mass
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.strings import Paths, TensionCurves
from tensegrity_mj.model.structure_checks import check_structure, check_two_nodes

T = TypeVar("T", bound=NDArray[Any])


@value("structure {name!r}", StructureError)
class Structure:
    """Nodes, rods, strings and supports of a tensegrity structure of any class.

    A node at which rods end is a joint between them: a ball joint without friction, of as many rods as name it. A joint
    is held in space by the support of one of its rods.

    Attributes:
        name: short name.
        nodes: node name -> reference position [m].
        rods, strings, point_masses, bodies: the members, each naming its nodes; see `lone_masses` for the masses.
        fixed_nodes: names of nodes that are fixed in space and belong to no rod.
        string_law: clipped (default) or unclipped, see `strings`.
        constraints: other conditions on nodes, each a linear equation of their coordinates.
        ropes: the members among `nodes`, `strings` and `point_masses` that represent strings with mass; no argument.
            `given` has the strings as they were given.

    Raises:
        StructureError: on construction, if anything is invalid; the message names the item at fault.
    """

    name: str = field(text())
    nodes: Mapping[str, Vector] = field(
        mapping(printable_name(), vector("m"), "a table of node name = [x, y, z]", "node"),
        eq=lambda nodes: list(nodes.items()),
    )
    rods: tuple[Rod, ...] = field(parts(Rod), default=())
    strings: tuple[String, ...] = field(parts(String), default=())
    fixed_nodes: tuple[str, ...] = field(names("node"), default=())
    point_masses: tuple[PointMass, ...] = field(parts(PointMass), default=())
    string_law: StringLaw = field(choice(StringLaw), default=StringLaw.CLIPPED)
    constraints: tuple[Constraint, ...] = field(parts(Constraint), default=())
    bodies: tuple[Body, ...] = field(parts(Body), default=())
    ropes: tuple[Rope, ...] = field(None, default=())

    __hash__ = None  # type: ignore[assignment]

    def __attrs_post_init__(self) -> None:
        for name, of_all in expanded(self).items():
            object.__setattr__(self, name, of_all)
        check_structure(self)

    @classmethod
    def from_arrays(
        cls,
        nodes: ArrayLike,
        rods: ArrayLike,
        strings: ArrayLike | Sequence[Sequence[int]],
        *,
        rod_mass: ArrayLike,
        stiffness: ArrayLike,
        damping: ArrayLike = 0.0,
        rest_length: ArrayLike | None = None,
        force_density: ArrayLike | None = None,
        tension: ArrayLike | None = None,
        rod_radius: ArrayLike = 0.01,
        supports: Sequence[Support] | None = None,
        fixed_nodes: Sequence[int] = (),
        point_masses: Mapping[int, float] | None = None,
        string_mass: ArrayLike | None = None,
        segments: int | None = None,
        name: str = "structure",
        string_law: StringLaw = StringLaw.CLIPPED,
    ) -> Structure:
        """Make a structure of arrays: nodes (N, 3); rods (R, 2) and strings (M, 2), or M paths, as node indices from 0.

        Scalars broadcast over members; no `string_mass` is 0. Nodes become n1, n2, ...; rods r1, ...; strings s1, ...

        Raises:
            StructureError: as the constructor, and for arrays of the wrong shape.
        """
        given = {key: value for key, value in locals().items() if key not in ("cls", "name", "string_law")}
        return cls(name=name, string_law=string_law, **_members_from(given))

    def with_strings(self, **changes: ArrayLike | None) -> Structure:
        """Return a copy whose strings have another stiffness, damping, prestress, other limits or `strength`.

        Values are scalars or (M,); of a structure with ropes, scalars and one value for each of its strings as given
        are of ropes as wholes. Giving a rest length, tension or force density replaces whichever of the three was
        there; None removes it, so that the strings are taut without tension at the reference nodes. A limit of None
        is lifted, and a strength of None is unknown. A stiffness scales the tensions of a string's curve. A constant
        force has no rest length: with 0, as `rest_lengths` has it, it stays.
        """
        return with_strings(self, changes)

    def placed(self, nodes: ArrayLike) -> Structure:
        """A copy whose reference nodes are at nodes (N, 3) [m]; rods are as long as they are there, bodies turned."""
        places = real_array("nodes", nodes, (len(self.nodes), 3), "m", False, StructureError)
        stay = tuple(replace(rope, straight=None) for rope in self.ropes)  # wherever their points are
        bodies = tuple(body.placed(frame, places) for body, frame in zip(self.bodies, self.frames, strict=True))
        return replace(self, nodes=dict(zip(self.nodes, places.tolist(), strict=True)), bodies=bodies, ropes=stay)

    def with_sections(self, sections: Section | Sequence[Section | None] | None) -> Structure:
        """A copy whose rods have that section, or one each (R of them) in their order; None: not known.

        Raises:
            StructureError: if there are not as many sections as rods, or one of them is not valid.
        """
        same = sections is None or isinstance(sections, Section)
        count = len(self.rods)
        chosen = (sections,) * count if same else sequence_of("with_sections: sections", sections, StructureError)
        if len(chosen) != count:
            raise StructureError(f"with_sections: {len(chosen)} sections for {count} rods; give one a rod")
        rods = (replace(rod, section=section) for rod, section in zip(self.rods, chosen, strict=True))
        return replace(self, rods=tuple(rods))

    def with_elastic_rods(self, damping: float = 0.0) -> Structure:
        """A copy whose rods have the stiffness EA/ℓ of their sections, and that damping [N s/m].

        Raises:
            StructureError: where a rod has no section.
        """
        rods = []
        for rod, length in zip(self.rods, self.rod_lengths.tolist(), strict=True):
            if rod.section is None:
                raise StructureError(f"rod '{rod.name}' has no section: give it one (with_sections), or a stiffness")
            rods.append(replace(rod, stiffness=rod.section.axial_stiffness / length, damping=damping))
        return replace(self, rods=tuple(rods))

    def moved(self, rotation: Any = None, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Structure:
        """The structure rotated about the origin and then translated, supports, planes and fixed nodes with it.

        Args:
            rotation: a vector (3,) [rad], along the axis and as long as the angle (right hand), a matrix (3, 3), or
                `scipy.spatial.transform.Rotation`; None for none.
            translation: (3,) [m].

        Raises:
            OptionError: for what is no rotation or no vector.
        """
        shift = real_array("moved: translation", translation, (3,), "m", scalar=False)
        return mapped(self, rotation_matrix(rotation), shift)

    def mirrored(self, plane: ArrayLike, through: ArrayLike = (0.0, 0.0, 0.0)) -> Structure:
        """The mirror image, with the same names, in a plane of normal `plane` (3,) through a point (3,) [m].

        Raises:
            OptionError: for a normal of no length, or what is no vector.
        """
        normal = np.array(checked("mirrored: plane", plane, direction()))
        normal /= np.linalg.norm(normal)
        distance = float(normal @ real_array("mirrored: through", through, (3,), "m", scalar=False))
        return mapped(self, np.eye(3) - 2 * np.outer(normal, normal), 2 * distance * normal)

    def merged(self, other: Structure, join: Mapping[str, str] | bool = False, prefix: str = "") -> Structure:
        """Both structures in one, under the name of this one.

        A rod, string or point mass of the other that is the same as one of this structure, between the same nodes and
        with the same numbers, is there once; so half a structure and its mirror image share what lies in the plane.

        Args:
            other: the other structure.
            join: which of its nodes become nodes of this one that stand at the same place: a map of its names to those
                here, True for all that stand where one of this structure does, False for none.
            prefix: of its other names here.

        Raises:
            StructureError: for names that both have, nodes to be joined that are apart, and members that do not fit.
            OptionError: for what is no structure, join or prefix.
        """
        return merged(self, other, join, prefix)

    @cached_property
    def given(self) -> Given:
        """Members as given: `nodes`, `rods`, `strings` and `point_masses` with ropes as strings with mass."""
        return as_given(self)

    @cached_property
    def massless(self) -> Structure:
        """Structure as laws see it: ropes are light strings, so that nodes are this one's first; or this one itself.

        Raises:
            StructureError: where a string is tied to a point of a rope.
        """
        return without_mass(self)

    @cached_property
    def node_names(self) -> tuple[str, ...]:
        """Names in the order of the rows of every (N, 3) array."""
        return tuple(self.nodes)

    @cached_property
    def node_index(self) -> dict[str, int]:
        """Row of each node."""
        return {name: i for i, name in enumerate(self.nodes)}

    @cached_property
    def positions(self) -> Array:
        """Reference node positions (N, 3) [m]."""
        return _readonly(np.array(list(self.nodes.values()), float).reshape(-1, 3))

    @cached_property
    def rods_at(self) -> dict[str, tuple[int, ...]]:
        """Node name -> rows of the rods that end there, in their order."""
        found: dict[str, list[int]] = {name: [] for name in self.nodes}
        for row, rod in enumerate(self.rods):
            for name in rod.nodes:
                found[name].append(row)
        return {name: tuple(rows) for name, rows in found.items()}

    @cached_property
    def class_number(self) -> int:
        """k of a class k structure: the most rods that meet at one node; 0 where there are no rods."""
        return max((len(rows) for rows in self.rods_at.values()), default=0)

    @cached_property
    def clusters(self) -> tuple[tuple[int, ...], ...]:
        """Rows of the rods that hang together through joints, a cluster each, in the order of their first rods."""
        seen: set[int] = set()
        left = dict(self.rods_at)  # each node is visited once, however many rods it has
        found = []
        for first in range(len(self.rods)):
            if first in seen:
                continue
            cluster, todo = {first}, [first]
            while todo:
                for name in self.rods[todo.pop()].nodes:
                    new = [row for row in left.pop(name, ()) if row not in cluster]
                    cluster.update(new)
                    todo.extend(new)
            seen |= cluster
            found.append(tuple(sorted(cluster)))
        return tuple(found)

    @cached_property
    def rod_nodes(self) -> IntArray:
        """Node rows (R, 2) of the rods."""
        pairs = [[self.node_index[name] for name in rod.nodes] for rod in self.rods]
        return _readonly(np.array(pairs, np.int64).reshape(-1, 2))

    @cached_property
    def frames(self) -> tuple[Frame, ...]:
        """The bodies by their nodes."""
        return tuple(frame_of(self, body) for body in self.bodies)

    @cached_property
    def moving_frames(self) -> tuple[Frame, ...]:
        """Frames of the bodies that are not held."""
        return tuple(frame for body, frame in zip(self.bodies, self.frames, strict=True) if not body.held)

    @cached_property
    def body_edges(self) -> IntArray:
        """Node rows (e, 2) of the edges of the bodies' hulls, which pictures show."""
        edges = [frame.rows[frame.edges] for frame in self.frames]
        return _readonly(np.concatenate([np.zeros((0, 2), np.int64), *edges]))

    @cached_property
    def paths(self) -> Paths:
        """The segments of the strings."""
        return Paths.of([self.node_index[name] for name in string.nodes] for string in self.strings)

    @cached_property
    def string_nodes(self) -> IntArray:
        """Node rows (M, 2) of the strings, where none has more than two.

        Raises:
            StructureError: where one has.
        """
        check_two_nodes(self, "string_nodes (M, 2) has no room for it: use `paths`, which has the segments of strings")
        return self.paths.nodes

    @cached_property
    def constraint_rows(self) -> Array:
        """(C, 3N) of the constraints, whose directions are of length one; `constraint_values` has what they give."""
        return _readonly(constraint_rows(self))

    @cached_property
    def rod_lengths(self) -> Array:
        """ℓ (R,) [m]; of elastic rods without force."""
        pairs = self.rod_nodes
        lengths = np.linalg.norm(self.positions[pairs[:, 1]] - self.positions[pairs[:, 0]], axis=1)
        for row in np.flatnonzero(self.elastic):
            lengths[row] = self.rods[row].rest_length or lengths[row]
        return _readonly(lengths)

    @cached_property
    def rod_stiffness(self) -> Array:
        """k (R,) [N/m] along the rods, ∞ for rigid ones."""
        return _readonly(np.array([np.inf if rod.stiffness is None else rod.stiffness for rod in self.rods], float))

    @cached_property
    def elastic(self) -> NDArray[np.bool_]:
        """Mask (R,) of the elastic rods."""
        return _readonly(np.isfinite(self.rod_stiffness))

    @cached_property
    def lone_masses(self) -> tuple[PointMass, ...]:
        """Point masses on nodes of no rod, bodies of their own; the others the first rod there carries."""
        return tuple(point for point in self.point_masses if not self.rods_at[point.node])

    @cached_property
    def rod_lumps(self) -> Array:
        """(3, R): what rods carry, see `members.lumps_of`."""
        return _readonly(lumps_of(self.rods, self.rod_lengths, self.point_masses))

    @cached_property
    def rod_masses(self) -> Array:
        """m (R,) [kg] of the rods with what they carry; `Rod.mass` is that of a rod alone."""
        return _readonly(np.array([rod.mass for rod in self.rods], float) + self.rod_lumps[0])

    def limits(self, name: str) -> Array:
        """One of `LIMITS` (M,) of the strings; where there is none, ∞, or -∞ for the smallest rest length."""
        return self._limits[name]

    @cached_property
    def _limits(self) -> dict[str, Array]:
        found = {}
        for name in LIMITS:
            none = -np.inf if name == "min_rest_length" else np.inf
            values = [getattr(string, name) for string in self.strings]
            found[name] = _readonly(np.array([none if value is None else value for value in values], float))
        return found

    @cached_property
    def stiffness(self) -> Array:
        """k (M,) [N/m]."""
        return _readonly(np.array([s.stiffness for s in self.strings], float))

    @cached_property
    def curves(self) -> TensionCurves:
        """Tension curves of the strings, over their stretches."""
        return TensionCurves.of(self.strings)

    @cached_property
    def clipped(self) -> NDArray[np.bool_]:
        """(M,) whether a string never pushes, damper included: its own `string_law`, or the structure's."""
        laws = [string.string_law or self.string_law for string in self.strings]
        return _readonly(np.array([law is StringLaw.CLIPPED for law in laws], bool))

    @cached_property
    def damping(self) -> Array:
        """c (M,) [N s/m]."""
        return _readonly(np.array([s.damping for s in self.strings], float))

    @cached_property
    def rest_lengths(self) -> Array:
        """L0 (M,) [m], from what each string specifies at the reference nodes; 0 for a constant force."""
        return _readonly(self.curves.rest_lengths(self.strings, self.string_lengths(self.positions)))

    def string_lengths(self, nodes: Array) -> Array:
        """L [m] of every string for node positions (..., N, 3), ‖s‖ between two nodes; shape (..., M)."""
        return self.paths.lengths(nodes)

    def string_rates(self, nodes: Array, velocities: Array) -> Array:
        """dL/dt [m/s] for node positions and velocities (..., N, 3); shape (..., M)."""
        return self.paths.rates(nodes, velocities)


def _readonly(array: T) -> T:
    array.flags.writeable = False
    return array


def _members_from(given: Mapping[str, Any]) -> dict[str, Any]:
    """Nodes and members for the constructor of a structure, of the arguments of `Structure.from_arrays` by name.

    Raises:
        StructureError: for arrays of the wrong shape.
    """
    shape = shape_of(given["nodes"]) or ()
    if shape[1:] != (3,):
        shown = value_text(given["nodes"]) + (f" of shape {shape}" if shape else "")
        raise StructureError(f"nodes = {shown}; it must be an array of shape (N, 3) [m], a row a node")
    count = shape[0]
    positions = real_array("nodes", given["nodes"], (count, 3), "m", False, StructureError)
    names = [f"n{i + 1}" for i in range(count)]
    rods = _index_pairs("rods", given["rods"], count)
    paths = _index_pairs("strings", given["strings"], count, more=True)

    def columns(members: list[tuple[int, ...]], *what: str) -> list[tuple[Any, ...]]:
        """A row of these numbers for each member; None for what is not given."""
        size, found = len(members), []
        for key in what:
            if given[key] is None:
                found.append([None] * size)
            else:
                found.append(real_array(key, given[key], (size,), error=StructureError).tolist())
        return list(zip(*found, strict=True))

    def single(what: str, rows: Any) -> list[str]:
        return [names[i] for i, _ in _index_pairs(what, [(i, i) for i in rows], count)]

    supports = given["supports"]
    held = [Support.free()] * len(rods) if supports is None else list(supports)
    if len(held) != len(rods):
        raise StructureError(f"supports: {len(held)} for {len(rods)} rods; give one a rod")
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


def _index_pairs(what: str, values: Any, count: int, more: bool = False) -> list[tuple[int, ...]]:
    """The values as pairs (with `more`, paths of two or more) of node indices below `count`."""
    found = []
    for row, given in enumerate(sequence_of(what, values, StructureError)):
        try:
            path = tuple(int(x) for x in given)
            if len(path) < 2 or (len(path) > 2 and not more):
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            need = "a pair of node indices" + ", or more" * more
            raise StructureError(f"{what}[{row}] = {given!r}: it must be {need}") from None
        if any(i != x for i, x in zip(path, given, strict=True)):
            raise StructureError(f"{what}[{row}] = {list(given)}: node indices must be integers")
        if not all(0 <= i < count for i in path):
            raise StructureError(f"{what}[{row}] = {path}: node indices run from 0 to {count - 1}")
        found.append(path)
    return found
