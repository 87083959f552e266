"""Quantities of thin rods from their ends: direction, inertia, energy, the multiplier of rigidity; energy of all.

Every function takes node positions and velocities (..., N, 3) in the world frame, SI units.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray, dot, norm
from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.basics.remembered import once
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.members import Rod
from tensegrity_mj.model.structure import Structure

NONE = (0.0, 0.0, 0.0)


def inertia_terms(mass: Any, length: Any, sigma: Any, lumps: Any = NONE) -> tuple[Any, Any]:
    """f(σ) [kg m] and J(σ) [kg m²] of (2.30), for uniform rods of that mass with lumps; arguments broadcast.

    `lumps` is a column of `Structure.rod_lumps`, or all of it: f = ∫ (s - σ) ℓ dm and J = ∫ (s - σ)² ℓ² dm.
    """
    total, first, second = lumps
    f = 0.5 * mass * length * (1 - 2 * sigma) + length * (first - sigma * total)
    J = mass * length**2 * (1 - 3 * sigma + 3 * sigma**2) / 3
    return f, J + length**2 * (second - 2 * sigma * first + sigma**2 * total)


@once
def inertia_of_rods(structure: Structure) -> tuple[Array, Array]:
    """f and J (R,) at the rods' own σ."""
    return inertia_terms(own_masses(structure), structure.rod_lengths, _sigmas(structure), structure.rod_lumps)


def centers_and_moments(mass: Any, length: Any, lumps: Any = NONE) -> tuple[Any, Any]:
    """Centres of mass, from 0 to 1 along rods, and moments of inertia [kg m²] about them; as `inertia_terms`."""
    total, first, second = lumps
    center = (0.5 * mass + first) / (mass + total)
    beside = mass * (0.5 - center) ** 2 + (second - 2 * center * first + center**2 * total)
    return center, mass * length**2 / 12 + length**2 * beside


def axial_moment(rod: Rod) -> float:
    """Moment of inertia [kg m²] of a rod about its own axis: of its section, as of a round one, or a solid cylinder.

    What it carries are points on the axis.
    """
    section = rod.section
    return rod.mass * (0.5 * rod.radius**2 if section is None else 2 * section.second_moment / section.area)


def mass_products(mass: Any, lumps: Any = NONE) -> tuple[Any, Any, Any]:
    """∫ (1 - s)² dm, ∫ s² dm and ∫ s (1 - s) dm [kg]: the masses of the ends in ½ (a v_i² + b v_j² + 2 c v_i·v_j)."""
    total, first, second = lumps
    return mass / 3 + (total - 2 * first + second), mass / 3 + second, mass / 6 + (first - second)


def rod_number(structure: Structure, rod: str | None) -> int:
    """The number of the rod of a name; the first by default.

    Raises:
        OptionError: if there is none.
    """
    names = [one.name for one in structure.rods]
    if not names:
        raise OptionError(f"structure '{structure.name}' has no rods; plot_errors shows its point masses")
    if rod is None:
        return 0
    check_known(f"structure '{structure.name}'", rod, names, "rod")
    return names.index(rod)


def own_masses(structure: Structure) -> Array:
    """(R,) [kg] of the rods alone, without what they carry."""
    return np.array([rod.mass for rod in structure.rods], float)


def diameters(structure: Structure, every: float | None) -> Array:
    """(R,) [m] of the rods in a fluid: one for all of them, or None for twice each rod's own radius."""
    return np.array([2 * rod.radius if every is None else every for rod in structure.rods], float)


def ends(structure: Structure, nodes: Array) -> tuple[Array, Array]:
    """Positions (or velocities) of the rods' first and second nodes, (..., R, 3) each."""
    return nodes[..., structure.rod_nodes[:, 0], :], nodes[..., structure.rod_nodes[:, 1], :]


def directions(structure: Structure, nodes: Array) -> Array:
    """b (..., R, 3) of (2.4): from a rod's first node to its second over its length; of velocities ḃ [1/s]."""
    first, second = ends(structure, nodes)
    return (second - first) / structure.rod_lengths[:, None]


