"""Numbers of sections that no material or bar has, most often from a table in other units."""

from __future__ import annotations

import math
from collections.abc import Iterator

from tensegrity_mj.model.members import Rod
from tensegrity_mj.model.structure import Structure

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
