"""Cross section and material of a rod: its axial stiffness, and the loads that it can carry."""

from __future__ import annotations

import math

from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import positive
from tensegrity_mj.errors import StructureError


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
