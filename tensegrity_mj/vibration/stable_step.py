"""The largest stable step of a fixed-step engine, predicted from the linear model.

    found = stable_step(scene, tmj.MuJoCo(timestep=1e-3))
    found.limit, found.string, found.rod        # [s], and who is to blame

`small_motions` holds the model, `integrators` what each integrator makes of it. A linear model is of the state that
it is about: give a run, and the smallest limit of its configurations is found. What it does not cover is in its notes.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import finite, instance, real_array
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.controllers.scenes import SCENE_LAW, AnyLaw, law_for
from tensegrity_mj.dynamics.native.law import NativeLaw, native_law
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.model.capabilities import refusal
from tensegrity_mj.model.rods import directions
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.scene_checks import check_configuration
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.vibration.bodies import Bodies
from tensegrity_mj.vibration.closed_loop import LawAtStates, Loop
from tensegrity_mj.vibration.contact_steps import contact_limit
from tensegrity_mj.vibration.integrators import has_tree_model, largest_frequency, limit_of
from tensegrity_mj.vibration.small_motions import Vibration
from tensegrity_mj.vibration.stepping import Scheme, Stepping

SAMPLES = 25  # configurations that are checked along a run


@dataclass(frozen=True, eq=False)
class StableStep:
    """The largest stable step at one state.

    Attributes:
        limit: [s]; ∞ where no step is too large for the linear model, or the engine chooses its steps itself.
        scheme: of the integrator, or None for an engine that chooses its steps itself.
        omega: [1/s] of the stiffest motion, without dampers and law.
        time: [s] of the state.
        nodes: (N, 3) [m] the state.
        motion: (N, 3) of the nodes in the motion that grows beyond the limit; its largest entry is 1.
        rod: the body (a rod, or a point mass by its node) with most of that motion's kinetic energy, "" for none.
        rod_share: its part.
        string: the string with most of the energy that holds or damps it, "" for none.
        string_share: its part.
        closed_loop: whether the law's derivative is in it.
        notes: effects that the number does not cover.
    """

    limit: float
    scheme: Scheme | None
    omega: float
    time: float
    nodes: Array = field(repr=False)
    motion: Array = field(repr=False)
    rod: str
    rod_share: float
    string: str
    string_share: float
    closed_loop: bool
    notes: tuple[str, ...]

    @property
    def relative(self) -> float:
        """The limit over 2/ω, the unit in which integrators are compared."""
        return 0.5 * self.limit * self.omega

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for reports and JSON; None for no limit."""
        return {
            "limit": self.limit if math.isfinite(self.limit) else None,
            "relative": self.relative if math.isfinite(self.limit) and not self.closed_loop else None,
            **plain_values(self, "scheme", "omega", "time", "rod", "rod_share", "string", "string_share"),
            **plain_values(self, "closed_loop", "notes"),
        }


def stable_step(
    scene: Scene,
    engine: Any,
    *,
    law: AnyLaw | NativeLaw = SCENE_LAW,
    actuation: Actuation | None = None,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    rest_lengths: ArrayLike | None = None,
    time: float | None = None,
    run: Trajectory | None = None,
) -> StableStep:
    """The largest stable step of an engine with a fixed step.

    Args:
        scene: the scene that moves.
        engine: `MuJoCo(...)`, `DAE(method=Method.RK4, ...)`, `ODE(...)`; its own step does not count.
        law: closes the loop, continuously; the scene's own by default, None for none. Where `actuation` holds
            something, the law only gives the held values.
        actuation: continuous by default.
        nodes, velocities: (N, 3) the state; the scene's start by default.
        rest_lengths: (M,) [m]; the structure's by default, or those that the law sets.
        time: [s], at which loads and law are evaluated, supports have moved, and strings have broken or not yet; the
            scene's start by default.
        run: a run of this structure instead of a state: the smallest limit of its configurations.

    Raises:
        OptionError: for arrays of another shape, a time below zero, a run of another structure, and for what is no
            scene, engine, actuation or run.
        OptionError, StructureError, SceneError: where the engine refuses the scene for anything but contact.
        SceneError: for nodes that stretch a rod, or are not where supports have them at that time, and where the
            scene's numbers are too far apart for eigenvalues.
        InfeasibleError, ControllerError: where the law raises it at the state.
    """
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    _check(scene, engine, run, actuation)
    time = scene.start_time if time is None else time
    if finite("time", time, " [s]") < 0:
        raise OptionError(f"time = {time!r}; it must be >= 0 s, as in a run")
    stepping = engine.stepping
    mode = (actuation or Actuation.continuous()).mode
    native = law_for(scene, law)
    native = native if isinstance(native, NativeLaw) or native is None else native_law(native, scene.structure)
    at_states = None if native is None or not native.address else LawAtStates(scene, native)
    loop = Loop(scene, Bodies.of(scene.structure), at_states, mode)
    if run is not None:
        with solvable(scene):
            return _along(run, loop, stepping)
    structure, shape = scene.structure, (len(scene.structure.nodes), 3)
    x = scene.nodes0 if nodes is None else real_array("nodes", nodes, shape, "m", False)
    v = scene.velocities0 if velocities is None else real_array("velocities", velocities, shape, "m/s", False)
    if rest_lengths is not None:
        rest_lengths = real_array("rest_lengths", rest_lengths, (len(structure.strings),), "m")
    moved = {motion.support: motion.at(float(time))[0] for motion in scene.motions}
    check_configuration(structure, x, "stable_step: nodes", moved)
    with solvable(scene):
        return step_of(loop.at(x, v, rest_lengths, float(time)), stepping, time)


