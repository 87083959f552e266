"""The engines that have a fixed step, by the names that points, tables and the command line use."""

from __future__ import annotations

from typing import Any

NAMES = ("euler", "implicitfast", "implicit", "discrete", "rk4", "dae", "ode")
CLASS_1 = ("ode",)  # those of structures whose rods share no nodes
TITLES = {
    "euler": "MuJoCo Euler",
    "implicitfast": "MuJoCo implicitfast",
    "implicit": "MuJoCo implicit",
    "discrete": "MuJoCo discrete",
    "rk4": "MuJoCo RK4",
    "dae": "DAE RK4",
    "ode": "ODE RK4",
}


def engine_of(name: str, step: float) -> Any:
    """The engine of that name with a step [s]."""
    from tensegrity_mj.engines.mujoco.engine import MuJoCo
    from tensegrity_mj.engines.mujoco.settings import Integrator
    from tensegrity_mj.engines.reference.dae import DAE
    from tensegrity_mj.engines.reference.method import Method
    from tensegrity_mj.engines.reference.ode import ODE

    if name in ("dae", "ode"):
        return (DAE if name == "dae" else ODE)(method=Method.RK4, timestep=step)
    return MuJoCo(timestep=step, integrator=Integrator(name))
