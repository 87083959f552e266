"""`simulate`: one verb, one loop's meaning, for every engine."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Protocol

from numpy.typing import ArrayLike

from tensegrity_mj.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.engines.run import Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.law import Law, native_law
from tensegrity_mj.scene import Scene
from tensegrity_mj.trajectory import Trajectory


class Engine(Protocol):
    """Frozen options and one `run`."""

    def run(self, request: Request) -> Trajectory:
        """Simulate a request."""
        ...


def simulate(
    scene: Scene,
    controller: Law | Callable[..., ArrayLike] | None = None,
    engine: Engine | None = None,
    *,
    duration: float | None = None,
    actuation: Actuation | None = None,
    on_infeasible: OnInfeasible = OnInfeasible.STOP,
    output_interval: float | None = None,
    progress: bool = False,
) -> Trajectory:
    """Simulate a scene under a control law in one engine.

    Args:
        scene: the experiment.
        controller: a law (see `law`), a function (time, nodes, velocities) -> u, or None for constant rest lengths.
        engine: `MuJoCo(...)` (default) or `DAE(...)`.
        duration: [s]; the scene's by default.
        actuation: what happens between evaluations of the law; continuous by default.
        on_infeasible: what to do where the law has no admissible solution.
        output_interval: [s] between recorded samples; by default the multiple of the step nearest below 0.01 s.
        progress: show a bar on stderr.

    Returns:
        The trajectory; its status is INFEASIBLE where the run stopped for lack of a solution.

    Raises:
        OptionError: for options that are out of range or contradict each other.
        DivergenceError: with the time, the cause, the remedy and what was recorded before.
        ControllerError: when the law fails or returns something that is no control.
    """
    if not isinstance(scene, Scene):
        raise OptionError(f"scene = {scene!r}; use a Scene, or load_scene(name or path)")
    if engine is None:
        from tensegrity_mj.engines.mujoco import MuJoCo

        engine = MuJoCo()
    if not hasattr(engine, "run"):
        raise OptionError(f"engine = {engine!r}; use MuJoCo(...) or DAE(...)")
    actuation = actuation or Actuation.continuous()
    if not isinstance(actuation, Actuation):
        raise OptionError(f"actuation = {actuation!r}; use Actuation.continuous() or one of the hold modes")
    if not isinstance(on_infeasible, OnInfeasible):
        raise OptionError(f"on_infeasible = {on_infeasible!r}; allowed: OnInfeasible.STOP, OnInfeasible.PASSIVE")
    total = scene.duration if duration is None else duration
    for name, value in (("duration", total), ("output_interval", output_interval)):
        if value is not None and not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
            raise OptionError(f"{name} = {value!r}; it must be a finite number > 0 s")
    if output_interval is not None and output_interval > total * (1 + 1e-12):
        raise OptionError(f"output_interval = {output_interval!r} s is longer than the run of {total} s")
    law = native_law(controller, scene.structure)
    if law.discontinuous and actuation.mode is Mode.CONTINUOUS:
        raise OptionError(law.discontinuous)
    request = Request(scene, law, actuation, on_infeasible, float(total), output_interval, progress)
    run = engine.run(request)
    run.provenance.update(
        {
            "controller": law.description,
            "actuation": {"mode": actuation.mode.value, "period": actuation.period},
            "on_infeasible": on_infeasible.value,
            "duration": float(total),
            "versions": versions(),
        }
    )
    return run


def versions() -> dict[str, Any]:
    """Versions that decide the numbers."""
    found: dict[str, Any] = {"python": platform.python_version()}
    for name in ("tensegrity-mj", "mujoco", "numpy", "scipy", "numba"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found