def _check(scene: Scene, engine: Any, run: Any, actuation: Any) -> None:
    if isinstance(engine, type) or not callable(getattr(engine, "run", None)):
        raise OptionError(f"engine = {engine!r}; use MuJoCo(...), DAE(...) or ODE(...)")
    if refused := refusal(engine, scene.with_(contact=None)):  # which is in no model of small motions
        limit, found, setting = refused
        who = " with ".join(part for part in (engine.descriptor.title, setting) if part)
        raise limit.error(f"{who} refuses the scene: {found}: {limit.reason}; {limit.remedy}")
    instance("run", run, (Trajectory, NoneType), "use a trajectory, as simulate(...) returns it")
    use = "use Actuation.continuous() or one of the hold modes"
    instance("actuation", actuation, (Actuation, NoneType), use)


@contextlib.contextmanager
def solvable(scene: Scene) -> Iterator[None]:
    """Say what to do where a solver of eigenvalues gives up."""
    try:
        yield
    except (np.linalg.LinAlgError, RuntimeError) as error:  # scipy's ArpackError is a RuntimeError
        if not isinstance(error, np.linalg.LinAlgError) and type(error).__module__.partition(".")[0] != "scipy":
            raise
        raise SceneError(
            f"scene '{scene.name}': the eigenvalues of its small motions cannot be found ({error}), so that no stable "
            "step is known: its stiffnesses, dampings and masses are too far apart for double precision"
        ) from error


def _along(run: Trajectory, loop: Loop, stepping: Stepping) -> StableStep:
    """The smallest limit of a run's configurations."""
    scene = loop.scene
    if run.scene.structure.node_names != scene.structure.node_names or len(run.time) == 0:
        raise OptionError(f"run: it has no samples, or is of another structure than scene '{scene.name}'")
    rows = np.unique(np.linspace(0, len(run.time) - 1, SAMPLES).round().astype(int))
    rest_lengths, found = run.rest_lengths + run.permanent_stretch, None  # yielded strings are elastic, and longer
    for row in rows.tolist():
        time = float(run.time[row])
        rest = None if loop.is_closed else rest_lengths[row]
        here = step_of(loop.at(run.nodes[row], run.velocities[row], rest, time), stepping, time)
        if found is None or here.limit < found.limit:
            found = here
    assert found is not None
    return found


def step_of(model: Vibration, stepping: Stepping, time: float) -> StableStep:
    """The largest stable step of a model, at the time [s] of its state."""
    n, structure, scheme = model.size, model.scene.structure, stepping.scheme
    if scheme is None:
        limit, y = math.inf, np.zeros(n)
    else:
        limit, y = limit_of(model, scheme, stepping.constraints)
        y = y if math.isfinite(limit) else np.zeros(n)  # nothing grows: what is left is a vector of round-off
    motion = model.motion(y)
    largest = np.abs(motion).max(initial=0.0)
    kinetic = np.sum(y.reshape(-1, model.state.bodies.slots) ** 2, axis=1)
    body, body_share = _leader(kinetic)
    names = [rod.name for rod in structure.rods] + [point.node for point in structure.lone_masses]
    names += [body.name for body in structure.bodies if not body.held]
    string, string_share = _leader(_string_energies(model, y, limit))
    return StableStep(
        limit=limit,
        scheme=scheme,
        omega=largest_frequency(model),
        time=float(time),
        nodes=np.array(model.state.nodes),
        motion=motion / largest if largest > 0 else motion,
        rod="" if body is None else names[body],
        rod_share=body_share,
        string="" if string is None else structure.strings[string].name,
        string_share=string_share,
        closed_loop=model.law is not None,
        notes=notes_on(model, stepping),
    )


