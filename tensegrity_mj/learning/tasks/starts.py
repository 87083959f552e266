"""Starts of episodes: at the scene's start, or at random near it, in all ways that rods and supports allow."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import not_negative, whole
from tensegrity_mj.engines.mujoco.contact import spins
from tensegrity_mj.engines.mujoco.mjcf_tree import place
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.contact import overlaps
from tensegrity_mj.model.scene import Scene

MOST_DRAWS = 100  # of a random start, before it is given up


@value("RandomStart", OptionError)
class RandomStart:
    """Episodes that start near the scene's start, drawn evenly and in all ways that rods and supports allow.

    In a scene with contact, starts at which something overlaps are drawn anew. No rod spins about its own axis. Tasks
    refuse scenes whose rods close loops, or whose nodes are held by linear constraints: a draw would tear them open.

    Attributes:
        displacement: largest shift and turn of each degree of freedom [m, rad], >= 0.
        speed: largest change of its velocity [m/s, rad/s], >= 0.
        seed: of the whole sequence of episodes, where nothing else seeds them.
    """

    displacement: float = field(not_negative(), default=0.0)
    speed: float = field(not_negative(), default=0.0)
    seed: int = field(whole(0), default=0)


def displace(model: Any, data: Any, scene: Scene, start: RandomStart, generator: np.random.Generator) -> None:
    """Move MjData from the scene's start to one near it, at which nothing overlaps that may touch.

    The draw is in MuJoCo's degrees of freedom, so that rods keep their lengths and their supports.

    Raises:
        OptionError: where so many draws overlap that hardly any would not.
    """
    qpos, qvel = np.array(data.qpos), np.array(data.qvel)
    sites = [model.site(name).id for name in scene.structure.node_names]
    inside: list[str] = []
    still = spins(scene.structure, model)
    for _ in range(MOST_DRAWS):
        drawn = generator.uniform(-1, 1, (2, model.nv))
        drawn[:, still] = 0.0  # no axial spin: it would only be round-off's
        data.qpos[:] = qpos
        mujoco.mj_integratePos(model, data.qpos, start.displacement * drawn[0], 1.0)
        data.qvel[:] = qvel + start.speed * drawn[1]
        if scene.structure.class_number > 1:  # rods that hang on others turn with them, about their own axes, too
            place(data, scene, *node_states(model, data, sites))
        if scene.contact is None:
            return
        mujoco.mj_kinematics(model, data)
        inside = overlaps(scene.structure, scene.contact, np.array(data.site_xpos[sites]))
        if not inside:
            return
    raise OptionError(
        f"{start}: {MOST_DRAWS} starts in a row overlap what they may touch; in the last {inside[0]}: draw "
        "smaller displacements, or begin farther away"
    )


def node_states(model: Any, data: Any, sites: list[int]) -> tuple[Array, Array]:
    """Positions [m] and velocities [m/s] of sites (N, 3), of the joints as they are."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)
    found = np.zeros((len(sites), 6))
    for row, site in zip(found, sites, strict=True):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, row, 0)
    return np.array(data.site_xpos[sites]), found[:, 3:]
