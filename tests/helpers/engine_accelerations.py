"""Node accelerations at a scene's start, from each engine's own equations, without a step of integration."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj import DAE, ODE, MuJoCo
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.request import Request
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.scene import Scene

Array = NDArray[np.float64]


def accelerations(engine: Any, scene: Scene) -> Array:
    """(N, 3) [m/s²]: what the engine integrates, with the structure's rest lengths."""
    law = native_law(None, scene.structure)
    request = Request(scene, law, Actuation.continuous(), OnInfeasible.STOP, 1.0, None, False)
    return engine.accelerations(request)(0.0, scene.nodes0, scene.velocities0)[1]


def dae_accelerations(scene: Scene) -> Array:
    return accelerations(DAE(), scene)


def ode_accelerations(scene: Scene) -> Array:
    return accelerations(ODE(), scene)


def mujoco_accelerations(scene: Scene) -> Array:
    return accelerations(MuJoCo(), scene)


def mujoco_accelerations_at(scene: Scene, nodes: Array, velocities: Array, u: Array) -> Array:
    """(N, 3) at a state, with strings that have force densities u (M,)."""
    rest = scene.structure.string_lengths(nodes) * (1 - u / scene.structure.stiffness)
    strings = tuple(
        replace(string, force_density=None, tension=None, damping=0.0, rest_length=float(length))
        for string, length in zip(scene.structure.strings, rest, strict=True)
    )
    now = scene.with_(
        structure=replace(scene.structure, strings=strings),
        initial_nodes=nodes,
        initial_velocities=velocities,
        control=None,
    )
    return mujoco_accelerations(now)
