"""The lightest members that bear given loads: the result of `minimal_mass`, as numbers, words and a structure."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import positive
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.section import Section
from tensegrity_mj.model.structure import Structure
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

    density: float = field(positive("kg/m³"))
    elasticity_modulus: float = field(positive("Pa"))
    yield_stress: float = field(positive("Pa"))


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
