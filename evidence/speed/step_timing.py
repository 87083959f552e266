"""Time of a scene's step in MuJoCo, of its parts, and of features that the scene does not need.

Everything is measured side by side: models take turns, each steps the same number of times from the same start, and the
least of several rounds counts. On a busy machine times wander all the same; ratios do less.

The parts are by MuJoCo's own timers, whose clock takes 2 to 35 % of a step (`engines.mujoco.install`): given as shares.

A further step of a run, with ledger, recording and law, is timed in pieces of 0.2 ms of one run from the scene's start,
of which the median counts. Costs that a run has only once (set-up, its first piece) are in none of them. Such pieces
are shorter than a process' time slice: other programs on the machine disturb few of them, while a whole run of some
milliseconds would count their slices, too.
"""

from __future__ import annotations

import contextlib
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.controllers.scenes import from_scene
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.run import MuJoCoRun
from tensegrity_mj.engines.mujoco.run_view import STEP
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.engines.request import Request, request_for
from tensegrity_mj.errors import TensegrityError
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.elements.contact import rod_gaps
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.vibration.stable_step import stable_step

ROUNDS = 60
PIECE = 2e-4  # s: what a run is timed in: as short as leaves the clock below a part in a thousand
PIECES = 200  # of a run, about
FEWEST = 3  # that are enough to say what a step costs
SLICE = 1e-3  # s: what a model steps for in a round, about: short, so that some slices are not disturbed

_TIMERS = mujoco.mjtTimer
# Parts of a step, and the timers that make them up.
PARTS = {
    "positions and string lengths": (_TIMERS.mjTIMER_POS_KINEMATICS,),
    "inertia": (_TIMERS.mjTIMER_POS_INERTIA,),
    "velocities": (_TIMERS.mjTIMER_VELOCITY,),
    "string forces": (_TIMERS.mjTIMER_ACTUATION,),
    "contact and constraints": (
        _TIMERS.mjTIMER_POS_COLLISION,
        _TIMERS.mjTIMER_POS_MAKE,
        _TIMERS.mjTIMER_POS_PROJECT,
        _TIMERS.mjTIMER_CONSTRAINT,
    ),
}
REST = "integration and the rest"
_NO_CONTACT = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
THE_SCENE, CONTACT = "", "contact, before anything touches"


@dataclass(frozen=True)
class Extra:
    """Cost of one feature: the ratio of a step with it to a step without it."""

    what: str
    ratio: float
    needed: bool  # whether the scene has it


@dataclass(frozen=True)
class StepTiming:
    """Times of one step of MuJoCo's RK4 from the scene's start.

    Attributes:
        step: of the bare model, without a law [s]; the least of several rounds.
        shares: parts of it, which sum to 1.
        passive_run: of a further step of a run without a law, with ledger and recording, without set-up [s]: the
            median of pieces of the run; None where none succeeds.
        closed_loop: the same under the scene's law, sampled where it must be; None without one, or where none succeeds.
        run_time: how far the longer of these runs went [s]; 0 where none succeeds.
        timestep: of all [s].
        extras: what other things would cost, and contact where it is there.
    """

    step: float
    shares: dict[str, float]
    passive_run: float | None
    closed_loop: float | None
    run_time: float
    timestep: float
    extras: tuple[Extra, ...] = field(default_factory=tuple)


