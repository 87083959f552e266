"""Members of a structure: rods and what they carry, strings, point masses, supports."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import rows
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.section import Section

Vector = tuple[float, float, float]


PRESTRESS = ("rest_length", "tension", "force_density")  # of a string, at most one of them
MOST_SEGMENTS = 10_000  # of a string with mass
LIMITS = ("max_force_density", "min_rest_length", "winch_speed")  # of a string
LENGTH = kinds.number("a finite number > 0 m", lambda x: x > 0, minimum=0, exclusiveMinimum=True)
STIFFNESS = kinds.number("> 0 N/m, or 0 N/m for a constant force", lambda x: x >= kinds.SMALLEST or x == 0, minimum=0)
GROUP = kinds.printable_name("the name of a group, a non-empty string of printable characters")


class StringLaw(enum.Enum):
    """Law of taut strings: total tension clipped at zero (a real string), or not."""

    CLIPPED = "clipped"
    UNCLIPPED = "unclipped"


@value("support", StructureError)
class Support:
    """Support of a rod in space, at its point r = (1 - σ) n_i + σ n_j.

    Use the constructors `free`, `pinned` and `constrained`. The rows of `directions` are the matrix D of
    the thesis' D r = r̄ (2.40): none for a free rod, three independent ones for a pinned rod. `plane` is the
    normal of a plane that the rod's direction b stays in (the rod turns about that normal only); a planar
    rod that is also to stay at its height needs the normal among its `directions`, which `free(plane=...)` and
    `constrained(..., plane=...)` add by themselves.
    """

    sigma: float = field(kinds.within(0, 1), default=0.5)
    directions: tuple[Vector, ...] = field(
        kinds.many(kinds.vector(""), "rows of three numbers, as [[0, 0, 1]]"), default=(), key="D"
    )
    # r̄; None: what the reference nodes give
    values: tuple[float, ...] | None = field(rows(), default=None, none="None for what the nodes give")
    plane: Vector | None = field(kinds.direction(), default=None, none="None for space")

    def __attrs_post_init__(self) -> None:
        D = np.array(self.directions).reshape(-1, 3)
        if len(D) > 3 or (len(D) and np.linalg.matrix_rank(unit_rows(D), tol=1e-6) < len(D)):
            raise refused(
                self, f"the rows of D = {D.tolist()} contradict or repeat each other; they must be independent"
            )
        if self.values is not None and len(self.values) != len(D):
            raise refused(self, f"values: r̄ has {len(self.values)} values for {len(D)} rows of D; give one a row")
        if self.values == ():
            object.__setattr__(self, "values", None)

    @classmethod
    def free(cls, sigma: float = 0.5, plane: Sequence[float] | None = None) -> Support:
        """No support; σ only chooses the point whose motion describes the rod."""
        return cls(sigma, (), None, plane)  # type: ignore[arg-type]

    @classmethod
    def pinned(cls, sigma: float = 0.0, plane: Sequence[float] | None = None) -> Support:
        """The point at σ is fixed in space; the rod turns freely about it (in `plane`, if given)."""
        identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        return cls(sigma, identity, None, plane)  # type: ignore[arg-type]

    @classmethod
    def constrained(
        cls,
        D: ArrayLike,
        sigma: float = 0.0,
        values: Sequence[float] | None = None,
        plane: Sequence[float] | None = None,
    ) -> Support:
        """The point at σ obeys D r = r̄ (2.40); D is (1, 3), (2, 3) or (3, 3) with independent rows.

        Raises:
            StructureError: if D or r̄ is not of that shape.
        """
        rows = list(D) if isinstance(D, (list, tuple)) or (isinstance(D, np.ndarray) and D.ndim) else D
        if rows == []:
            raise StructureError(
                "support: D = []; it must be one to three rows of three numbers, as [[0, 0, 1]]; use Support.free where"
                " nothing holds the rod"
            )
        one_row = isinstance(rows, list) and not any(np.iterable(row) for row in rows)
        return cls(sigma, [rows] if one_row else rows, values, plane)  # type: ignore[arg-type]

    @property
    def constraint_rows(self) -> Array:
        """Every direction that the point at σ is held in, (r, 3): D, and the plane's normal if planar."""
        rows = list(self.directions)
        if self.plane is not None and len(rows) < 3:
            rows.append(self.plane)
        return np.array(rows, float).reshape(-1, 3)

    @cached_property
    def translation_basis(self) -> Array:
        """E of (2.41): orthonormal basis (3, nz) of the directions in which the point at σ moves."""
        return null_space_basis(self.constraint_rows)

    @cached_property
    def rotation_basis(self) -> Array:
        """Orthonormal basis (3, nb) of the directions that b may have: the plane, or all of space."""
        return null_space_basis(np.array([] if self.plane is None else [self.plane], float).reshape(-1, 3))


