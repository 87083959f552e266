"""Engines by a name and a step, as points, tables and the command line have them."""

from __future__ import annotations

from typing import Any

from tensegrity_mj.engines.table import ENGINES, make_engine

CONTROLLED = ("dop853", "radau")  # methods that control their error
MOST_STEPS = 50_000  # of one of them


def engine_of(name: str, level: float) -> Any:
    """The engine of a name such as "euler", "dae", "dae normalize" or "ode dop853".

    MuJoCo goes by its integrators. The others take the classical Runge-Kutta method, unless another one follows; a
    treatment of drift may follow, too.

    Args:
        level: the step [s]; the rtol of a method that controls its error, whose atol is a hundredth of it.

    Raises:
        OptionError: for a name of nothing.
    """
    family, _, word = name.partition(" ")
    if family not in ENGINES:
        return make_engine("mujoco", {"integrator": name, "timestep": level})
    if word in CONTROLLED:
        return make_engine(family, {"method": word, "rtol": level, "atol": 1e-2 * level, "max_steps": MOST_STEPS})
    drift = {"drift": word} if word not in ("", "rk4") else {}
    return make_engine(family, {**ENGINES[family].fixed_step, "timestep": level, **drift})