def _leader(values: Array) -> tuple[int | None, float]:
    """The number of the largest of values >= 0, and its part of their sum."""
    total = float(values.sum())
    if not total > 0 or not math.isfinite(total):
        return None, 0.0
    return int(np.argmax(values)), float(values.max() / total)


def _string_energies(model: Vibration, y: Array, limit: float) -> Array:
    """(M,) how much each string has to do with a motion: its elastic, geometric and damping work in a step."""
    moved = model.motion(y)
    paths = model.scene.structure.paths
    apart = paths.spans(moved)
    along = np.sum(model.state.segments.directions * apart, axis=1)
    across = np.sum(apart * apart, axis=1) - along**2
    turned = paths.total(model.pull_per_length * np.maximum(across, 0.0))
    damped = 2 * model.damping / limit if 0 < limit < math.inf else 0.0
    return np.asarray((model.stiffness + damped) * paths.total(along) ** 2 + turned)


NEAR_POLE = 0.1  # sin φ below which the ODE's angles turn much faster than the rod


def notes_on(model: Vibration, stepping: Stepping) -> tuple[str, ...]:
    """List the effects that a model and its limit leave out, a sentence each."""
    return (*_of_strings(model), *_of_surroundings(model, stepping), *_of_integrator(model, stepping))


def _of_strings(model: Vibration) -> list[str]:
    structure, notes = model.scene.structure, []
    if model.at_edge.any():
        first_one = structure.strings[int(np.argmax(model.at_edge))].name
        notes.append(
            f"{int(model.at_edge.sum())} strings ('{first_one}' is one) are at the edge of slackness: they pull during "
            "half of a motion only, so that the limit may be larger than that of the taut side given here"
        )
    if not model.taut.all() and len(model.taut):
        slack = len(model.taut) - int(model.taut.sum())
        notes.append(f"{slack} of {len(model.taut)} strings are slack in this state and count once they are taut")
    return notes


def _of_surroundings(model: Vibration, stepping: Stepping) -> list[str]:
    scene, notes = model.scene, []
    if scene.resistance is not None and scene.resistance.drag is not None:
        notes.append("the damping of drag is not in the model: it matters where a fluid is fast")
    if scene.water is not None:
        slower = "added mass makes motions slower, so that the limit is on the safe side of it, but "
        surface = ", nor is the stiffness of buoyancy at the surface" if scene.structure.rods else ""
        notes.append(
            f"water is not in the model: {slower if scene.adding_mass else ''}the damping of drag, which matters where "
            f"the water is fast, is not there{surface}"
        )
    if scene.elements:
        names = ", ".join(dict.fromkeys(element.label for element in scene.elements))
        notes.append(
            f"of elements ({names}) the model has differences of their forces, the symmetric part of their stiffness"
        )
    stateful = ", ".join(dict.fromkeys(element.label for element in scene.elements if element.has_state))
    if stateful:
        notes.append(
            f"states of elements ({stateful}) stay as they are at the start in the model: explicit steps must also be "
            "short against their own rates, which are among the eigenvalues of linearize"
        )
    if scene.contact is not None and stepping.scheme is not None:
        notes.append(
            "contact is not in the model: where something touches, a step must also be below "
            f"{contact_limit(scene.contact, stepping.scheme):.3g} s for what rests to rest, and far below to resolve a "
            "landing (docs/contact.md)"
        )
    return notes


def _of_integrator(model: Vibration, stepping: Stepping) -> list[str]:
    structure, notes = model.scene.structure, []
    implicit = stepping.scheme is Scheme.VELOCITY_IMPLICIT and abs(model.string_damper - model.body_damper).max() > 0
    if implicit and model.state.joints is not None and (model.law is not None or not has_tree_model(model)):
        notes.append(
            "damped strings between rods that share nodes: what this integrator takes of a damper depends on how "
            "the rods hang on each other, which is in the limit of trees of up to 30 rods with supports that stand "
            "still and no law; the limit here is that without dampers, and the real one may be larger or smaller: use "
            "RK4, or measure it with tensegrity-mj audit stability"
        )
    elif implicit:
        notes.append(
            "dampers between bodies that move: this integrator does not keep angular momentum, and a structure that "
            "spins may spin up without bound at any step (docs/stability.md); at rest the limit holds"
        )
    if stepping.polar:
        b = directions(structure, model.state.nodes)
        sines = np.hypot(b[:, 0], b[:, 1])
        spatial = np.array([rod.support.plane is None for rod in structure.rods], bool)
        near = np.flatnonzero(spatial & (sines < NEAR_POLE))
        if len(near):
            notes.append(
                f"rod '{structure.rods[int(near[0])].name}' is near the pole of the ODE's angles: the limit is that of "
                "motions that are small even there"
            )
    return notes
