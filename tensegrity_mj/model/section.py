"""The cross section of a rod and what it is made of: how stiff the rod is along itself, and what it can carry."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Section:
    """A uniform cross section of one material.

    A structure checks the numbers of the sections of its rods. Those of `tube` and `solid` are checked there too.

    Attributes:
        area: A [m²], > 0.
        second_moment: I [m⁴], > 0: the smallest second moment of area, about which the rod buckles.
        elasticity_modulus: E [Pa], > 0.
        yield_stress: σ_y [Pa], > 0, in tension and in compression; None where it is not known.
    """

    area: float
    second_moment: float
    elasticity_modulus: float
    yield_stress: float | None = None

    @classmethod
    def tube(
        cls, outer_radius: float, wall: float, elasticity_modulus: float, yield_stress: float | None = None
    ) -> Section:
        """A round tube of that outer radius and wall [m]; a wall as thick as the radius leaves no hole.

        Raises:
            StructureError: if a number is not finite and > 0, or the wall thicker than the outer radius.
        """
        from tensegrity_mj.basics.values import check_number, shown
        from tensegrity_mj.errors import StructureError

        check_number("section: outer_radius", outer_radius, "> 0 m", lambda x: x > 0)
        check_number("section: wall", wall, "> 0 m", lambda x: x > 0)
        if wall > outer_radius:
            raise StructureError(
                f"section: wall = {shown(wall)!r} m is thicker than outer_radius = {shown(outer_radius)!r} m; "
                "it must be at most that"
            )
        # Both by the wall, not by differences of squares and fourth powers, which a thin wall would cancel.
        mean = outer_radius - 0.5 * wall
        area = 2.0 * math.pi * mean * wall
        section = cls(area, area * (mean * mean + 0.25 * wall * wall) / 2.0, elasticity_modulus, yield_stress)
        section.check("section")
        return section

    @classmethod
    def solid(cls, radius: float, elasticity_modulus: float, yield_stress: float | None = None) -> Section:
        """A solid round bar of that radius [m].

        Raises:
            StructureError: if a number is not finite and > 0.
        """
        from tensegrity_mj.basics.values import check_number

        check_number("section: radius", radius, "> 0 m", lambda x: x > 0)
        area = math.pi * radius * radius
        section = cls(area, 0.25 * area * radius * radius, elasticity_modulus, yield_stress)
        section.check("section")
        return section

    def check(self, what: str) -> None:
        """Raise StructureError, which begins with `what`, unless every number is finite and > 0."""
        from tensegrity_mj.basics.values import check_number

        check_number(f"{what}: area", self.area, "> 0 m²", lambda x: x > 0)
        check_number(f"{what}: second_moment", self.second_moment, "> 0 m⁴", lambda x: x > 0)
        check_number(f"{what}: elasticity_modulus", self.elasticity_modulus, "> 0 Pa", lambda x: x > 0)
        if self.yield_stress is not None:
            check_number(f"{what}: yield_stress", self.yield_stress, "> 0 Pa, or absent", lambda x: x > 0)

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