def support_points(structure: Structure, nodes: Array) -> Array:
    """r (..., R, 3) of (2.6): the point (1 - σ) n_i + σ n_j of each rod."""
    first, second = ends(structure, nodes)
    sigma = np.array([rod.support.sigma for rod in structure.rods])[:, None]
    return (1.0 - sigma) * first + sigma * second


def kinetic_energy(structure: Structure, velocities: Array) -> Array:
    """Kinetic energy [J] of rods, point masses and bodies, (...): (2.25) in terms of the ends' velocities."""
    first, second = ends(structure, velocities)
    # ∫ |v|² over a linear velocity profile: (v1·v1 + v1·v2 + v2·v2) / 3.
    square = np.sum(first * first + first * second + second * second, axis=-1) / 3
    energy = 0.5 * np.sum(own_masses(structure) * square, axis=-1)
    for row in np.flatnonzero(structure.rod_lumps[0]):
        v1, v2 = first[..., row, :], second[..., row, :]
        a, b, c = mass_products(0.0, structure.rod_lumps[:, row])
        energy = energy + 0.5 * (a * dot(v1, v1) + b * dot(v2, v2)) + c * dot(v1, v2)
    for point in structure.lone_masses:
        v = velocities[..., structure.node_index[point.node], :]
        energy = energy + 0.5 * point.mass * dot(v, v)
    for frame in structure.frames:
        v = velocities[..., frame.rows, :]
        energy = energy + 0.5 * np.einsum("...ax,ab,...bx->...", v, frame.masses, v)
    return energy


def mass_at_ends(structure: Structure) -> Array:
    """(R, 2) [kg]: ∫ (1 - s) dm and ∫ s dm of each rod."""
    half, (total, first, _) = 0.5 * own_masses(structure), structure.rod_lumps
    return np.stack([half + (total - first), half + first], axis=1)


@once
def lumped_masses(structure: Structure) -> Array:
    """(N,) [kg]: half a uniform rod's mass at each end, point masses where they are. Exact for weight and momentum.

    Of a body as much at each node, of any sign, as the centre of mass is of them.
    """
    masses = np.zeros(len(structure.nodes))
    np.add.at(masses, structure.rod_nodes, mass_at_ends(structure))
    for point in structure.lone_masses:
        masses[structure.node_index[point.node]] += point.mass
    for body, frame in zip(structure.bodies, structure.frames, strict=True):
        masses[frame.rows] += body.mass * frame.fit[0]
    return masses


def total_mass(structure: Structure) -> float:
    """[kg] of all members."""
    points = sum(point.mass for point in structure.lone_masses)
    return float(structure.rod_masses.sum()) + points + sum(body.mass for body in structure.bodies)


def centre_of_mass(structure: Structure, nodes: Array) -> Array:
    """(..., 3) [m] of nodes (..., N, 3)."""
    masses = lumped_masses(structure)
    return np.asarray(np.einsum("n,...nk->...k", masses / masses.sum(), nodes))


def mass_places(structure: Structure) -> list[tuple[int, int, float, str]]:
    """List the given masses on nodes and rods: node rows i, j, the part s of the way between; and a description."""
    points = [
        (i, i, 0.0, f"{one.mass:.4g} kg at {one.node}")
        for one in structure.given.point_masses
        for i in [structure.node_index[one.node]]
    ]
    return points + [
        (i, j, one.at, f"{one.mass:.4g} kg on {rod.name}")
        for rod, (i, j) in zip(structure.rods, structure.rod_nodes.tolist(), strict=True)
        for one in rod.masses
    ]


def gravity_energy(structure: Structure, nodes: Array, gravity: Array) -> Array:
    """-Σ m g·x [J], (...)."""
    return -(nodes @ np.asarray(gravity, float)) @ lumped_masses(structure)


