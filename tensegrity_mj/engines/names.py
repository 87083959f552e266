"""Names of engines, with a step, as points, tables and the command line have them."""

from __future__ import annotations

from typing import Any

from tensegrity_mj.engines.table import ENGINES, make_engine
from tensegrity_mj.model.capabilities import refusal
from tensegrity_mj.model.scene import Scene

# Those that have a fixed step, each with its displayed name.
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
CONTROLLED = ("dop853", "radau")  # methods that control their error
MOST_STEPS = 50_000  # of one of them


def engine_of(name: str, level: float) -> Any:
    """The engine of a name such as "euler", "dae", "dae normalize" or "ode dop853".

    MuJoCo goes by its integrators. The others take the classical Runge-Kutta method, unless another one follows; a
    treatment of drift may follow, too.

    Args:
        level: the step [s]; the rtol of a method that controls its error, whose atol is a hundredth of it.

    Raises:
        OptionError: for an unknown name.
    """
    family, _, word = name.partition(" ")
    if family not in ENGINES:
        return make_engine("mujoco", {"integrator": name, "timestep": level})
    if word in CONTROLLED:
        return make_engine(family, {"method": word, "rtol": level, "atol": 1e-2 * level, "max_steps": MOST_STEPS})
    drift = {"drift": word} if word not in ("", "rk4") else {}
    return make_engine(family, {**ENGINES[family].fixed_step, "timestep": level, **drift})


def simulates(name: str, scene: Scene) -> bool:
    """Return whether the engine of that name simulates a scene; contact, which has no small motions, does not count."""
    return refusal(engine_of(name, 1.0), scene.with_(contact=None)) is None