@value("mass on a rod", StructureError)
class RodMass:
    """A mass that a rod carries on its axis.

    Attributes:
        at: where, from 0 at the rod's first node to 1 at its second.
        mass: [kg], > 0.
        inertia: moment of inertia across the rod about its own centre [kg m²], >= 0; 0 for a point.
    """

    at: float = field(kinds.within(0, 1))
    mass: float = field(kinds.positive("kg"))
    inertia: float = field(kinds.not_negative("kg m²"), default=0.0)


@value("rod {name!r}", StructureError, whole=True)
class Rod:
    """A thin rod of uniform mass between two nodes, and the masses that it carries: rigid (thesis, Assumption 2.3), or
    elastic along itself.

    An elastic rod stays straight and uniform: it pulls its nodes together with k (L - L0) + c dL/dt, and pushes them
    apart where that is negative. Its section is for checks of members, whether it yields or buckles, and for statics.

    Attributes:
        name: unique among the rods.
        nodes: names of n_i and n_j; b points from the first to the second.
        mass: [kg], > 0, of the rod itself.
        radius: [m], > 0; for drawing, contact and drag only: the inertia is a thin rod's.
        support: the way in which it is held.
        section: cross section and material, None where not known; `mass` and `radius` do not follow from it.
        masses: masses that it carries, rigidly.
        group: common name of rods that belong together, in files, plots and sweeps; None for none.
        stiffness: k [N/m] along the rod, EA/L0 of a uniform one; None for a rigid rod.
        damping: c [N s/m] along an elastic rod.
        rest_length: L0 [m] of an elastic rod without force; None for its length at the reference nodes.
    """

    name: str = field(kinds.printable_name())
    nodes: tuple[str, str] = field(kinds.pair("node"))
    mass: float = field(kinds.positive("kg"))
    radius: float = field(kinds.positive("m"), default=0.01)
    support: Support = field(
        kinds.part(Support, "Support.free, Support.pinned or Support.constrained"), default=Support()
    )
    section: Section | None = field(
        kinds.part(Section, "Section, Section.tube or Section.solid"), default=None, none="None"
    )
    masses: tuple[RodMass, ...] = field(kinds.parts(RodMass), default=())
    group: str | None = field(GROUP, default=None, none="absent")
    stiffness: float | None = field(kinds.positive("N/m"), default=None, none="absent")
    damping: float = field(kinds.not_negative("N s/m"), default=0.0)
    rest_length: float | None = field(LENGTH, default=None, none="absent")

    def __attrs_post_init__(self) -> None:
        if self.stiffness is not None and any(mass.inertia for mass in self.masses):
            raise refused(
                self, "masses: one has an inertia, but the rod is elastic: give it masses without, or two apart"
            )
        if self.stiffness is None and (self.damping or self.rest_length is not None):
            what = "damping" if self.damping else "rest_length"
            raise refused(self, f"{what} = {getattr(self, what)!r}, but the rod is rigid: give it a stiffness as well")


