"""The reference engine: the thesis' differential-algebraic equations (chapter 2) in non-minimal coordinates.

State: q = (z, b) of every rod, q̇, and the work integrals of the energy ledger, integrated beside it. MuJoCo takes
no part.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.checks import member, positive
from tensegrity_mj.dynamics.records import StructureRecords
from tensegrity_mj.engines import dae_kernels as dae
from tensegrity_mj.engines.integration import IntegratedRun, Method, check_options, describe_method
from tensegrity_mj.engines.integration_kernels import WORK
from tensegrity_mj.engines.run import Accelerations, Request
from tensegrity_mj.native.plant import Plant
from tensegrity_mj.native.pointers import address_of
from tensegrity_mj.trajectory import Trajectory

Array = NDArray[np.float64]


class Drift(enum.Enum):
    """The treatments of constraint drift of §3.2.6."""

    MONITOR = "monitor"  # report it
    NORMALIZE = "normalize"  # (3.23)-(3.24) after each step
    BAUMGARTE = "baumgarte"  # (3.25)-(3.26) in the equations


@dataclass(frozen=True)
class DAE:
    """Options of the reference engine.

    Attributes:
        method: see `Method`.
        rtol, atol: tolerances of the error-controlled methods.
        timestep: [s], of RK4 only.
        drift: see `Drift`; the drift is reported whatever is chosen.
        baumgarte_frequency, baumgarte_damping: ω [rad/s] and ζ of k_p = ω², k_d = 2 ζ ω.
        max_steps: of the error-controlled methods, before the run is given up.
        accuracy: [m] largest node error over the run, from 1e-10 to 1e-2, in place of method, tolerances and step,
            which it chooses for each run (docs/accuracy.md).
    """

    method: Method = Method.DOP853
    rtol: float = 1e-10
    atol: float = 1e-12
    timestep: float | None = None
    drift: Drift = Drift.MONITOR
    baumgarte_frequency: float = 10.0
    baumgarte_damping: float = 1.0
    max_steps: int = 1_000_000
    accuracy: float | None = None

    def __post_init__(self) -> None:
        check_options("DAE", self)
        member("DAE: drift", self.drift, Drift)
        for name in ("baumgarte_frequency", "baumgarte_damping"):
            object.__setattr__(self, name, positive(f"DAE: {name}", getattr(self, name)))

    def __str__(self) -> str:
        return f"DAE {describe_method(self)}, drift: {self.drift.value}"

    def run(self, request: Request) -> Trajectory:
        """Simulate; called by `simulate`."""
        if self.accuracy is not None:
            from tensegrity_mj.engines.integration_accuracy import run_accurately

            plain = partial(replace, self, accuracy=None)
            return run_accurately(self.accuracy, request, plain, lambda options, made: options._prepared(made)[0])
        return self._prepared(request)[0].integrate()

    def accelerations(self, request: Request) -> Accelerations:
        """Node accelerations Φ q̈ of the equations that `run` integrates."""
        run, records = self._prepared(request)
        phi, offset = records.affine_map
        nq = records.nq

        def at(time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None) -> tuple[Array, Array]:
            run.y[:nq], run.y[nq : 2 * nq] = records.coordinates(nodes), records.coordinates(velocities)
            rates = run.rates_at(time, run.y, rest_lengths)
            placed = (phi @ run.y[:nq] + offset).reshape(-1, 3)
            return placed, (phi @ rates[nq : 2 * nq]).reshape(-1, 3)

        return at

    def _prepared(self, request: Request) -> tuple[IntegratedRun, StructureRecords]:
        plant = Plant(request.scene, request.law, request.actuation, request.on_infeasible)
        records = StructureRecords.of(request.scene.structure)
        baumgarte = self.drift is Drift.BAUMGARTE
        kp = self.baumgarte_frequency**2 if baumgarte else 0.0
        kd = 2 * self.baumgarte_damping * self.baumgarte_frequency if baumgarte else 0.0
        constants = np.array([*request.scene.gravity, kp, kd])
        table, nq = plant.table, records.nq
        table[dae.RODS], table[dae.ROD_COUNT] = address_of(records.rods), len(records.rods)
        table[dae.POINTS], table[dae.POINT_COUNT] = address_of(records.points), len(records.points)
        table[dae.Q_SIZE], table[dae.CONSTANTS] = nq, address_of(constants)
        y = np.zeros(2 * nq + WORK)
        y[:nq] = records.coordinates(request.scene.nodes0)
        y[nq : 2 * nq] = records.coordinates(request.scene.velocities0)
        run = IntegratedRun(
            "DAE",
            self,
            request,
            plant,
            y,
            rates=dae.dae_rates.address,
            place=dae.dae_place.address,
            project=dae.dae_normalize.address if self.drift is Drift.NORMALIZE else 0,
            multipliers=np.zeros(len(records.rods)),
            keep=(records, constants),
        )
        return run, records
