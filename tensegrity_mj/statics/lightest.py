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

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import qr
from scipy.optimize import lsq_linear

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance, positive, real_array, whole
from tensegrity_mj.basics.fields import function_of
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.rigidity import members_at, nodal_forces
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Boundary, Hold
from tensegrity_mj.statics.least_mass import NO_FORCE, Optimum, Problem, Search
from tensegrity_mj.statics.sizing import Governs, Material, Sizing

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
