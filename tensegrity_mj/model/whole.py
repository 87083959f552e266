"""Place and motion of a structure as a whole at the start: [scene.whole] of a file, and `Scene.moving`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import vector
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model import rods, scene_checks, structure_checks
from tensegrity_mj.model.members import Vector

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene

STILL = (0.0, 0.0, 0.0)


@value("whole")
class Whole:
    """A structure rotated about the origin, then translated, then given a velocity; all of it in the world frame.

    Attributes:
        rotation: vector along the axis, as long as the angle [rad], by the right hand.
        translation: after the rotation [m].
        velocity: of the center [m/s].
        angular_velocity: about the center [rad/s].
        center: a point of space [m], where the structure stands by then; None for its centre of mass.
    """

    rotation: Vector = field(vector("rad"), default=STILL)
    translation: Vector = field(vector("m"), default=STILL)
    velocity: Vector = field(vector("m/s"), default=STILL)
    angular_velocity: Vector = field(vector("rad/s"), default=STILL)
    center: Vector | None = field(vector("m"), default=None, none="None for the centre of mass")

    def __attrs_post_init__(self) -> None:
        if math.hypot(*self.rotation) > 2 * math.pi:
            raise refused(self, f"rotation = {list(self.rotation)}; its length is an angle in rad, of at most 2π")

    def start(self, scene: Scene) -> Scene:
        """Return the scene whose nodes have the velocity of the whole added to their own at t = 0.

        Raises:
            SceneError: where supports, planes or fixed nodes do not let the whole move so.
        """
        if not any((*self.velocity, *self.angular_velocity)):
            return scene
        structure, nodes = scene.structure, scene.nodes0
        middle = np.average(nodes, axis=0, weights=rods.lumped_masses(structure))
        center = middle if self.center is None else np.array(self.center)
        rates = np.array(self.velocity) + np.cross(self.angular_velocity, nodes - center)
        for row in (structure.node_index[name] for name in structure.fixed_nodes):
            if np.abs(rates[row]).max() <= structure_checks.CONSTRAINT_TOLERANCE * np.abs(rates).max():
                rates[row] = 0.0  # on the axis, but for round-off
        try:
            scene_checks.check_velocities(structure, nodes, rates, {}, "whole")
        except SceneError as error:
            raise SceneError(
                f"{error}: the ground holds it there, so that the whole cannot start with velocity = "
                f"{list(self.velocity)} and angular_velocity = {list(self.angular_velocity)}; give what its supports "
                "allow (center = a point that stays), velocities of nodes by initial_velocities, or free it"
            ) from None
        return scene.with_(initial_velocities=scene.velocities0 + rates)
