"""Minimal-mass sizing: how thick the members of a structure must be at least, at given nodes and under given loads.

    sizing = minimal_mass(structure, loads, rods=ALUMINIUM, strings=ALUMINIUM)
    sizing.mass, sizing.rod_radii, sizing.describe()
    sized = minimal_mass(structure, loads, rods=STEEL, strings=STEEL, least_radius=1e-3).structure

Rods are solid round bars that carry compression or tension; they yield, or buckle between two ball joints. Strings only
pull, and yield. The forces are free as far as they balance the loads: the best prestress results as well. This is
the problem of MOTES (Goyal, Chen, Majji and Skelton, 2019; Nagase and Skelton, 2014), solved to global optimality, see
`least_mass`: every result comes with a lower bound, below which no choice of forces can come.

With several load cases each has forces of its own, and members bear the worst of them: rest lengths are set for each
case. With gravity the weight of the rods counts, half of it at either end, and that of point masses; strings are
without weight, as they are in the engines.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import qr
from scipy.optimize import lsq_linear

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance, positive, real_array, whole
from tensegrity_mj.basics.fields import field, function_of, value
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.rigidity import members_at, nodal_forces
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Boundary, Hold
from tensegrity_mj.statics.least_mass import NO_FORCE, Optimum, Problem, Search
from tensegrity_mj.statics.listing import by_member


@value("material", OptionError)
class Material:
    """A material that yields at the same stress in tension and compression.

    Attributes:
        density: ρ [kg/m³], > 0.
        elasticity_modulus: E [Pa], > 0.
        yield_stress: σ_y [Pa], > 0.

    Raises:
        OptionError: for a number that is not finite and > 0.
    """

    density: float = field(kinds.positive("kg/m³"))
    elasticity_modulus: float = field(kinds.positive("Pa"))
    yield_stress: float = field(kinds.positive("Pa"))


# The three that MOTES (Goyal, Chen, Majji and Skelton, 2019) knows, with its numbers, so that results can be compared.
ALUMINIUM = Material(2700.0, 60e9, 110e6)
STEEL = Material(8000.0, 200e9, 300e6)
UHMWPE = Material(970.0, 120e9, 2.7e9)  # polyethylene of ultra high molecular weight, as fibre


class Governs(enum.Enum):
    """Reasons that decide how thick a member is."""

    YIELD = "yield"
    BUCKLING = "buckling"
    LEAST_RADIUS = "least radius"
    NOTHING = "nothing"  # it carries no force, and has no mass


@dataclass(frozen=True, eq=False)
class Sizing:
    """The lightest members that were found, and what they carry; K load cases, R rods, M strings.

    Attributes:
        given: the structure that was sized; nodes are at its reference.
        rod_materials, string_materials: (R,), (M,).
        rod_masses, string_masses: (R,), (M,) [kg].
        rod_forces: N (K, R) [N], negative in compression.
        tensions: T (K, M) [N].
        reactions: (K, N, 3) [N] what supports and holds push the nodes with.
        rod_governs, string_governs: what decides each member.
        lower_bound: [kg]: no sizing is lighter.
        tolerance: how far above the lower bound the mass may be, relative, for `is_proven`.
        programs: how many linear programs it took.
    """

    given: Structure
    rod_materials: tuple[Material, ...]
    string_materials: tuple[Material, ...]
    rod_masses: Array
    string_masses: Array
    rod_forces: Array
    tensions: Array
    reactions: Array
    rod_governs: tuple[Governs, ...]
    string_governs: tuple[Governs, ...]
    lower_bound: float
    tolerance: float
    programs: int

    @property
    def mass(self) -> float:
        """[kg] of all rods and strings."""
        return float(self.rod_masses.sum() + self.string_masses.sum())

    @property
    def gap(self) -> float:
        """Distance of the mass from the lower bound, as a part of the mass."""
        return (self.mass - self.lower_bound) / self.mass if self.mass > 0 else 0.0

    @property
    def is_proven(self) -> bool:
        """True where the mass is the least possible, within the tolerance (and the round-off of linear programs)."""
        return self.gap <= 1.001 * self.tolerance + 1e-9

    @property
    def rod_force_densities(self) -> Array:
        """N / ℓ (K, R) [N/m], negative in compression."""
        return np.asarray(self.rod_forces / self.given.rod_lengths)

    @cached_property
    def force_densities(self) -> Array:
        """T / L (K, M) [N/m] of the strings."""
        return np.asarray(self.tensions / self.given.string_lengths(self.given.positions))

    @cached_property
    def rod_radii(self) -> Array:
        """(R,) [m] of the solid bars."""
        return _radii(self.rod_masses, self.rod_materials, self.given.rod_lengths)

    @cached_property
    def string_radii(self) -> Array:
        """(M,) [m] of strings of round section."""
        return _radii(self.string_masses, self.string_materials, self.given.string_lengths(self.given.positions))

    @cached_property
    def structure(self) -> Structure:
        """The structure with what was found: masses, radii and sections of rods; stiffness, rest length and strength of
        strings, tight as in the first load case.

        Raises:
            OptionError: if a member has no mass; a `least_radius` gives it some.
        """
        names = [f"rod '{rod.name}'" for rod in self.given.rods]
        names += [f"string '{string.name}'" for string in self.given.strings]
        for name, mass in zip(names, [*self.rod_masses, *self.string_masses], strict=True):
            if not mass > 0:
                raise OptionError(
                    f"sizing: {name} carries nothing, so that its least mass is zero, and there is no such member; "
                    "give minimal_mass a least_radius, or leave it out of the structure"
                )
        rods = []
        parts = (self.given.rods, self.given.rod_lengths, self.rod_masses, self.rod_radii, self.rod_materials)
        for rod, length, mass, radius, of in zip(*(list(part) for part in parts), strict=True):
            section = Section.solid(float(radius), of.elasticity_modulus, of.yield_stress)
            k = None if rod.stiffness is None else section.axial_stiffness / float(length)
            rods.append(replace(rod, mass=float(mass), radius=float(radius), section=section, stiffness=k))
        area = np.pi * self.string_radii**2
        axial = np.array([of.elasticity_modulus for of in self.string_materials]) * area
        rest = self.given.string_lengths(self.given.positions) / (1.0 + self.tensions[0] / axial)
        strength = np.array([of.yield_stress for of in self.string_materials]) * area
        return replace(self.given, rods=tuple(rods)).with_strings(
            stiffness=axial / rest, rest_length=rest, strength=strength
        )

    def describe(self) -> tuple[str, ...]:
        """Return a description, as lines of text."""
        proof = (
            f"the least possible, to {max(self.gap, 1e-9):.1g} of it"
            if self.is_proven
            else f"not proven to be the least: what is possible is no less than {self.lower_bound:.6g} kg"
        )
        lines = [
            f"{self.mass:.6g} kg: {self.rod_masses.sum():.6g} kg of rods, {self.string_masses.sum():.6g} kg of strings",
            f"{proof}; {self.programs} linear programs",
        ]
        for kind, members, governs in (
            ("rods", self.given.rods, self.rod_governs),
            ("strings", self.given.strings, self.string_governs),
        ):
            counts = {why: governs.count(why) for why in Governs}
            if members:
                lines.append(f"{kind}: " + ", ".join(f"{n} by {why.value}" for why, n in counts.items() if n))
        return tuple(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        rods = {"mass": self.rod_masses, "radius": self.rod_radii, "forces": self.rod_forces.T}
        strings = {"mass": self.string_masses, "radius": self.string_radii, "tensions": self.tensions.T}
        return {
            "mass": self.mass,
            "lower_bound": self.lower_bound,
            "gap": self.gap,
            "proven": self.is_proven,
            "programs": self.programs,
            "rods": by_member(self.given.rods, rods | {"governs": self.rod_governs}),
            "strings": by_member(self.given.strings, strings | {"governs": self.string_governs}),
        }


def _radii(masses: Array, materials: tuple[Material, ...], lengths: Array) -> Array:
    density = np.array([material.density for material in materials], float)
    return np.asarray(np.sqrt(masses / (np.pi * density * lengths)))


RANK = 1e-10  # of the largest row: equations below it say what others say already
SEEN = 1e-8  # of the largest force: a smaller one is not what makes a problem without solution


@dataclass(frozen=True, eq=False)
class MinimalMass:
    """The lightest members that bear the loads at the structure's reference nodes.

    Attributes:
        structure: its topology, nodes, supports and point masses count; masses, stiffnesses and rest lengths do not.
        loads: (N, 3) [N] forces on the nodes, or (K, N, 3) for K load cases; what holds a node takes those on it.
        rods, strings: the material of all of them, or one each.
        holds: nodes that are held in addition to the supports; their displacements play no role.
        gravity: (3,) [m/s²]; without it nothing has weight.
        least_force_density: [N/m] of the strings, a number or (M,): prestress that they are to keep.
        least_radius: [m] of all members, a number, or (R + M,) rods first.
        tolerance: how near to the least mass, relative.
        most_programs: linear programs after which the best so far is returned, with the lower bound so far.

    Raises:
        InfeasibleError: if no forces, with strings that only pull, balance the loads.
        OptionError: for arguments that do not fit, or a rod that is supported between its ends, which would bend it.
    """

    structure: Structure
    loads: ArrayLike | None = None
    _: KW_ONLY
    rods: Material | Sequence[Material]
    strings: Material | Sequence[Material]
    holds: Sequence[Hold] = ()
    gravity: ArrayLike | None = None
    least_force_density: ArrayLike = 0.0
    least_radius: ArrayLike = 0.0
    tolerance: float = 1e-6
    most_programs: int = 4000

    def __call__(self) -> Sizing:
        structure = self.structure
        instance("structure", structure, Structure, "it must be a Structure")
        tolerance = positive("tolerance", self.tolerance)
        most_programs = whole("most_programs", self.most_programs, 1)
        _check_supports(structure)
        R, M = len(structure.rods), len(structure.strings)
        Z = Boundary.of(structure, self.holds).Z
        bars, cords = (np.asarray(Z.T @ part) for part in self.pulls)
        weights, external = np.asarray(Z.T @ self.weights), np.asarray(self.external @ Z)
        a_b, a_s, c = self.rates
        least_tension = _least("least_force_density", self.least_force_density, M, "N/m") * self.lengths[1]
        # Units in which the numbers are of the order of one.
        own = np.abs(weights) @ self.least_masses[:R]
        # A column under its own weight alone, M = c √(M g / 2), carries about (c g)².
        column = (c.max(initial=0.0) * np.abs(weights).max(initial=0.0)) ** 2
        force = max(*(float(np.abs(x).max(initial=0.0)) for x in (external, own, least_tension, column)), 1e-300)
        pressed = float(np.abs(external).max(initial=0.0))
        if 0 < pressed < NO_FORCE * column and not own.any():
            raise InfeasibleError(
                f"structure '{structure.name}': loads of at most {pressed:.3g} N are too small to matter: "
                f"columns weigh about {column:.3g} N themselves; leave gravity out, or give a least_radius"
            )
        rates = np.concatenate([a_b, a_s, c / np.sqrt(force)])
        mass = force * float(rates.max(initial=0.0)) or 1.0
        keep = self._independent(np.hstack([bars, cords, weights * mass / force, external.T / force]))
        problem = Problem(
            strings=cords[keep],
            bars=bars[keep],
            weights=weights[keep] * (mass / force),
            forces=external[:, keep] / force,
            string_yield=a_s * (force / mass),
            bar_yield=a_b * (force / mass),
            bar_buckling=c * (np.sqrt(force) / mass),
            least_tension=least_tension / force,
            least_string=self.least_masses[R:] / mass,
            least_bar=self.least_masses[:R] / mass,
        )
        found = Search(problem, tolerance, most_programs).run()
        if found is None:
            raise InfeasibleError(self._why_not(problem, force))
        return self._result(problem, found, force, mass, tolerance)

    @cached_property
    def materials(self) -> tuple[tuple[Material, ...], tuple[Material, ...]]:
        """Materials of each rod and of each string."""
        R, M = len(self.structure.rods), len(self.structure.strings)
        return _materials("rods", self.rods, R), _materials("strings", self.strings, M)

    @cached_property
    def down(self) -> Array:
        """(3,) [m/s²]."""
        return real_array("gravity", np.zeros(3) if self.gravity is None else self.gravity, (3,), "m/s²", scalar=False)

    @cached_property
    def lengths(self) -> tuple[Array, Array]:
        structure = self.structure
        return structure.rod_lengths, structure.string_lengths(structure.positions)

    @cached_property
    def pulls(self) -> tuple[Array, Array]:
        """Forces on the nodes (3N, R) and (3N, M) of unit forces in members: each end is pulled to the other."""
        nodes, paths = self.structure.positions, self.structure.paths
        rods, segments = (
            nodal_forces(pairs, members_at(pairs, nodes).directions, len(nodes))
            for pairs in (self.structure.rod_nodes, paths.nodes)
        )
        return rods, paths.total(segments)

    @cached_property
    def weights(self) -> Array:
        """Forces on the nodes (3N, R) of unit masses of the rods."""
        shares = np.zeros((len(self.structure.nodes), len(self.structure.rods)))
        for column, pair in enumerate(self.structure.rod_nodes):
            shares[pair, column] += 0.5
        return (shares[:, None, :] * self.down[:, None]).reshape(3 * len(shares), shares.shape[1])

    @cached_property
    def external(self) -> Array:
        """Loads and weights of point masses and of what rods carry (K, 3N)."""
        forces = _load_cases(self.structure, self.loads)
        for point in self.structure.point_masses:
            forces[:, self.structure.node_index[point.node]] += point.mass * self.down
        for rod, pair in zip(self.structure.rods, self.structure.rod_nodes, strict=True):
            for lump in rod.masses:
                forces[:, pair] += lump.mass * np.outer((1 - lump.at, lump.at), self.down)
        return forces.reshape(len(forces), -1)

    @cached_property
    def rates(self) -> tuple[Array, Array, Array]:
        """a_b (R,) and a_s (M,) [kg/N] of yield, c (R,) [kg/√N] of buckling."""
        rods, strings = self.materials
        (ell, length) = self.lengths
        a_b = ell * np.array([m.density / m.yield_stress for m in rods])
        a_s = length * np.array([m.density / m.yield_stress for m in strings])
        c = 2.0 * ell**2 * np.array([m.density / np.sqrt(np.pi * m.elasticity_modulus) for m in rods])
        return a_b, a_s, c

    @cached_property
    def least_masses(self) -> Array:
        """(R + M,) [kg]."""
        density = np.array([m.density for part in self.materials for m in part])
        radius = _least("least_radius", self.least_radius, len(density), "m")
        return np.asarray(density * np.concatenate(self.lengths) * np.pi * radius**2)

    def _independent(self, matrix: Array) -> NDArray[np.int64]:
        """Rows of the equations that do not follow from others, whose round-off could contradict them."""
        if not matrix.size:
            return np.arange(len(matrix))
        _, triangle, order = qr(matrix.T, mode="economic", pivoting=True)
        diagonal = np.abs(np.diag(triangle))
        rank = int(np.sum(diagonal > RANK * diagonal[0])) if diagonal.size and diagonal[0] > 0 else 0
        return np.sort(order[:rank])

    def _result(self, problem: Problem, found: Optimum, force: float, mass: float, tolerance: float) -> Sizing:
        tensions, forces, bar_masses = _polished(problem, found)
        pulled = (problem.string_yield * tensions).max(axis=0, initial=0.0)
        string_masses = np.maximum(problem.least_string, pulled)
        R = len(self.structure.rods)
        sized = float((mass * bar_masses).sum() + (mass * string_masses).sum())
        held = -(self.external + mass * (self.weights @ bar_masses))
        held = held - force * (forces @ self.pulls[0].T + tensions @ self.pulls[1].T)
        needs = problem.bar_mass(forces)
        worst = needs.max(axis=0, initial=0.0)
        rows = needs.argmax(axis=0)
        compression = -forces[rows, np.arange(R)]
        buckles = (compression > 0) & (compression < problem.switch)
        return Sizing(
            given=self.structure,
            rod_materials=self.materials[0],
            string_materials=self.materials[1],
            rod_masses=mass * bar_masses,
            string_masses=mass * string_masses,
            rod_forces=force * forces,
            tensions=force * tensions,
            reactions=held.reshape(len(held), -1, 3),
            rod_governs=_governs(bar_masses, worst, problem.least_bar, buckles),
            string_governs=_governs(string_masses, pulled, problem.least_string, np.zeros(len(pulled), bool)),
            lower_bound=min(mass * found.lower, sized),
            tolerance=tolerance,
            programs=found.programs,
        )

    def _why_not(self, problem: Problem, force: float) -> str:
        name = f"structure '{self.structure.name}'"
        matrix = np.hstack([problem.strings, problem.bars])
        least = np.concatenate([problem.least_tension, np.full(problem.bars.shape[1], -np.inf)])
        for number, external in enumerate(problem.forces):
            case = "" if len(problem.forces) == 1 else f" of load case {number}"
            moved = float(np.linalg.norm(matrix @ np.linalg.lstsq(matrix, -external, rcond=RANK)[0] + external))
            if moved > SEEN:
                return (
                    f"{name}: the loads{case} push with {force * moved:.3g} N along motions that change no member's "
                    "length at these nodes, so that no forces in members balance them; add strings or "
                    "supports against them, hold nodes (holds=...), or size it where the loads have taken it"
                )
            best = lsq_linear(matrix, -external, bounds=(least - SEEN * 1e-3, np.inf)).x
            left = float(np.linalg.norm(matrix @ best + external))
            if left > SEEN:
                return (
                    f"{name}: no forces balance the loads{case} at these nodes while strings only pull: at best "
                    f"{force * left:.3g} N are left; add strings or supports, hold nodes (holds=...), or lower "
                    "least_force_density"
                )
        return (
            f"{name}: no masses of the rods bear their own weight with these materials, or nothing holds their weight; "
            "add supports, or choose stronger materials"
        )


minimal_mass = function_of(MinimalMass)


def _polished(problem: Problem, found: Optimum) -> tuple[Array, Array, Array]:
    """Tensions, bar forces and bar masses in balance to round-off; loaded members take what the program left over."""
    point = found.point
    size = max(float(np.abs(point.tensions).max(initial=0.0)), float(np.abs(point.forces).max(initial=0.0)), NO_FORCE)
    tensions = np.where(point.tensions < NO_FORCE * size, 0.0, point.tensions)
    tensions = np.maximum(tensions, problem.least_tension)
    forces = np.where(np.abs(point.forces) < NO_FORCE * size, 0.0, point.forces)
    heavy = bool(problem.weights.any())
    masses = np.array(point.bar_masses)
    for _ in range(4 if heavy else 1):
        for row in range(len(forces)):
            loaded = np.concatenate([tensions[row] > problem.least_tension, forces[row] != 0.0])
            matrix = np.hstack([problem.strings, problem.bars])
            values = np.concatenate([tensions[row], forces[row]])
            left = matrix @ values + problem.weights @ masses + problem.forces[row]
            change = np.zeros(len(values))
            change[loaded] = np.linalg.lstsq(matrix[:, loaded], -left, rcond=RANK)[0]
            after = left + matrix @ change
            if np.linalg.norm(after) < np.linalg.norm(left):
                values = values + change
                tensions[row] = np.maximum(values[: len(tensions[row])], problem.least_tension)
                forces[row] = values[len(tensions[row]) :]
        need = np.maximum(problem.least_bar, problem.bar_mass(forces).max(axis=0, initial=0.0))
        masses = np.maximum(masses, need) if heavy else need
    return tensions, forces, masses


def _governs(masses: Array, needs: Array, least: Array, buckles: NDArray[np.bool_]) -> tuple[Governs, ...]:
    """Return what decides the size of each member of one kind, by the masses that they need and their least masses."""
    reasons = (Governs.YIELD, Governs.NOTHING, Governs.LEAST_RADIUS, Governs.BUCKLING)
    found = np.select([~(masses > 0), needs < least * (1 - 1e-9), buckles], [1, 2, 3], 0)
    return tuple(reasons[k] for k in found.tolist())


def _check_supports(structure: Structure) -> None:
    for rod in structure.rods:
        support = rod.support
        rows = np.array(support.directions, float).reshape(-1, 3)
        if support.plane is not None:  # along the normal both ends are held alike, which bends nothing
            normal = np.array(support.plane) / np.linalg.norm(support.plane)
            rows = rows - np.outer(rows @ normal, normal)
        if 0.0 < support.sigma < 1.0 and len(rows) and np.abs(rows).max() > 1e-9 * np.abs(support.directions).max():
            raise OptionError(
                f"rod '{rod.name}' is supported between its ends, at σ = {support.sigma}: that bends it, and sizing "
                "accounts for forces along members only; put a joint there, of two rods"
            )


def _load_cases(structure: Structure, loads: ArrayLike | None) -> Array:
    count = len(structure.nodes)
    if loads is None:
        return np.zeros((1, count, 3))
    try:
        cases = np.asarray(loads, float)
    except (TypeError, ValueError):
        cases = np.zeros(0)
    if cases.ndim == 3 and len(cases):
        return np.array(real_array("loads", loads, (len(cases), count, 3), "N", scalar=False))
    return np.array(real_array("loads", loads, (count, 3), "N", scalar=False))[None]


def _least(what: str, given: ArrayLike, size: int, unit: str) -> Array:
    least = real_array(what, given, (size,), unit)
    if np.any(least < 0):
        raise OptionError(f"{what} = {float(least.min())!r}; it must be >= 0")
    return least


def _materials(what: str, given: Material | Sequence[Material], size: int) -> tuple[Material, ...]:
    several = (given,) * size if isinstance(given, Material) else given
    if not isinstance(several, (list, tuple)) or not all(isinstance(one, Material) for one in several):
        raise OptionError(f"{what} = {given!r}; it must be a Material, as tensegrity_mj.statics.ALUMINIUM, or one each")
    if len(several) != size:
        raise OptionError(f"{what}: {len(several)} materials for {size} of them; give one, or one each")
    return tuple(several)
