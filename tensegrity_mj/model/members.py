"""Members of a structure: rods, strings, point masses, supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.section import Section

Vector = tuple[float, float, float]


LIMITS = ("max_force_density", "min_rest_length", "winch_speed")  # of a string


@dataclass(frozen=True)
class Support:
    """How a rod is held in space, at the point r = (1 - σ) n_i + σ n_j of it.

    Use the constructors `free`, `pinned` and `constrained`. The rows of `directions` are the matrix D of
    the thesis' D r = r̄ (2.40): none for a free rod, three independent ones for a pinned rod. `plane` is the
    normal of a plane that the rod's direction b stays in (the rod turns about that normal only); a planar
    rod that is also to stay at its height needs the normal among its `directions`, which `free(plane=...)` and
    `constrained(..., plane=...)` add by themselves.
    """

    sigma: float = 0.5
    directions: tuple[Vector, ...] = ()
    values: tuple[float, ...] | None = None  # r̄; None: what the reference nodes give
    plane: Vector | None = None

    @classmethod
    def free(cls, sigma: float = 0.5, plane: Sequence[float] | None = None) -> Support:
        """No support; σ only chooses the point whose motion describes the rod."""
        return cls(sigma, (), None, _vector_or_none(plane))

    @classmethod
    def pinned(cls, sigma: float = 0.0, plane: Sequence[float] | None = None) -> Support:
        """The point at σ is fixed in space; the rod turns freely about it (in `plane`, if given)."""
        identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        return cls(sigma, identity, None, _vector_or_none(plane))

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
        from tensegrity_mj.basics.values import array_of_shape

        one_row = np.array(D, dtype=object).ndim == 1
        matrix = array_of_shape("D", D, (3,) if one_row else (-1, 3), broadcast=False).reshape(-1, 3)
        rows = tuple((float(a), float(b), float(c)) for a, b, c in matrix)
        if values is not None:
            values = tuple(array_of_shape("r̄ (one value a row of D)", values, (len(rows),), broadcast=False).tolist())
        return cls(sigma, rows, values, _vector_or_none(plane))

    @property
    def constraint_rows(self) -> Array:
        """Every direction that the point at σ is held in, (r, 3): D, and the plane's normal if planar."""
        rows = list(self.directions)
        if self.plane is not None and len(rows) < 3:
            rows.append(self.plane)
        return np.array(rows, float).reshape(-1, 3)

    @property
    def translation_basis(self) -> Array:
        """E of (2.41): orthonormal basis (3, nz) of the directions in which the point at σ moves."""
        return null_space_basis(self.constraint_rows)

    @property
    def rotation_basis(self) -> Array:
        """Orthonormal basis (3, nb) of the directions that b may have: the plane, or all of space."""
        return null_space_basis(np.array([] if self.plane is None else [self.plane], float).reshape(-1, 3))


@dataclass(frozen=True)
class Rod:
    """A rigid thin rod of uniform mass between two nodes (thesis, Assumption 2.3).

    Engines simulate every rod as rigid. Its section is for what is asked of it in statics: how far it gives under
    its force, and whether it yields or buckles.

    Attributes:
        name: unique among the rods.
        nodes: names of n_i and n_j; b points from the first to the second.
        mass: [kg], > 0.
        radius: [m], > 0; for drawing, contact and drag only: the inertia is a thin rod's.
        support: how it is held.
        section: cross section and material, None where not known; `mass` and `radius` do not follow from it.
    """

    name: str
    nodes: tuple[str, str]
    mass: float
    radius: float = 0.01
    support: Support = field(default_factory=Support)
    section: Section | None = None


@dataclass(frozen=True)
class String:
    """A massless linear string between two nodes (thesis, Assumption 2.1; law in `strings`).

    At most one of `rest_length` [m], `tension` [N] and `force_density` [N/m] is given, the latter two at the
    structure's reference nodes; none of them means taut without tension there.

    Three are limits of a real string and its winch, None for none: the largest force density [N/m], the
    smallest rest length [m] and the largest speed of the rest length [m/s]. docs/laws.md says who keeps them.

    `strength` is the tension [N] at which it breaks, None where it is not known. Nothing keeps it: checks of members
    compare tensions with it.
    """

    name: str
    nodes: tuple[str, str]
    stiffness: float
    damping: float = 0.0
    rest_length: float | None = None
    tension: float | None = None
    force_density: float | None = None
    max_force_density: float | None = None
    min_rest_length: float | None = None
    winch_speed: float | None = None
    strength: float | None = None


@dataclass(frozen=True)
class PointMass:
    """A point mass [kg] on a node that no rod touches; it moves freely in space, or in a plane."""

    node: str
    mass: float
    plane: Vector | None = None

    @property
    def translation_basis(self) -> Array:
        """Orthonormal basis (3, nz) of the directions in which the mass moves."""
        return null_space_basis(np.array([] if self.plane is None else [self.plane], float).reshape(-1, 3))


def null_space_basis(rows: Array) -> Array:
    """Orthonormal basis (3, 3 - r) of the vectors orthogonal to the given rows (r, 3).

    Columns are aligned with world axes where those are admissible, so that axis-parallel supports give
    unit vectors exactly.
    """
    if len(rows) == 0:
        return np.eye(3)
    # Unit rows: a direction constrains equally whatever the length of the row that states it.
    _, singular, vt = np.linalg.svd(rows / np.linalg.norm(rows, axis=1)[:, None])
    rank = int(np.sum(singular > 1e-9 * singular[0]))
    projector = vt[rank:].T @ vt[rank:]
    basis: list[Array] = []
    for _ in range(3 - rank):
        # The most admissible world axis next (Gram-Schmidt with pivoting).
        lengths = np.linalg.norm(projector, axis=0)
        axis = int(np.argmax(np.round(lengths, 9)))
        column = projector[:, axis] / lengths[axis]
        column[np.abs(column) < 1e-16] = 0.0
        column /= np.linalg.norm(column)
        basis.append(column)
        projector = projector - np.outer(column, column @ projector)
    return np.array(basis).reshape(-1, 3).T


def _vector_or_none(values: Sequence[float] | None) -> Vector | None:
    from tensegrity_mj.basics.values import array_of_shape

    return None if values is None else _vector(array_of_shape("plane normal", values, (3,), broadcast=False))


def _vector(values: Sequence[float] | Array) -> Vector:
    x, y, z = (float(v) for v in values)
    return (x, y, z)


def _plain_rod(rod: Rod) -> Rod:
    support = rod.support
    support = Support(
        sigma=float(support.sigma),
        directions=tuple(_vector(row) for row in support.directions),
        values=tuple(float(x) for x in support.values) if support.values is not None and support.directions else None,
        plane=None if support.plane is None else _vector(support.plane),
    )
    i, j = rod.nodes
    section = None if rod.section is None else _plain_section(rod.section)
    return Rod(str(rod.name), (str(i), str(j)), float(rod.mass), float(rod.radius), support, section)


def _plain_section(section: Section) -> Section:
    stress = None if section.yield_stress is None else float(section.yield_stress)
    return Section(float(section.area), float(section.second_moment), float(section.elasticity_modulus), stress)


def _plain_string(string: String) -> String:
    i, j = string.nodes
    names = ("rest_length", "tension", "force_density", *LIMITS, "strength")
    rest = (None if getattr(string, name) is None else float(getattr(string, name)) for name in names)
    return String(str(string.name), (str(i), str(j)), float(string.stiffness), float(string.damping), *rest)


def _plain_point_mass(point: PointMass) -> PointMass:
    return PointMass(str(point.node), float(point.mass), None if point.plane is None else _vector(point.plane))
