"""What members are made of."""

from __future__ import annotations

from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import positive
from tensegrity_mj.errors import OptionError


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
