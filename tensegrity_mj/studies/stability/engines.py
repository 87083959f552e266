"""The engines that have a fixed step, by the names that points, tables and the command line use."""

from __future__ import annotations

from tensegrity_mj.engines.requirements import engines_for
from tensegrity_mj.engines.table import ENGINES
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


def simulates(name: str, scene: Scene) -> bool:
    """Whether the engine of that name simulates a scene; contact, which has no small motions, does not count."""
    return (name if name in ENGINES else "mujoco") in engines_for(scene.with_(contact=None))
