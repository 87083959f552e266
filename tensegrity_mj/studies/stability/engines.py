"""The engines that have a fixed step, by the names that points, tables and the command line use."""

from __future__ import annotations

from tensegrity_mj.model.capabilities import refusal
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.engine_names import engine_of

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
    return refusal(engine_of(name, 1.0), scene.with_(contact=None)) is None
