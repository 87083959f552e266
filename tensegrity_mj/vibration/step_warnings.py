"""Warnings of steps that are too long: before a run by the linear model, after it at the states that it passed."""

from __future__ import annotations

import copy
import dataclasses
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.checks import warn_caller
from tensegrity_mj.basics.remembered import Remembered
from tensegrity_mj.controllers.scenes import SCENE_LAW, AnyLaw, law_for
from tensegrity_mj.dynamics.native.law import NativeLaw, native_law
from tensegrity_mj.errors import SceneError, StabilityWarning
from tensegrity_mj.model.actuation import Actuation, Mode
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.vibration import closed_loop, contact_steps, integrators
from tensegrity_mj.vibration.bodies import SLOTS, Bodies
from tensegrity_mj.vibration.bounds import bounds_at
from tensegrity_mj.vibration.stable_step import StableStep, solvable, stable_step, step_of
from tensegrity_mj.vibration.stepping import Scheme, Stepping

if TYPE_CHECKING:
    from tensegrity_mj.dynamics.native.plant import Plant

LAW_COORDINATES = 100  # of a structure up to which the check before a run takes the law's derivative
RUN_COORDINATES = 1000  # of a structure up to which the states of a run without a law are checked


def before_run(
    scene: Scene, engine: Any, law: NativeLaw, actuation: Actuation, plant: Plant | None = None
) -> tuple[dict[str, Any] | None, str]:
    """Check the step before a run: return `run.reports["stability"]`, and the text of a warning or "".

    A bound that costs next to nothing comes first, and the model only where the step is beyond it. It never calls a
    law of Python's, or one that is not a function of the state alone. None where there is nothing to check. The steps
    that contact needs are checked separately, by `contact_steps`.

    The result is kept for a scene, an engine and a law as long as the scene lives, if none of them can change.

    Args:
        plant: that of the run, where its engine has packed one: it evaluates the law, and is left as it is.
    """
    stepping: Stepping = engine.stepping
    if not dataclasses.is_dataclass(engine) or not _stays(scene, law):
        return _before_run(scene, stepping, law, actuation, plant)
    options = tuple(getattr(engine, item.name) for item in dataclasses.fields(engine))
    # With what the law keeps alive: its addresses stay its own.
    key = (type(engine), options, law.address, law.context, actuation)
    found, text, _ = _remembered.get(
        scene, key, lambda: (*_before_run(scene, stepping, law, actuation, plant), law.keep)
    )
    return copy.deepcopy(found), text


_remembered = Remembered()


def _stays(scene: Scene, law: NativeLaw) -> bool:
    """Return whether neither the scene nor the law can have changed by the next check."""
    of_python = callable(scene.loads) or any(motion.function is not None for motion in scene.motions)
    return not of_python and (not law.address or law.stateless)


def _before_run(
    scene: Scene, stepping: Stepping, law: NativeLaw, actuation: Actuation, plant: Plant | None
) -> tuple[dict[str, Any] | None, str]:
    scheme, step = stepping.scheme, stepping.timestep
    if scheme is None or step is None:
        return None, ""
    try:
        with solvable(scene):
            report, text = _checked(scene, stepping, scheme, step, law, actuation, plant)
    except SceneError as error:
        report, text = {"step": step, "checked": False, "reason": str(error)}, f"the step was not checked: {error}"
    except Exception as error:
        # Loads are a user's code: no check stands in the way of a run, which itself reports better what is wrong.
        report, text = {"step": step, "checked": False, "reason": f"{type(error).__name__}: {error}"}, ""
    if scene.contact is not None:
        report["contact"], more = contact_steps.check_contact(scene.contact, scheme, step)
        text = "; and ".join(part for part in (text, more) if part)
    return report, text


def warn_before_run(
    scene: Scene, engine: Any, law: NativeLaw, actuation: Actuation, plant: Plant | None = None
) -> dict[str, Any] | None:
    """`before_run`, with the warning given to whoever called `simulate`."""
    report, text = before_run(scene, engine, law, actuation, plant)
    if text:
        warn_caller(text, StabilityWarning)
    return report


def may_be_the_step(run: Trajectory, engine: Any, law: NativeLaw, actuation: Actuation) -> bool:
    """Return whether the step may be the cause of a run's warnings, so that `explain_warnings` should check it.

    Laws must be continuous; without one, the rest lengths stay.
    """
    stepping: Stepping = engine.stepping
    if stepping.scheme is None or stepping.timestep is None:
        return False
    if law.failure is not None or law.discontinuous or actuation.mode is not Mode.CONTINUOUS:
        return False
    if not run.reports.get("warnings") or run.reports.get("stability", {}).get("exceeded"):
        return False
    structure = run.scene.structure
    coordinates = SLOTS * (len(structure.rods) + len(structure.lone_masses) + len(structure.bodies))
    return coordinates <= (LAW_COORDINATES if law.address else RUN_COORDINATES)


