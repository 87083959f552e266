"""The engines that have a fixed step, by the names that points, tables and the command line use."""

from __future__ import annotations

from typing import Any

from tensegrity_mj.engines.requirements import engines_for
from tensegrity_mj.engines.table import ENGINES, make_engine
from tensegrity_mj.model.scene import Scene

TITLES = {
    "euler": "MuJoCo Euler",
    "implicitfast": "MuJoCo implicitfast",
    "implicit": "MuJoCo implicit",
    "discrete": "MuJoCo discrete",
    "rk4": "MuJoCo RK4",
    "dae": "DAE RK4",
    "ode": "ODE RK4",
}
NAMES = tuple(TITLES)


def engine_of(name: str, step: float) -> Any:
    """The engine of that name with a step [s]."""
    from tensegrity_mj.engines.mujoco.engine import MuJoCo
    from tensegrity_mj.engines.mujoco.settings import Integrator

    if name in ENGINES:
        return make_engine(name, {**ENGINES[name].fixed_step, "timestep": step})
    return MuJoCo(timestep=step, integrator=Integrator(name))


def simulates(name: str, scene: Scene) -> bool:
    """Whether the engine of that name simulates a scene; contact, which has no small motions, does not count."""
    return (name if name in ENGINES else "mujoco") in engines_for(scene.with_(contact=None))