def string_forces(structure: Structure, nodes: Array, tensions: Array) -> Array:
    """Forces of the strings on the nodes [N], (..., N, 3), for tensions (..., M)."""
    paths = structure.paths
    s = paths.spans(nodes)
    before = range(s.ndim - 2)
    pull = (s * (tensions[..., paths.strings] / norm(s))[..., None]).transpose(-2, *before, -1).copy()
    forces = np.zeros((len(structure.nodes), *pull.shape[1:]))
    for (i, j), one in zip(paths.nodes.tolist(), pull, strict=True):
        forces[i] += one
        forces[j] -= one
    return np.ascontiguousarray(forces.transpose(*(n + 1 for n in before), 0, -1))


def multipliers(
    structure: Structure,
    nodes: Array,
    velocities: Array,
    first: Array,
    second: Array,
    gravity: Array,
    r_accelerations: Array,
) -> Array:
    """λ (..., R) [1/s²] of (2.36) from forces (..., R, 3) on both ends of each rod, and r̈ (..., R, 3) at σ.

    λ = (|ḃ|/|b|)² - bᵀ (f r̈ - t_b) / (J |b|²); t_b collects these forces and the weight. Where rods share a node, they
    pull each other there.
    """
    length = structure.rod_lengths[:, None]
    sigma = _sigmas(structure)
    f, J = inertia_of_rods(structure)
    (x1, x2), (v1, v2) = ends(structure, nodes), ends(structure, velocities)
    b, b_rate = (x2 - x1) / length, (v2 - v1) / length
    t_b = length * ((1 - sigma)[:, None] * second - sigma[:, None] * first) + f[:, None] * np.asarray(gravity, float)
    square = dot(b, b)
    along = dot(b, f[:, None] * r_accelerations - t_b)
    return dot(b_rate, b_rate) / square - along / (J * square)


class Bars(NamedTuple):
    """The E elastic rods of a structure: their rows (E,), nodes (E, 2), k [N/m], c [N s/m] and ℓ [m], (E,) each."""

    rows: IntArray
    nodes: IntArray
    stiffness: Array
    damping: Array
    lengths: Array

    @classmethod
    def of(cls, structure: Structure) -> Bars:
        """Bars of a structure: its elastic rods."""
        rows = np.flatnonzero(structure.elastic)
        damping = np.array([structure.rods[row].damping for row in rows], float)
        lengths = structure.rod_lengths[rows]
        return cls(rows, structure.rod_nodes[rows], structure.rod_stiffness[rows], damping, lengths)

    def stretched(self, nodes: Array, velocities: Array) -> tuple[Array, Array, Array]:
        """Spans (..., E, 3) [m], lengths [m] and forces N [N] (..., E) at positions and velocities (..., N, 3)."""
        (i, j), v = self.nodes.T, velocities
        spans = nodes[..., j, :] - nodes[..., i, :]
        now = norm(spans)
        rates = dot(spans, v[..., j, :] - v[..., i, :]) / now
        return spans, now, self.stiffness * (now - self.lengths) + self.damping * rates


def with_elastic_multipliers(structure: Structure, nodes: Array, velocities: Array, multipliers: Array) -> Array:
    """λ (..., R) with those of elastic rods from their axial forces N: J λ / ℓ² = N / L."""
    bars, found = Bars.of(structure), multipliers.copy()
    _, lengths, forces = bars.stretched(nodes, velocities)
    found[..., bars.rows] = forces / lengths * bars.lengths**2 / inertia_of_rods(structure)[1][bars.rows]
    return found


def force_densities(structure: Structure, multipliers: Array) -> Array:
    """J λ / ℓ² [N/m] of the rods, (..., R); negative in compression."""
    _, J = inertia_of_rods(structure)
    return multipliers * J / structure.rod_lengths**2


def lengths(structure: Structure, nodes: Array) -> Array:
    """ℓ (..., R) [m] of the rods at nodes (..., N, 3): those of elastic ones as they are there."""
    first, second = ends(structure, nodes)
    return np.where(structure.elastic, norm(second - first), structure.rod_lengths)


def _sigmas(structure: Structure) -> Array:
    return np.array([rod.support.sigma for rod in structure.rods], float)
