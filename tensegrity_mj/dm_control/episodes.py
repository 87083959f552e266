"""What a user gives an environment: its reward, its end, and how episodes start. Needs nothing of dm_control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import finite
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene

# (scene, nodes (N, 3), velocities (N, 3), force densities (M,)) after a control step.
Reward = Callable[[Scene, Array, Array, Array], float]


Termination = Callable[[Scene, Array, Array, Array], float | None]


@dataclass(frozen=True)
class RandomStart:
    """Episodes that start near the scene's start, drawn evenly and in all ways that rods and supports allow.

    Of a scene with contact starts at which something overlaps are drawn anew.

    Attributes:
        displacement: largest shift and turn of each degree of freedom [m, rad], >= 0.
        speed: largest change of its velocity [m/s, rad/s], >= 0.
        seed: of the whole sequence of episodes.
    """

    displacement: float = 0.0
    speed: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("displacement", "speed"):
            value = finite(f"RandomStart: {name}", getattr(self, name), " >= 0")
            if value < 0:
                raise OptionError(f"RandomStart: {name} = {value!r}; it must be a finite number >= 0")
            object.__setattr__(self, name, value)
        if isinstance(self.seed, bool) or not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise OptionError(f"RandomStart: seed = {self.seed!r}; it must be a whole number >= 0")
