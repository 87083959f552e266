"""Node accelerations of the MuJoCo model at any state, without a step of integration."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.engines import mujoco_callback as callback
from tensegrity_mj.engines.mujoco_state import place
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.law import NO_SOLUTION
from tensegrity_mj.native.plant import HELD, STATUS

Array = NDArray[np.float64]


class NodeAccelerations:
    """See `engines.run.Accelerations`. The engine's callback sets controls and loads, as in a run."""

    def __init__(self, run: Any) -> None:
        self.run, self.scene = run, run.request.scene
        model = run.model
        self.sites = np.array([model.site(name).id for name in self.scene.structure.nodes])
        self.bodies = model.site_bodyid[self.sites]

    def __call__(
        self, time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None
    ) -> tuple[Array, Array]:
        run, model, data = self.run, self.run.model, self.run.data
        mujoco.mj_resetData(model, data)
        place(model, data, self.scene, nodes, velocities)
        if rest_lengths is not None:
            run.plant[HELD][:] = rest_lengths
        # The callback counts time in steps: one step of this length.
        run.keep[callback.STEP_SIZE][0] = time
        run.counters[:] = [0, 1 if time else 0, 0, -1, callback.RUNNING, 0]
        with callback.installed(run.plant.table):
            mujoco.mj_forward(model, data)
        ended, failed = int(run.counters[callback.ENDED]), int(run.plant.table[STATUS])
        run.plant.raise_if_failed(max(ended, failed, 0), time)
        if ended == NO_SOLUTION:
            raise InfeasibleError(run.plant.infeasible_message(time))
        out = np.zeros((len(self.sites), 3))
        jacobian, rate = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for row, (site, body) in enumerate(zip(self.sites, self.bodies, strict=True)):
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            mujoco.mj_jacDot(model, data, rate, None, data.site_xpos[site], body)
            out[row] = jacobian @ data.qacc + rate @ data.qvel
        return data.site_xpos[self.sites].copy(), out