@value("string {name!r}", StructureError)
class String:
    """A string between two nodes (law in `strings`), or along a path of more: massless (thesis, Assumption 2.1) unless
    it has a mass.

    `nodes` are those of its path, in order. It slides through those between its ends without friction, as over pulleys
    of no size: it has one rest length, one tension, and the length of all its segments together (`strings.Paths`).

    It is linear, T = k s of its stretch s = L - L0, or has a tension `curve`: points (s, T) [m], [N] of a polygon that
    begins at (0, 0) and goes on with its last slope; k is then the first one. It may stiffen, give way or stay level,
    and must not fall. With `yields`, it unloads along a line of slope k from the largest stretch that it has had and
    keeps a permanent stretch (`tension_curves`). A `stiffness` of 0 makes its `tension` a constant force at any length:
    there is no rest length that a law could set.

    `string_law` is that of this string alone, where it is not the structure's.

    At most one of `rest_length` [m], `tension` [N] and `force_density` [N/m] is given, the latter two at the
    structure's reference nodes; none of them means taut without tension there.

    Three are limits of a real string and its winch, None for none: the largest force density [N/m], the
    smallest rest length [m] and the largest speed of the rest length [m/s]. docs/laws.md says who keeps them.

    `strength` is the tension [N] at which it breaks, None where it is not known. Nothing keeps it: checks of members
    compare tensions with it. `group` is what strings that belong together are called in files, plots and sweeps.

    `mass` [kg] makes it a rope: light strings between `segments` point masses, 10 by default, see `ropes`.
    """

    name: str = field(kinds.printable_name())
    nodes: tuple[str, ...] = field(kinds.pair("node", more=True))
    stiffness: float = field(STIFFNESS, default=None, none="absent, with a curve")
    damping: float = field(kinds.not_negative("N s/m"), default=0.0)
    rest_length: float | None = field(LENGTH, default=None, none="absent")
    tension: float | None = field(kinds.not_negative("N"), default=None, none="absent")
    force_density: float | None = field(kinds.not_negative("N/m"), default=None, none="absent")
    max_force_density: float | None = field(kinds.positive("N/m"), default=None, none="absent")
    min_rest_length: float | None = field(kinds.positive("m"), default=None, none="absent")
    winch_speed: float | None = field(kinds.positive("m/s"), default=None, none="absent")
    strength: float | None = field(kinds.positive("N"), default=None, none="absent")
    group: str | None = field(GROUP, default=None, none="absent")
    curve: tuple[tuple[float, float], ...] = field(rows(2, "rows of two numbers, [stretch, tension]"), default=())
    yields: bool = field(kinds.flag(), default=False)
    string_law: StringLaw | None = field(kinds.choice(StringLaw), default=None, none="absent")
    mass: float | None = field(kinds.positive("kg"), default=None, none="absent for a massless string")
    segments: int | None = field(kinds.whole(1, MOST_SEGMENTS), default=None, none="absent")

    def __attrs_post_init__(self) -> None:
        given = [name for name in PRESTRESS if getattr(self, name) is not None]
        if len(given) > 1:
            raise refused(self, f"{' and '.join(given)} are given; give at most one of them")
        if self.stiffness is None:
            if not self.curve:
                raise refused(self, "'stiffness' is missing; it must be a number [N/m], or follow from a curve")
            object.__setattr__(self, "stiffness", self.curve[0][1] / self.curve[0][0] if self.curve[0][0] else 0.0)
        if wrong := _wrong_curve(self):
            raise refused(self, wrong)
        if self.curve:
            object.__setattr__(self, "stiffness", self.curve[0][1] / self.curve[0][0])
        if self.segments is not None and self.mass is None:
            raise refused(self, f"segments = {self.segments} without mass: a massless string has none; give both")
        if self.mass is not None and len(self.nodes) > 2:
            raise refused(
                self,
                f"mass = {self.mass:g} kg on a path of {len(self.nodes)} nodes: a string slides over pulleys without "
                "mass only; leave its mass out, or end strings with mass at the pulleys",
            )
        if self.mass is not None and self.is_constant:
            raise refused(self, f"mass = {self.mass:g} kg with a constant force: it has no rest length to be shared")

    @property
    def is_constant(self) -> bool:
        """True where the string pulls with a constant force."""
        return self.stiffness == 0

    @property
    def is_linear(self) -> bool:
        """True where the string has a stiffness and no curve beyond it."""
        return self.stiffness > 0 and len(self.curve) < 2

    def scaled_to(self, stiffness: float, **changes: Any) -> String:
        """A copy with another stiffness [N/m], a curve with tensions in that proportion, and other changes."""
        curve = tuple((s, T * (stiffness / self.stiffness)) for s, T in self.curve)
        given: Any = None if curve else stiffness
        return replace(self, stiffness=given, curve=curve, **changes)

    @property
    def unordered(self) -> tuple[str, ...]:
        """Nodes of the string in an order that does not depend on which end comes first."""
        return min(self.nodes, self.nodes[::-1])


def _wrong_curve(string: String) -> str:
    """Describe an error in a string's stiffness or curve of tension over stretch; "" for none."""
    k, curve = string.stiffness, string.curve
    if string.is_constant and not curve:
        others = [name for name in ("rest_length", "force_density", *LIMITS, "yields") if getattr(string, name)]
        if string.tension and not others:
            return ""
        but = f" and no {others[0]}" if others else ""
        return f"stiffness = {k!r}; it must be > 0 N/m, or for a constant force 0 with a tension > 0 N{but}"
    points = ((0.0, 0.0), *curve)
    for place, ((s0, T0), (s1, T1)) in enumerate(zip(points, curve, strict=False)):
        if not s1 > s0:
            return f"curve[{place}]: its stretch of {s1:g} m must be above {s0:g} m, of the point before"
        if T1 < T0 or T1 <= 0:
            return (
                f"curve[{place}]: its tension of {T1:g} N must be above zero and not below {T0:g} N, of the point "
                "before: where a curve falls, a string has several lengths at one tension, and breaks"
            )
    if curve and abs(curve[0][1] / curve[0][0] - k) > 1e-9 * k:
        return (
            f"stiffness = {k:g} N/m, but its curve begins with {curve[0][1] / curve[0][0]:g} N/m: leave stiffness out"
        )
    slopes = [(T1 - T0) / (s1 - s0) for (s0, T0), (s1, T1) in zip(points, curve, strict=False)]
    if string.yields and (len(curve) < 2 or max(slopes) > k * (1 + 1e-9)):
        return (
            "yields needs a curve of two points or more that nowhere rises faster than at first: it unloads with the "
            f"first slope, {k:g} N/m"
        )
    if len(curve) > 1 and string.min_rest_length is not None:
        return "min_rest_length is for linear strings: a law turns it into a force density by k; use max_force_density"
    return ""


