"""What members are made of."""

from __future__ import annotations

from dataclasses import dataclass

from tensegrity_mj.basics.checks import positive


@dataclass(frozen=True)
class Material:
    """A material that yields at the same stress in tension and compression.

    Attributes:
        density: ρ [kg/m³], > 0.
        elasticity_modulus: E [Pa], > 0.
        yield_stress: σ_y [Pa], > 0.

    Raises:
        OptionError: for a number that is not finite and > 0.
    """

    density: float
    elasticity_modulus: float
    yield_stress: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "density", positive("material: density", self.density, "kg/m³"))
        object.__setattr__(
            self, "elasticity_modulus", positive("material: elasticity_modulus", self.elasticity_modulus, "Pa")
        )
        object.__setattr__(self, "yield_stress", positive("material: yield_stress", self.yield_stress, "Pa"))


# The three that MOTES (Goyal, Chen, Majji and Skelton, 2019) knows, with its numbers, so that results can be compared.
ALUMINIUM = Material(2700.0, 60e9, 110e6)
STEEL = Material(8000.0, 200e9, 300e6)
UHMWPE = Material(970.0, 120e9, 2.7e9)  # polyethylene of ultra high molecular weight, as fibre
