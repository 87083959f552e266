"""Node accelerations of the MuJoCo model at any state, without a step of integration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import NO_SOLUTION
from tensegrity_mj.engines.mujoco.install import installed
from tensegrity_mj.engines.mujoco.joints import site_accelerations
from tensegrity_mj.engines.mujoco.mjcf_tree import place
from tensegrity_mj.engines.mujoco.run_view import ENDED, RUNNING
from tensegrity_mj.engines.request import Accelerations
from tensegrity_mj.errors import InfeasibleError

if TYPE_CHECKING:
    from tensegrity_mj.engines.mujoco.run import MuJoCoRun


def node_accelerations(run: MuJoCoRun) -> Accelerations:
    """See `engines.request.Accelerations`. The engine's callback sets controls and loads, as in a run.

    Joints that close loops are rigid here (`close_rigidly`), which a run has soft.
    """
    model, data, scene = run.model, run.data, run.request.scene
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    run.plant["stages"] = 4  # a stage is no step: states of elements stay those of the start
    sites = np.array([model.site(name).id for name in scene.structure.nodes])
    run.plant.set(resets=0, yielding=0)  # the state is the one that is requested, and no string was longer before

    def at(time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None) -> tuple[Array, Array]:
        mujoco.mj_resetData(model, data)
        place(data, scene, nodes, velocities, run.tree)
        if rest_lengths is not None:
            run.plant["held"][:] = rest_lengths
        # The callback counts time in steps: one step of this length.
        run.plant["step"] = time
        run.counters[:] = [0, 1 if time else 0, 0, -1, RUNNING, 0]
        with installed(run.plant):
            mujoco.mj_forward(model, data)
        ended, failed = int(run.counters[ENDED]), run.plant["status"]
        run.plant.raise_if_failed(max(ended, failed, 0), time)
        if ended == NO_SOLUTION:
            raise InfeasibleError(run.plant.infeasible_message(time))
        return data.site_xpos[sites].copy(), site_accelerations(model, data, sites)

    return at
