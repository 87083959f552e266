"""How many bytes a run holds: what it records and what its engine works with. Reckoned, so the same on every run.

Measured peaks depend on the allocator and on what ran before. This is what grows with the scene and with the choice of
the engine; Python itself and loaded libraries, which all runs share, are left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.runs.trajectory import VARIABLES, Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.engines.reference.dae import DAE
    from tensegrity_mj.engines.reference.ode import ODE
    from tensegrity_mj.studies.tradeoff.settings import AnyEngine
import mujoco

DOUBLE = 8
RK4_VECTORS = 6  # the state, four rates, a trial state
DOP853_VECTORS = 22  # 16 rates with those of the dense output (SciPy's K_extended), state, old state, dense output
RADAU_VECTORS = 15  # three stages in three forms, state, rates, dense output
RADAU_MATRICES = 4  # the Jacobian, and two factored matrices of which one is complex
WORK = 3  # integrals of work beside q and q̇


def memory_of(run: Trajectory, engine: AnyEngine) -> int:
    """Bytes of a run's recorded arrays and of its engine's model, state and stages."""
    recorded = sum(int(getattr(run, name).nbytes) for name in VARIABLES)
    from tensegrity_mj.engines.mujoco.engine import MuJoCo

    if isinstance(engine, MuJoCo):
        return recorded + buffer_bytes(engine.model(run.scene))
    return recorded + DOUBLE * _doubles(engine, _state_size(run, engine))


def _state_size(run: Trajectory, engine: DAE | ODE) -> int:
    from tensegrity_mj.dynamics.linked import LinkedRecords
    from tensegrity_mj.dynamics.minimal import MinimalRecords
    from tensegrity_mj.engines.reference.dae import DAE

    records = LinkedRecords if isinstance(engine, DAE) else MinimalRecords
    return 2 * records.of(run.scene.structure).nq + WORK


def _doubles(engine: DAE | ODE, size: int) -> int:
    from tensegrity_mj.engines.reference.method import Method

    if engine.method is Method.RK4:
        return RK4_VECTORS * size
    if engine.method is Method.DOP853:
        return DOP853_VECTORS * size
    return RADAU_VECTORS * size + RADAU_MATRICES * int(np.square(size))


def buffer_bytes(model: mujoco.MjModel) -> int:
    """Bytes of a compiled model's buffer and of one data object's: its arrays and its arena, which it takes whole."""
    data = mujoco.MjData(model)
    return int(model.nbuffer) + int(data.nbuffer) + int(data.narena)
