"""Node accelerations at a scene's start, from each engine's own equations, without a step of integration."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.actuation import Actuation, OnInfeasible
from tensegrity_mj.engines import mujoco_callback
from tensegrity_mj.engines.dae import DAE, DAERun
from tensegrity_mj.engines.dae_kernels import dae_rhs
from tensegrity_mj.engines.mujoco import MuJoCo, _Run
from tensegrity_mj.engines.run import Request
from tensegrity_mj.law import native_law
from tensegrity_mj.scene import Scene

Array = NDArray[np.float64]


def dae_accelerations(scene: Scene) -> Array:
    """(N, 3) [m/s²], Φ q̈ of the right-hand side that the DAE engine integrates."""
    run = DAERun(DAE(), _request(scene))
    derivative = np.empty_like(run.y)
    dae_rhs(0.0, run.y, derivative, run.table)
    phi, _ = run.records.affine_map
    return (phi @ derivative[run.records.nq : 2 * run.records.nq]).reshape(-1, 3)


def mujoco_accelerations(scene: Scene) -> Array:
    """(N, 3) [m/s²], J q̈ + J̇ q̇ of the sites, with the engine's callback setting controls and loads."""
    run = _Run(MuJoCo(), _request(scene))
    model, data = run.model, run.data
    with mujoco_callback.installed(run.plant.table):
        mujoco.mj_forward(model, data)
    accelerations = np.zeros((len(scene.structure.nodes), 3))
    jacobian, rate = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for row, name in enumerate(scene.structure.nodes):
        site = model.site(name).id
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        mujoco.mj_jacDot(model, data, rate, None, data.site_xpos[site], model.site_bodyid[site])
        accelerations[row] = jacobian @ data.qacc + rate @ data.qvel
    return accelerations


def _request(scene: Scene) -> Request:
    law = native_law(None, scene.structure)
    return Request(scene, law, Actuation.continuous(), OnInfeasible.STOP, 1.0, None, False)
