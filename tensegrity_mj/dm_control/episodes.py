"""What a user gives an environment: its reward, its end, and how episodes start. Needs nothing of dm_control."""

from __future__ import annotations

from collections.abc import Callable

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import not_negative, whole
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene

# (scene, nodes (N, 3), velocities (N, 3), force densities (M,)) after a control step.
Reward = Callable[[Scene, Array, Array, Array], float]


Termination = Callable[[Scene, Array, Array, Array], float | None]


@value("RandomStart", OptionError)
class RandomStart:
    """Episodes that start near the scene's start, drawn evenly and in all ways that rods and supports allow.

    Of a scene with contact starts at which something overlaps are drawn anew.

    Attributes:
        displacement: largest shift and turn of each degree of freedom [m, rad], >= 0.
        speed: largest change of its velocity [m/s, rad/s], >= 0.
        seed: of the whole sequence of episodes.
    """

    displacement: float = field(not_negative(), default=0.0)
    speed: float = field(not_negative(), default=0.0)
    seed: int = field(whole(0), default=0)
