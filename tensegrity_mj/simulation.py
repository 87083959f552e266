"""`simulate`: one verb, one loop's meaning, for every engine."""

from __future__ import annotations

import platform
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from typing import Any, Protocol

from numpy.typing import ArrayLike

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.checks import instance, member, positive
from tensegrity_mj.dynamics.native.law import Law, native_law
from tensegrity_mj.engines.request import Request
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.engines.table import checked_engine
from tensegrity_mj.errors import DivergenceError, OptionError
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.moved_supports import check_motions_until
from tensegrity_mj.model.redundancy import approached
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.vibration.step_warnings import may_be_the_step, warn_before_run


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
        engine: `MuJoCo(...)` (default), `DAE(...)` or `ODE(...)`.
        duration: [s]; the scene's by default.
        actuation: what happens between evaluations of the law; continuous by default.
        on_infeasible: what to do where the law has no admissible solution.
        output_interval: [s] between recorded samples; by default the multiple of the step nearest below 0.01 s.
        progress: show a bar on stderr, or below the cell of a notebook.

    Returns:
        The trajectory; its status is INFEASIBLE where the run stopped for lack of a solution, and SINGULAR where the
        engine's coordinates could not hold the motion any longer (the ODE at a pole).

    Warns:
        StabilityWarning: before the run, where its step is beyond the largest stable one at the start (see
            `stability`); `run.reports["stability"]` holds what was found.

    Raises:
        OptionError: for options that are out of range or contradict each other.
        DivergenceError: with the time, the cause, the remedy and what was recorded before.
        ControllerError: when the law fails or returns something that is no control.
        SceneError: where a support's motion, given as data, ends on its way within the run.
    """
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    engine = checked_engine(engine)
    require(engine, scene)
    request = request_for(scene, controller, duration, actuation, on_infeasible, output_interval, progress)
    law, actuation = request.law, request.actuation
    checked = warn_before_run(scene, engine, law, actuation)
    try:
        with interrupts.deferred():
            run = engine.run(request)
    except DivergenceError as error:
        if checked is not None and isinstance(error.trajectory, Trajectory):
            error.trajectory.reports["stability"] = checked
        reported = scene.redundancy.warning
        if not reported and isinstance(error.trajectory, Trajectory) and len(error.trajectory.time):
            reported = approached(scene.structure, scene.nodes0, error.trajectory.nodes[-1])
        if reported:
            raise DivergenceError(f"{error}; {reported}", error.time, error.trajectory) from None
        raise
    if checked is not None:
        run.reports["stability"] = checked
        if may_be_the_step(run, engine, law, actuation):
            run.reports["stability"]["along_the_run"] = "not looked at; vibration.step_warnings.explain_warnings does"
    run.provenance.update(provenance_of(request))
    return run


def simulate_as_far(
    scene: Scene, controller: Law | Callable[..., ArrayLike] | None, engine: Engine | None, **options: Any
) -> Trajectory:
    """`simulate`, with its options; a run that diverges as far as it came, its status DIVERGED, with the reason.

    Raises:
        TensegrityError: as `simulate`; DivergenceError where nothing was recorded.
    """
    try:
        return simulate(scene, controller, engine, **options)
    except DivergenceError as error:
        if not isinstance(error.trajectory, Trajectory):
            raise
        return replace(error.trajectory, status=Status.DIVERGED, message=str(error))


def request_for(
    scene: Scene,
    controller: Law | Callable[..., ArrayLike] | None,
    duration: float | None,
    actuation: Actuation | None,
    on_infeasible: OnInfeasible,
    output_interval: float | None,
    progress: bool,
) -> Request:
    """A request to an engine, checked; the arguments are those of `simulate`.

    Raises:
        OptionError: for options that are out of range or contradict each other.
        SceneError: where a support's motion, given as data, ends on its way within the run.
    """
    actuation = actuation or Actuation.continuous()
    instance("actuation", actuation, Actuation, "use Actuation.continuous() or one of the hold modes")
    member("on_infeasible", on_infeasible, OnInfeasible)
    total = scene.duration if duration is None else duration
    total = positive("duration", total, "s")
    if output_interval is not None:
        output_interval = positive("output_interval", output_interval, "s")
    if output_interval is not None and output_interval > total * (1 + 1e-12):
        raise OptionError(f"output_interval = {output_interval!r} s is longer than the run of {total} s")
    check_motions_until(scene, total)
    law = native_law(controller, scene.structure)
    if law.discontinuous and actuation.mode is Mode.CONTINUOUS:
        raise OptionError(law.discontinuous)
    if controller is None and actuation.mode is not Mode.CONTINUOUS:
        raise OptionError(f"actuation '{actuation.mode.value}' without a law: there is nothing to sample; leave it out")
    if law.period is not None and actuation.period is not None and abs(actuation.period / law.period - 1) > 1e-9:
        raise OptionError(
            f"control period = {actuation.period:g} s: the law (or its recording) has samples each {law.period:g} s; "
            "use that period"
        )
    return Request(scene, law, actuation, on_infeasible, total, output_interval, progress)


def provenance_of(request: Request) -> dict[str, Any]:
    """What a run keeps of its request."""
    return {
        "controller": request.law.description,
        "on_infeasible": request.on_infeasible.value,
        "duration": request.duration,
        "versions": versions(),
    }


def versions() -> dict[str, Any]:
    """Versions that decide the numbers."""
    return {"python": platform.python_version(), **_installed()}


@cache
def _installed() -> dict[str, str | None]:
    """Versions of packages; to look them up takes as long as a short run."""
    return {name: _release(name) for name in ("tensegrity-mj", "mujoco", "numpy", "scipy", "numba")}


def _release(name: str) -> str | None:
    """What `importlib.metadata.version` gives, without parsing all the rest, which takes 2 MB."""
    try:
        installed = distribution(name)
    except PackageNotFoundError:
        return None
    found = re.search(r"^Version: *(\S+)", installed.read_text("METADATA") or "", re.MULTILINE)
    return found[1] if found else installed.version