def explain_warnings(
    run: Trajectory,
    engine: Any,
    law: AnyLaw = SCENE_LAW,
    actuation: Actuation | None = None,
) -> None:
    """Check whether the step of a run with warnings was larger than the largest stable one at the states it passed.

    The states of a run are not known before it: this checks those that were recorded, which takes about a second,
    often longer than the run. If the step is the cause, `run.reports["warnings"]` gets a warning that says so, and
    `run.reports["stability"]` the numbers. A run without warnings is not checked.

    Args:
        run, engine, law, actuation: as in the call of `simulate` that gave the run.
    """
    actuation = actuation or Actuation.continuous()
    native = native_law(law_for(run.scene, law), run.scene.structure)
    if not may_be_the_step(run, engine, native, actuation):
        return
    stepping: Stepping = engine.stepping
    step = stepping.timestep or 0.0
    try:
        # A law of Python's that has no address is none at all.
        found = stable_step(run.scene, engine, law=native if native.address else None, run=run)
    except Exception:  # as in `before_run`
        return
    run.reports.get("stability", {}).pop("along_the_run", None)
    if found.limit < step:
        run.reports["stability"] = {"step": step, "checked": True, "exceeded": True, **found.to_dict()}
        run.reports["warnings"].append(message(found, stepping, step))


def _checked(
    scene: Scene,
    stepping: Stepping,
    scheme: Scheme,
    step: float,
    law: NativeLaw,
    actuation: Actuation,
    plant: Plant | None,
) -> tuple[dict[str, Any], str]:
    structure = scene.structure
    bodies = Bodies.of(structure)
    # A law of Python's has a list for its failure; one that is not a function of the state has a reason.
    pure = bool(law.address) and law.failure is None and not law.discontinuous
    continuous = actuation.mode is Mode.CONTINUOUS
    by_density = bool(law.address) and (actuation.mode is Mode.HOLD_FORCE_DENSITY or continuous)
    if by_density and not pure:
        return {"step": step, "checked": False, "reason": "the law is Python's or not a function of the state"}, ""
    small = SLOTS * len(bodies.mass) <= LAW_COORDINATES
    if by_density and not small:
        return {"step": step, "checked": False, "reason": "the loop through the law is too large to check"}, ""
    # Only the model knows which dampers between rods that share nodes an implicit integrator takes into account.
    known = scheme is not Scheme.VELOCITY_IMPLICIT or structure.class_number <= 1 or not structure.damping.any()
    if not by_density and known:
        bounds = bounds_at(scene, bodies, scene.nodes0, scene.velocities0, structure.rest_lengths)
        bound = bounds.stable_step(scheme)
        if step <= bound:
            return {"step": step, "checked": True, "exceeded": False, "at_least": bound}, ""
    loop = closed_loop.Loop(scene, bodies, closed_loop.LawAtStates(scene, law, plant) if pure else None, actuation.mode)
    model = loop.at(scene.nodes0, scene.velocities0, None, float(scene.start_time))
    if not integrators.is_stable(model, scheme, step, stepping.constraints):
        found = step_of(model, stepping, float(scene.start_time))
        return {"step": step, "checked": True, "exceeded": True, **found.to_dict()}, message(found, stepping, step)
    return {"step": step, "checked": True, "exceeded": False}, ""


def message(found: StableStep, stepping: Stepping, step: float) -> str:
    """The warning of a run whose step is beyond the limit."""
    where = "at the start" if found.time == 0 else f"at t = {found.time:.4g} s"
    kind = found.scheme.value if found.scheme is not None else ""
    loop = "in the loop with the law" if found.closed_loop else f"stiffest motion ω = {found.omega:.4g} rad/s"
    blame = f"'{found.rod}' ({100 * found.rod_share:.0f} % of the motion)" if found.rod else "the law alone"
    if found.string:
        blame += f" on string '{found.string}' ({100 * found.string_share:.0f} % of its energy)"
    remedies = [f"use a step below {found.limit:.3g} s"]
    if not found.closed_loop:
        remedies += [stepping.against_strings] if found.string and stepping.against_strings else []
        remedies += [stepping.against_all] if stepping.against_all else []
    if stepping.by_accuracy:
        remedies.append("accuracy=..., which chooses the step")
    return (
        f"the step of {step:g} s is beyond the largest stable one, {found.limit:.4g} s {where} ({kind}, {loop}): "
        f"small motions of {blame} grow without bound; {', or '.join(remedies)}"
    )
