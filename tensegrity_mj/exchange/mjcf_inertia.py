"""The masses of a rod that has the inertia of a body: a uniform thin rod, and one mass that it carries."""

from __future__ import annotations

from tensegrity_mj.model.members import RodMass
from tensegrity_mj.model.rods import centers_and_moments

NEAR = 1e-6  # of a rod's length: what is so near to its end, or its middle, is there
THIN = 0.01  # of a thin uniform rod's moment of inertia: one that differs by less is such a rod's
MOST_HALVINGS = 20


def rod_of_body(mass: float, length: float, center: float, moment: float) -> tuple[float, tuple[RodMass, ...]] | None:
    """The mass [kg] of the rod itself, and what it carries; None where no mass on a rod makes it such a body.

    The rod is the heaviest of half, a quarter, ... of the mass with which the rest of the inertia is one of a mass.

    Args:
        mass: of the body [kg].
        length: [m].
        center: of mass, from 0 at the first end to 1 at the second.
        moment: of inertia across the rod, about the centre of mass [kg m²].
    """
    _, thin = centers_and_moments(mass, length)
    if abs(center - 0.5) <= NEAR and abs(moment - thin) <= THIN * thin:
        return mass, ()
    own = mass
    for _ in range(MOST_HALVINGS):
        own /= 2
        rest = mass - own
        at = (center * mass - 0.5 * own) / rest
        _, without = centers_and_moments(own, length, (rest, rest * at, rest * at**2))
        if 0.0 <= at <= 1.0 and moment >= without:
            return own, (RodMass(at, rest, moment - without),)
    return None
