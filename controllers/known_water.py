"""Water that a law knows of: part of its model, as gravity is. Loads count as known forces, added mass as mass."""

from __future__ import annotations

import enum
from dataclasses import replace
from typing import Any

from tensegrity_mj.dynamics.native.views import Table
from tensegrity_mj.dynamics.native.water import packed_sea
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure


class KnownWater(enum.Enum):
    """How much of a scene's water its law knows of."""

    ALL = "all"  # waves and current as they are
    STILL = "still"  # buoyancy, added mass and drag, as if the water stood still: waves and current are unknown
    NONE = "none"  # a law for dry land

    def of(self, water: Water | None) -> Water | None:
        """That part of a scene's water; None for a dry scene."""
        if water is None or self is KnownWater.NONE:
            return None
        return water if self is KnownWater.ALL else replace(water, waves=(), current=(0.0, 0.0, 0.0))


def checked_water(structure: Structure, gravity: tuple[float, float, float], water: Water | None) -> Water | None:
    """The water in the form in which scenes keep it.

    Raises:
        SceneError: where it could not be a scene's, see `Scene`.
    """
    return None if water is None else Scene(structure, gravity=gravity, water=water).water


def packed_water(structure: Structure, gravity: tuple[float, float, float], water: Water | None) -> Table | None:
    """For compiled code."""
    return None if water is None else packed_sea(Scene(structure, gravity=gravity, water=water))


def water_address(packed: Table | None) -> int:
    """Of the table; 0 for none."""
    return 0 if packed is None else packed.address


def described_water(water: Water | None) -> dict[str, Any]:
    """Plain values for the provenance of a run; nothing where there is no water."""
    if water is None:
        return {}
    return {
        "water": {
            "density": water.density,
            "current": list(water.current),
            "waves": len(water.waves),
            "drag": water.drag,
            "tangential_drag": water.tangential_drag,
            "added_mass": water.added_mass,
            "inertia": water.inertia_coefficient,
        }
    }
