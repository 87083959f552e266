"""Variants of a law under test: other gains, and another gravity."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from tensegrity_mj.controllers.gains import Gains
from tensegrity_mj.controllers.specs import has_option
from tensegrity_mj.model.scene import Scene


def with_gain(law: Any, scene: Scene, gain: str, factor: float) -> Any:
    """The law with one of X, Y, Z of all rods, or its decay rate, times a factor.

    Raises:
        OptionError: if gains so scaled are not positive definite.
    """
    if gain == "decay_rate":
        return dataclasses.replace(law, decay_rate=law.decay_rate * factor)
    names = [rod.name for rod in scene.structure.rods] + [point.node for point in scene.structure.point_masses]

    def scaled(given: Any) -> Any:
        every = given if isinstance(given, Mapping) else dict.fromkeys(names, given)
        own = {name: every.get(name, Gains()) for name in names}
        return {
            name: dataclasses.replace(g, **{gain: np.asarray(getattr(g, gain)) * factor}) for name, g in own.items()
        }

    return dataclasses.replace(law, translation=scaled(law.translation), rotation=scaled(law.rotation))


def knows_gravity(law: Any) -> bool:
    """Whether it can be given another gravity."""
    return has_option(law, "gravity")


def with_gravity(law: Any, gravity: Any) -> Any:
    """The law for another gravity [m/s²]."""
    return dataclasses.replace(law, gravity=tuple(gravity))
