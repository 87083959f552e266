"""Cross section and material of a rod: its axial stiffness, and the loads that it can carry.

Numbers that no material or bar has, most often from a table in other units, are found with their likely unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import positive
from tensegrity_mj.errors import StructureError

if TYPE_CHECKING:
    from tensegrity_mj.model.members import Rod
    from tensegrity_mj.model.structure import Structure


@value("section", StructureError, whole=True)
class Section:
    """A uniform cross section of one material.

    Attributes:
        area: A [m²], > 0.
        second_moment: I [m⁴], > 0: the smallest second moment of area, about which the rod buckles.
        elasticity_modulus: E [Pa], > 0.
        yield_stress: σ_y [Pa], > 0, in tension and in compression; None where it is not known.

    Raises:
        StructureError: if a number is not finite and > 0.
    """

    area: float = field(positive("m²"))
    second_moment: float = field(positive("m⁴"))
    elasticity_modulus: float = field(positive("Pa"))
    yield_stress: float | None = field(positive("Pa"), default=None, none="absent")

    @classmethod
    def tube(
        cls, outer_radius: float, wall: float, elasticity_modulus: float, yield_stress: float | None = None
    ) -> Section:
        """A round tube of that outer radius and wall [m]; a wall as thick as the radius leaves no hole.

        Raises:
            StructureError: if a number is not finite and > 0, or the wall thicker than the outer radius.
        """
        outer_radius = checked("section: outer_radius", outer_radius, positive("m"), StructureError)
        wall = checked("section: wall", wall, positive("m"), StructureError)
        if wall > outer_radius:
            raise StructureError(
                f"section: wall = {wall!r} m is thicker than outer_radius = {outer_radius!r} m; it must be at most that"
            )
        # Both by the wall, not by differences of squares and fourth powers, which a thin wall would cancel.
        mean = outer_radius - 0.5 * wall
        area = 2.0 * math.pi * mean * wall
        return cls(area, area * (mean * mean + 0.25 * wall * wall) / 2.0, elasticity_modulus, yield_stress)

    @classmethod
    def solid(cls, radius: float, elasticity_modulus: float, yield_stress: float | None = None) -> Section:
        """A solid round bar of that radius [m].

        Raises:
            StructureError: if a number is not finite and > 0.
        """
        radius = checked("section: radius", radius, positive("m"), StructureError)
        area = math.pi * radius * radius
        return cls(area, 0.25 * area * radius * radius, elasticity_modulus, yield_stress)

    @property
    def axial_stiffness(self) -> float:
        """E A [N]: the force that would double the length."""
        return self.elasticity_modulus * self.area

    @property
    def yield_load(self) -> float | None:
        """σ_y A [N], or None where the yield stress is not known."""
        return None if self.yield_stress is None else self.yield_stress * self.area

    def euler_load(self, length: float) -> float:
        """π² E I / ℓ² [N]: the compression at which a rod of that length [m] buckles between two ball joints."""
        return math.pi**2 * self.elasticity_modulus * self.second_moment / length**2


# Aerogel [kg/m³]: a rod may carry more than itself, never less. From gels to diamond (1.2e12 Pa). Whiskers, the
# strongest solids, bear E/10; gels bear 1 kPa. Rubber has less than 1e8 Pa: with a limit above E/10, E is wrong there.
LIGHTEST, ELASTICITY, STRAIN, WEAKEST, SOFT = 1.0, (1e4, 1.3e12), 0.1, 1e3, 1e8
LARGEST = 1.0  # m²: steel of that section weighs 7.8 t a metre
# By columns: the unit, and the one that tables have in its place.
UNITS = {
    "area": ("m²", "mm²", 1e-6),
    "second_moment": ("m⁴", "mm⁴", 1e-12),
    "elasticity_modulus": ("Pa", "GPa", 1e9),
    "yield_stress": ("Pa", "MPa", 1e6),
}


def hardly_possible(structure: Structure) -> dict[str, list[tuple[Rod, str]]]:
    """List, by columns of sections, the rods whose number is implausible, and why."""
    found: dict[str, list[tuple[Rod, str]]] = {}
    for rod, length in zip(structure.rods, structure.rod_lengths.tolist(), strict=True):
        for column, why in _of_rod(rod, length):
            found.setdefault(column, []).append((rod, why))
    return found


def warnings_of(structure: Structure) -> list[str]:
    """A sentence for each of these columns: the number, a rod that has it, and the likely unit."""
    return [
        f"column {column}: {getattr(rod.section, column):.6g} {UNITS[column][0]} of rod '{rod.name}'"
        f"{f' and {len(rods)} more' if rods else ''} is hardly possible: {why}; columns are in SI units: if these are "
        f"{UNITS[column][1]}, multiply them by {UNITS[column][2]:g}"
        for column, ((rod, why), *rods) in hardly_possible(structure).items()
    ]


def _of_rod(rod: Rod, length: float) -> Iterator[tuple[str, str]]:
    if (section := rod.section) is None:
        return
    density, radius = rod.mass / (section.area * length), math.sqrt(section.second_moment / section.area)
    modulus, limit = section.elasticity_modulus, section.yield_stress
    if section.area > LARGEST or density < LIGHTEST:
        yield "area", f"with its mass of {rod.mass:.4g} kg, its density is {density:.3g} kg/m³"
    elif radius > length:
        yield "second_moment", f"its radius of gyration, {radius:.3g} m, is more than the rod's length"
    strong = limit is not None and limit > STRAIN * modulus
    if not ELASTICITY[0] <= modulus <= ELASTICITY[1] or (strong and modulus < SOFT):
        yield "elasticity_modulus", "materials have 10 kPa to 1.2 TPa, and ten times their yield stress"
        strong = False
    if limit is not None and (limit < WEAKEST or strong):
        yield "yield_stress", f"solids bear 1 kPa at least, and a tenth of E at most, which is {modulus:.4g} Pa here"
