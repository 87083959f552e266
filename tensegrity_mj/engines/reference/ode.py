"""The minimal ODE engine: the thesis' chapter 2.3, as many coordinates as degrees of freedom, and no constraint.

State: q = (z, θ, φ) of every rod in space, (z, β) of every rod in a plane, q̇, and the work integrals of the energy
ledger. There is nothing to drift; the price is a pole for each rod in space, φ = 0 and φ = π, where θ is not defined.
A run that comes to a pole stops there with `Status.SINGULAR`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import within
from tensegrity_mj.dynamics.minimal import MinimalRecords, node_accelerations
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.reference import ode_kernels as ode
from tensegrity_mj.engines.reference.engine import ReferenceEngine
from tensegrity_mj.engines.reference.integration import Equations, IntegratedRun
from tensegrity_mj.engines.request import Request
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.vibration.stepping import Stepping


@value("ODE", OptionError)
class ODE(ReferenceEngine):
    """Options of the minimal ODE engine.

    Attributes:
        method, rtol, atol, timestep, max_steps, accuracy, locate_slack: see `ReferenceEngine`.
        least_sine: sin φ at which a run stops. A rod that passes a pole at this distance has θ̇ = ω / sin φ, so that an
            error ε of φ becomes one of ε / sin φ of its velocity. With the round-off of φ near π, ε = π 2.2e-16, the
            default leaves 7e-13; with atol for ε, least_sine >= atol / rtol keeps rtol.
    """

    descriptor = ENGINES["ode"]

    least_sine: float = field(within(1e-8, 0.5), default=1e-3)

    def __str__(self) -> str:
        return f"ODE {self._described()}"

    @property
    def stepping(self) -> Stepping:
        """Integrator and step in polar coordinates, for the stability of small motions."""
        return replace(super().stepping, polar=True)

    def working_bytes(self, scene: Scene) -> int:
        """Bytes of state, stages and matrices."""
        return self._bytes(MinimalRecords.of(scene.structure).nq)

    def _node_accelerations(self, run: IntegratedRun, accelerations: Array) -> Array:
        """Node accelerations from r̈ and b̈ = W β̈ + Ẇ β̇ along the rods, and from the motions of their supports."""
        records, out = run.records, np.zeros_like(run.plant["nodes"])
        q, rates = run.y[: records.nq], run.y[records.nq : 2 * records.nq]
        node_accelerations(q, rates, accelerations, records.rods, records.points, out)
        for (row, node), moved in zip(run.plant["carried"], run.plant["moved"], strict=True):
            out[[node] if row < 0 else records.structure.rod_nodes[row]] += moved[2]
        return out

    def prepared(self, request: Request) -> IntegratedRun:
        """See `ReferenceEngine`."""
        scene = request.scene
        require(self, scene)
        records, carried = MinimalRecords.of(scene.structure), _carried(scene)
        plant = Plant(scene, request.law, request.actuation, request.on_infeasible, ode.MINIMAL)
        plant.set(
            rods=records.rods,
            points=records.points,
            least_sine=self.least_sine,
            step=self.timestep or 0.0,
            carried=carried,
            bases=np.array(
                [scene.structure.positions[b] if a < 0 else records.rods[a]["anchor"] for a, b in carried]
            ).reshape(-1, 3),
        )

        def explain(time: float) -> str:
            rod = scene.structure.rods[plant["last_singular"]].name
            reason = plant["reason"]
            limits = {
                ode.NEAR_POLE: f"points along the z axis (sin φ <= least_sine = {self.least_sine:g})",
                ode.ACROSS_POLE: "swings across the z axis within a step",
                ode.TURNS_TOO_FAR: f"passes the z axis so near that θ turns by more than {ode.MAX_TURN:g} rad in a "
                f"step of {self.timestep or 0.0:g} s",
            }
            finer = "reduce the time step, or " if reason == ode.TURNS_TOO_FAR else ""
            return (
                f"at t = {time:.6g} s rod '{rod}' {limits[reason]}, and the angles (θ, φ) of the minimal coordinates "
                f"end there (thesis 2.3.1); {finer}use the DAE, which has no such pole, or turn the structure, so that "
                "no rod comes near the z axis"
            )

        equations = Equations(
            place=ode.ode_place,
            accelerate=ode.ode_accelerate,
            guard=ode.ode_guard,
            explain_singular=explain,
        )
        return IntegratedRun(self, request, plant, records, equations)


def _carried(scene: Scene) -> NDArray[np.int64]:
    """Rows (m, 2) of the rod and of the fixed node that each motion moves, -1 for the one that it does not."""
    rods = {rod.name: row for row, rod in enumerate(scene.structure.rods)}
    pairs = [
        (rods[name], -1) if name in rods else (-1, scene.structure.node_index[name])
        for name in (motion.support for motion in scene.motions)
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)
