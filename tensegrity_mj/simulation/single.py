"""One run, by `simulate`, and the accelerations at one state, for every engine."""

from __future__ import annotations

import platform
import re
from dataclasses import replace
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import interrupts
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance, real_array
from tensegrity_mj.controllers.scenes import SCENE_LAW, AnyLaw, law_for
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines import continuing, requirements, table
from tensegrity_mj.engines.request import AcceleratingEngine, ReadyRun, Request, request_for, settled
from tensegrity_mj.errors import DivergenceError, OptionError
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.moved_supports import check_motions_until
from tensegrity_mj.model.redundancy import approached
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.vibration.step_warnings import may_be_the_step, warn_before_run


class Engine(Protocol):
    """Frozen options and one `run`.

    An engine that packs a plant has `prepare(request)`, too: a `ReadyRun`, whose plant the check of the step shares.
    """

    def run(self, request: Request) -> Trajectory:
        """Simulate a request."""
        ...


def simulate(
    scene: Scene | Trajectory,
    controller: AnyLaw = SCENE_LAW,
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
        scene: the experiment; or a run, to go on from its end, or from the sample of `run.at(time)` (docs/engines.md),
            with its actuation by default.
        controller: a law (see `law`), or a function (time, nodes, velocities) -> u; the scene's own law by default
            (SCENE_LAW), where it names one. None for no law: constant rest lengths.
        engine: `MuJoCo(...)` (default), `DAE(...)` or `ODE(...)`.
        duration: [s]; the scene's by default, and of a run that goes on what is left of it.
        actuation: what happens between evaluations of the law; continuous by default.
        on_infeasible: what to do where the law has no admissible solution.
        output_interval: [s] between recorded samples; by default the multiple of the step nearest below 0.01 s.
            Times may be texts, too: "1/4800", or "2.0833e-4", which is taken as what divides the run (docs/engines.md).
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
    before = scene if isinstance(scene, Trajectory) else None
    if isinstance(scene, Trajectory):
        scene, duration, actuation = _goes_on(scene, duration, actuation)
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    engine = table.checked_engine(engine)
    requirements.require(engine, scene)
    controller = law_for(scene, default := controller)
    request = request_for(scene, controller, duration, actuation, on_infeasible, output_interval, progress)
    engine, request, taken = settled(engine, request)
    if before is not None:
        if scene is before.scene:
            request = replace(request, start=continuing.start_of(before, engine, controller))
        check_motions_until(scene, request.begin + request.duration)
        if default is SCENE_LAW and request.law.description != before.provenance.get("controller"):
            raise OptionError("the run to go on from was not under the scene's own law: give its law, or None for none")
    law, actuation = request.law, request.actuation
    checked = None
    try:
        with interrupts.deferred(), np.errstate(over="ignore", invalid="ignore"):  # what diverges is an error by itself
            ready = ReadyRun.of(engine, request)
            checked = warn_before_run(scene, engine, law, actuation, ready.plant)
            run = ready.run()
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
            run.reports["stability"]["along_the_run"] = "not checked; vibration.step_warnings.explain_warnings does it"
    if taken:
        run.reports["taken"] = taken
    run.provenance.update(provenance_of(request, engine))
    return run


def accelerations(
    scene: Scene,
    controller: AnyLaw = SCENE_LAW,
    engine: AcceleratingEngine | None = None,
    *,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    time: float | None = None,
    rest_lengths: ArrayLike | None = None,
) -> Array:
    """Accelerations of the nodes at a state, from an engine's own equations and without a step.

    Args:
        scene: what moves; elements with states have those that they start with.
        controller: a law, evaluated at the state; the scene's own by default. None for no law.
        engine: `MuJoCo(...)` (default), `DAE(...)`, `ODE(...)` or `JAX(...)`; only its equations count, not its steps.
        nodes, velocities: (N, 3) [m] and [m/s]; the scene's start by default.
        time: [s], at which forces act, supports have moved, and strings have broken; the scene's start by default.
        rest_lengths: (M,) [m]; the structure's by default, or what the law sets.

    Returns:
        (N, 3) [m/s²]. In MuJoCo joints that close loops are rigid here, which a run has soft.

    Raises:
        OptionError: for options out of range, and where the engine's coordinates cannot hold the state.
        SceneError: for a state that stretches a rod or breaks a support.
        InfeasibleError, ControllerError: if the law has no solution at the state, or fails there.
    """
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    engine = table.checked_engine(engine, "accelerations")
    given = {"initial_nodes": nodes, "initial_velocities": velocities, "start_time": time}
    scene = scene.with_(**{key: one for key, one in given.items() if one is not None})
    requirements.require(engine, scene)
    law = law_for(scene, controller)
    if rest_lengths is not None:
        if law is not None:
            raise OptionError("rest_lengths and controller: the law sets the rest lengths; leave one of them out")
        rest_lengths = real_array("rest_lengths", rest_lengths, (len(scene.structure.strings),), "m")
    field = engine.accelerations(Request(scene, native_law(law, scene.structure)))
    return field(float(scene.start_time), scene.nodes0, scene.velocities0, rest_lengths)[1]


def _goes_on(
    run: Trajectory, duration: float | None, actuation: Actuation | None
) -> tuple[Scene, float, Actuation | None]:
    """The scene of a run that goes on, for how long, and how its law acts."""
    if not len(run.time):
        raise OptionError("the run has no samples (it ended at its start): there is nothing to go on from")
    end = run.scene.start_time + run.scene.duration
    left = end - float(run.time[-1]) if duration is None else duration
    if duration is None and left <= 0:
        raise OptionError(f"the run has reached the scene's duration, {end:g} s: give one to go on for")
    held = run.provenance.get("actuation") or {}
    if actuation is None and held.get("mode", "continuous") != "continuous":
        actuation = Actuation(held["mode"], held["period"])
    return continuing.scene_at_end(run), left, actuation


def simulate_as_far(scene: Scene, controller: AnyLaw, engine: Engine | None, **options: Any) -> Trajectory:
    """Call `simulate`; return a run that diverges as far as it came, its status DIVERGED, with the reason.

    Raises:
        TensegrityError: as `simulate`; DivergenceError where nothing was recorded.
    """
    try:
        return simulate(scene, controller, engine, **options)
    except DivergenceError as error:
        if not isinstance(error.trajectory, Trajectory):
            raise
        return replace(error.trajectory, status=Status.DIVERGED, message=str(error))


def provenance_of(request: Request, engine: Any = None) -> dict[str, Any]:
    """Provenance that a run keeps of its request."""
    return {
        "controller": request.law.description,
        "on_infeasible": request.on_infeasible.value,
        "duration": request.duration,
        "versions": versions(engine),
    }


def versions(engine: Any = None) -> dict[str, Any]:
    """Versions that decide the numbers, of an engine too that comes with an extra."""
    more = ("jax", "diffrax") if hasattr(engine, "descriptor") and engine.descriptor.extra == "jax" else ()
    names = ("tensegrity-mj", "mujoco", "numpy", "scipy", "numba", *more)
    return {"python": platform.python_version(), **{name: _release(name) for name in names}}


@cache  # to look one up takes as long as a short run
def _release(name: str) -> str | None:
    """Version as `importlib.metadata.version` gives it, without parsing all the rest, which takes 2 MB."""
    try:
        installed = distribution(name)
    except PackageNotFoundError:
        return None
    found = re.search(r"^Version: *(\S+)", installed.read_text("METADATA") or "", re.MULTILINE)
    return found[1] if found else installed.version