def measure(scene: Scene, rounds: int = ROUNDS) -> StepTiming:
    """Measure a scene; about a second. The steps are short enough for the scene to be stable: that costs nothing."""
    models = {THE_SCENE: mujoco.MjModel.from_xml_string(scene_to_mjcf(scene)), **variants(scene)}
    timestep = min(MuJoCo().timestep, stable_step(scene.with_(contact=None), MuJoCo(), law=None).limit / 10)
    for model in models.values():
        model.opt.timestep = timestep
    handler = mujoco.get_mju_user_warning()
    try:
        mujoco.set_mju_user_warning(lambda text: None)  # MuJoCo's own writes a file into the current folder
        least, steps = _race(models, rounds)
        shares = _shares(models[THE_SCENE], steps, rounds)
    finally:
        mujoco.set_mju_user_warning(handler)
    step = least.pop(THE_SCENE)
    extras = [
        Extra(what, step / other if what == CONTACT else other / step, needed=what == CONTACT)
        for what, other in least.items()
    ]
    engine, size = MuJoCo(timestep), max(1, round(PIECE / step))
    passive, went = _further_step(scene, None, engine, size)
    closed: float | None = None
    if scene.control is not None:
        closed, further = _further_step(scene, from_scene(scene), engine, size)
        went = max(went, further)
    return StepTiming(step, shares, passive, closed, went, timestep, tuple(extras))


def _race(models: dict[str, mujoco.MjModel], rounds: int) -> tuple[dict[str, float], int]:
    """Least time of a step of each model [s], in turns; and how many steps were timed at a time.

    Models in which something touches, which is more than is to be measured, are left out.
    """
    data = {name: mujoco.MjData(model) for name, model in models.items()}

    def seconds(name: str, steps: int) -> float:
        mujoco.mj_resetData(models[name], data[name])
        start = time.perf_counter()
        mujoco.mj_step(models[name], data[name], steps)
        return time.perf_counter() - start

    first = next(iter(models))
    seconds(first, 20)
    steps = max(5, min(1000, round(SLICE / (seconds(first, 20) / 20))))
    least = dict.fromkeys(models, np.inf)
    for _ in range(rounds):
        for name in models:
            least[name] = min(least[name], seconds(name, steps) / steps)
    return {name: value for name, value in least.items() if name == THE_SCENE or not data[name].ncon}, steps


def _shares(model: mujoco.MjModel, steps: int, rounds: int) -> dict[str, float]:
    data = mujoco.MjData(model)
    best, total = np.zeros(len(data.timer)), np.inf
    for _ in range(rounds):
        mujoco.mj_resetData(model, data)
        mujoco.mj_step(model, data, steps)
        times = np.array([timer.duration for timer in data.timer])
        if times[_TIMERS.mjTIMER_STEP] < total:
            best, total = times, float(times[_TIMERS.mjTIMER_STEP])
    shares = {name: float(sum(best[timer] for timer in timers) / total) for name, timers in PARTS.items()}
    return shares | {REST: 1.0 - sum(shares.values())}


class _PieceRun(MuJoCoRun):
    """A run that is timed piece by piece."""

    size = 1  # steps of a piece

    def __init__(self, engine: MuJoCo, request: Request, size: int) -> None:
        super().__init__(engine, request)
        self.size, self.pieces = size, list[float]()

    def _advance(self, first: int, count: int) -> None:
        for done in range(0, count, self.size):
            steps = min(self.size, count - done)
            start = time.perf_counter()
            super()._advance(first + done, steps)
            spent = time.perf_counter() - start
            # The first piece has what is done but once; a chunk's last one may be short, and the law may stop the run.
            if first + done > 0 and steps == self.size and self.counters[STEP] == first + done + steps:
                self.pieces.append(spent / steps)