@value("point mass on node {node!r}", StructureError)
class PointMass:
    """A point mass on a node. Where rods end there, they carry it; elsewhere it moves freely in space, or in a plane.

    Attributes:
        node: where it is.
        mass: [kg], > 0.
        plane: normal of the plane that it moves in; None on a node of rods, where it moves as they do.
        damping: c >= 0 [N s/m] of the viscous force -c v on the node, v its velocity in the world.
    """

    node: str = field(kinds.printable_name())
    mass: float = field(kinds.positive("kg"))
    plane: Vector | None = field(kinds.direction(), default=None, none="None for space")
    damping: float = field(kinds.not_negative("N s/m"), default=0.0)

    @property
    def translation_basis(self) -> Array:
        """Orthonormal basis (3, nz) of the directions in which the mass moves."""
        return null_space_basis(np.array([] if self.plane is None else [self.plane], float).reshape(-1, 3))


def lumps_of(rods: Sequence[Rod], lengths: Array, points: Sequence[PointMass]) -> Array:
    """(3, R): Σ m [kg], Σ m s and Σ (m s² + I/ℓ²) of what each rod carries, s from 0 at n_i to 1 at n_j.

    That is its `masses`, and the point masses at its ends, each on the first rod there.
    """
    found = np.zeros((3, len(rods)))
    first: dict[str, tuple[int, int]] = {}
    for row, (rod, length) in enumerate(zip(rods, lengths, strict=True)):
        for end, name in enumerate(rod.nodes):
            first.setdefault(name, (row, end))
        for lump in rod.masses:
            moment = lump.mass * lump.at**2 + lump.inertia / length**2
            found[:, row] += (lump.mass, lump.mass * lump.at, moment)
    for point in points:
        if point.node in first:
            row, end = first[point.node]
            found[:, row] += (point.mass, end * point.mass, end * point.mass)
    return found


def null_space_basis(rows: Array) -> Array:
    """Orthonormal basis (3, 3 - r) of the vectors orthogonal to the given rows (r, 3), which is not to be changed.

    Columns are aligned with world axes where those are admissible, so that axis-parallel supports give
    unit vectors exactly.
    """
    if all(sum(map(bool, row)) == 1 for row in rows.tolist()):  # along axes, or none
        basis = np.eye(3)[:, ~rows.any(axis=0)]
    else:
        basis = null_space_bases(rows[None])[0]
    basis.flags.writeable = False
    return basis


def null_space_bases(stack: Array) -> Array:
    """(K, 3, 3 - r) the bases of `null_space_basis` for a stack of rows (K, r, 3) of one rank."""
    # Unit rows: the length of the row that states a direction does not matter.
    _, singular, vt = np.linalg.svd(stack / np.sqrt((stack * stack).sum(axis=2))[..., None])
    rank = int(np.sum(singular[:1] > 1e-9 * singular[:1, :1]))
    projector = vt[:, rank:].swapaxes(1, 2) @ vt[:, rank:]
    basis, each = np.empty((len(stack), 3 - rank, 3)), np.arange(len(stack))
    for number in range(3 - rank):
        # The most admissible world axis next (Gram-Schmidt with pivoting).
        lengths = np.sqrt((projector * projector).sum(axis=1))
        axis = lengths.round(9).argmax(axis=1)
        column = projector[each, :, axis] / lengths[each, axis, None]
        column[np.abs(column) < 1e-16] = 0.0
        column /= np.sqrt(column[:, None] @ column[:, :, None])[:, 0]
        basis[:, number] = column
        projector = projector - column[:, :, None] * (column[:, None] @ projector)
    return basis.swapaxes(1, 2)


def unit_rows(rows: Array) -> Array:
    """The rows (r, 3) at length one; those of no length as they are."""
    return rows / np.where(np.linalg.norm(rows, axis=1) > 0, np.linalg.norm(rows, axis=1), 1.0)[:, None]
