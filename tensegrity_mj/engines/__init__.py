"""Engines: independent formulations of the same scene, each with frozen options and one `run`."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.engines.jax.laws import ArrayPolicy as ArrayPolicy
    from tensegrity_mj.engines.jax.settings import JAX as JAX
    from tensegrity_mj.engines.mujoco.settings import Integrator as Integrator
    from tensegrity_mj.engines.mujoco.settings import MuJoCo as MuJoCo
    from tensegrity_mj.engines.reference.dae import DAE as DAE
    from tensegrity_mj.engines.reference.dae import Drift as Drift
    from tensegrity_mj.engines.reference.dae import Solver as Solver
    from tensegrity_mj.engines.reference.method import Method as Method
    from tensegrity_mj.engines.reference.ode import ODE as ODE
else:
    __getattr__, __dir__ = face(__name__)