def _further_step(scene: Scene, law: Any, engine: MuJoCo, size: int) -> tuple[float | None, float]:
    """Time of a further step in a run [s], or None where no run succeeds, and the time that the run reached [s]."""
    sampled = law is not None and native_law(law, scene.structure).discontinuous
    actuation = Actuation.hold_force_density(10 * engine.timestep) if sampled else None
    count = min((PIECES + 1) * size, int(scene.duration / engine.timestep * (1 + 1e-12)))
    count = max(10, 10 * (count // 10))
    duration = count * engine.timestep
    run = None
    # Where none succeeds, the scene is described all the same.
    with warnings.catch_warnings(), contextlib.suppress(TensegrityError):
        warnings.simplefilter("ignore")
        request = request_for(scene.with_(breaks=()), law, duration, actuation, OnInfeasible.STOP, None, False)
        run = _PieceRun(engine, request, min(size, max(1, count // (FEWEST + 1))))
        run.run()
    if run is None or not run.pieces:
        return None, 0.0
    return statistics.median(run.pieces), int(run.counters[STEP]) * engine.timestep


# Variants of a scene's model, by what they have more (for contact that is there: less): edits of its specification,
# which return whether they change anything.
Edit = Callable[[Any, Scene], bool]
_EDITS: dict[str, Edit] = {}


def _edit(what: str) -> Callable[[Edit], Edit]:
    return lambda edit: _EDITS.setdefault(what, edit)


def variants(scene: Scene) -> dict[str, mujoco.MjModel]:
    """The scene's model with one thing changed, by what it is; those that would change nothing are left out."""
    text = scene_to_mjcf(scene)
    specs = {what: mujoco.MjSpec.from_string(text) for what in _EDITS}
    return {what: specs[what].compile() for what, edit in _EDITS.items() if edit(specs[what], scene)}


def _switch_contact(spec: Any, contype: int, conaffinity: int) -> None:
    spec.option.disableflags &= ~_NO_CONTACT  # joints that close loops have switched constraints on already
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = contype, conaffinity


@_edit(CONTACT)
def _without_contact(spec: Any, scene: Scene) -> bool:
    spec.option.disableflags |= _NO_CONTACT
    return scene.contact is not None


@_edit("contact with a floor, without a touch")
def _with_floor(spec: Any, scene: Scene) -> bool:
    if scene.contact is not None:
        return False
    _switch_contact(spec, 0, 1)
    depth = 100.0 * max(1.0, float(np.abs(scene.nodes0).max()))
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(type=plane, pos=[0, 0, -depth], size=[0, 0, 1], contype=1, conaffinity=0)
    return True


@_edit("contact between rods, without a touch")
def _with_rods(spec: Any, scene: Scene) -> bool:
    if scene.contact is not None or len(scene.structure.rods) < 2 or scene.structure.class_number > 1:
        return False
    if np.any(rod_gaps(scene.structure, scene.nodes0)[1] <= 0):
        return False
    _switch_contact(spec, 1, 1)
    return True


@_edit("ball and free joints in the plane")
def _with_spatial_joints(spec: Any, scene: Scene) -> bool:
    hinges = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    for joint in hinges:
        joint.type = mujoco.mjtJoint.mjJNT_BALL
        if len(joint.parent.joints) == 3:  # two slides and a hinge: free in the plane
            _set_free(spec, joint.parent)
    return bool(hinges)


def _set_free(spec: Any, body: Any) -> None:
    for joint in body.joints:
        spec.delete(joint)
    body.add_freejoint()


@_edit("a sensor a string")
def _with_sensors(spec: Any, scene: Scene) -> bool:
    kinds = {"type": mujoco.mjtSensor.mjSENS_TENDONACTFRC, "objtype": mujoco.mjtObj.mjOBJ_TENDON}
    for string in scene.structure.strings:
        spec.add_sensor(**kinds, objname=string.name)
    return bool(scene.structure.strings)


@_edit("pins as constraint rows")
def _with_rows(spec: Any, scene: Scene) -> bool:
    spec.option.disableflags &= ~mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
    pairs = zip(spec.worldbody.bodies, scene.structure.rods, strict=False)
    pinned = [body for body, rod in pairs if rod.support.translation_basis.shape[1] == 0]
    kinds = {"type": mujoco.mjtEq.mjEQ_CONNECT, "objtype": mujoco.mjtObj.mjOBJ_BODY}
    for body in pinned:
        _set_free(spec, body)
        spec.add_equality(**kinds, name1=body.name, data=np.zeros(mujoco.mjNEQDATA))  # at its own origin
    return bool(pinned)


@_edit("gravity")
def _with_gravity(spec: Any, scene: Scene) -> bool:
    spec.option.gravity = (0, 0, -9.81)
    return not any(scene.gravity)


@_edit("MuJoCo's energy")
def _with_energy(spec: Any, scene: Scene) -> bool:
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    return True
