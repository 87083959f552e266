"""The largest stable step of a fixed-step engine, predicted from the linear model, and the warning before a run.

    found = stable_step(scene, tmj.MuJoCo(timestep=1e-3))
    found.limit, found.string, found.rod        # [s], and who is to blame

`small_motions` holds the model, `integrators` what each integrator makes of it. A linear model is of the state that
it is about: give a run, and the smallest limit of its configurations is found. What it cannot tell is in `notes`.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import finite, real_array
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, Command, Law, NativeLaw, native_law
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.capabilities import require_class_1
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.vibration.bodies import SLOTS, Bodies
from tensegrity_mj.vibration.contact_steps import contact_limit
from tensegrity_mj.vibration.integrators import Scheme, largest_frequency, limit_of, scheme_of
from tensegrity_mj.vibration.small_motions import DENSE, LawDerivative, Vibration, vibration
from tensegrity_mj.vibration.tree import has_tree_model

SAMPLES = 25  # configurations looked at along a run
LAW_STEP = 1e-5  # of the structure's size: a central difference's error is its square
NEAR_POLE = 0.1  # sin φ below which the ODE's angles turn much faster than the rod


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
        notes: what the number does not tell.
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
            "scheme": None if self.scheme is None else self.scheme.value,
            "omega": self.omega,
            "time": self.time,
            "rod": self.rod,
            "rod_share": self.rod_share,
            "string": self.string,
            "string_share": self.string_share,
            "closed_loop": self.closed_loop,
            "notes": list(self.notes),
        }


def stable_step(
    scene: Scene,
    engine: Any,
    *,
    law: Law | Callable[..., ArrayLike] | NativeLaw | None = None,
    actuation: Actuation | None = None,
    nodes: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    rest_lengths: ArrayLike | None = None,
    time: float = 0.0,
    run: Trajectory | None = None,
) -> StableStep:
    """The largest stable step of an engine with a fixed step.

    Args:
        scene: what moves.
        engine: `MuJoCo(...)`, `DAE(method=Method.RK4, ...)`, `ODE(...)`; its own step does not count.
        law: closes the loop, continuously. Where `actuation` holds something, the law only says what is held.
        actuation: continuous by default.
        nodes, velocities: (N, 3) the state; the scene's start by default.
        rest_lengths: (M,) [m]; the structure's by default, or what the law sets.
        time: [s], at which loads and law are evaluated, supports have moved, and strings have broken or not yet.
        run: a run of this structure instead of a state: the smallest limit of its configurations.

    Raises:
        OptionError: for arrays of another shape, a time below zero, a run of another structure, and for what is no
            scene, engine, actuation or run.
        StructureError: for the ODE, where rods share nodes.
        SceneError: for nodes that stretch a rod, or are not where supports have them at that time, and where the
            scene's numbers are too far apart for eigenvalues.
        InfeasibleError, ControllerError: what the law says at the state.
    """
    from tensegrity_mj.model.scene_checks import check_configuration

    if not isinstance(scene, Scene):
        raise OptionError(f"scene = {scene!r}; use a Scene, or load_scene(name or path)")
    if isinstance(engine, type) or not callable(getattr(engine, "run", None)):
        raise OptionError(f"engine = {engine!r}; use MuJoCo(...), DAE(...) or ODE(...)")
    if run is not None and not isinstance(run, Trajectory):
        raise OptionError(f"run = {run!r}; use a trajectory, as simulate(...) returns it")
    actuation = actuation or Actuation.continuous()
    if not isinstance(actuation, Actuation):
        raise OptionError(f"actuation = {actuation!r}; use Actuation.continuous() or one of the hold modes")
    if finite("time", time, " [s]") < 0:
        raise OptionError(f"time = {time!r}; it must be >= 0 s, as in a run")
    scheme = scheme_of(engine)
    structure = scene.structure
    if hasattr(engine, "least_sine"):
        require_class_1(structure, "the ODE is")
    native = law if isinstance(law, NativeLaw) or law is None else native_law(law, structure)
    asked = None if native is None or not native.address else _Law(scene, native)
    held = actuation.mode if asked is not None else None
    bodies = Bodies.of(structure)
    if run is not None:
        with _solvable(scene):
            return _along(run, scene, engine, scheme, asked, held, bodies)
    shape = (len(structure.nodes), 3)
    x = scene.nodes0 if nodes is None else real_array("nodes", nodes, shape, "m", False)
    v = scene.velocities0 if velocities is None else real_array("velocities", velocities, shape, "m/s", False)
    L0 = None if rest_lengths is None else real_array("rest_lengths", rest_lengths, (len(structure.strings),), "m")
    moved = {motion.support: motion.at(float(time))[0] for motion in scene.motions}
    check_configuration(structure, x, "stable_step: nodes", moved)
    with _solvable(scene):
        model = _model(scene, asked, held, x, v, L0, float(time), bodies)
        return _step_of(model, engine, scheme, time)


@contextlib.contextmanager
def _solvable(scene: Scene) -> Iterator[None]:
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


def _along(
    run: Trajectory,
    scene: Scene,
    engine: Any,
    scheme: Scheme | None,
    asked: _Law | None,
    held: Mode | None,
    bodies: Bodies,
) -> StableStep:
    if run.scene.structure.node_names != scene.structure.node_names or len(run.time) == 0:
        raise OptionError(f"run: it has no samples, or is of another structure than scene '{scene.name}'")
    rows = np.unique(np.linspace(0, len(run.time) - 1, SAMPLES).round().astype(int))
    found = None
    for row in rows.tolist():
        time = float(run.time[row])
        rest = None if asked is not None and held is Mode.CONTINUOUS else run.rest_lengths[row]
        model = _model(scene, asked, held, run.nodes[row], run.velocities[row], rest, time, bodies)
        here = _step_of(model, engine, scheme, time)
        if found is None or here.limit < found.limit:
            found = here
    assert found is not None
    return found


def _model(
    scene: Scene,
    asked: _Law | None,
    held: Mode | None,
    nodes: Array,
    velocities: Array,
    rest_lengths: Array | None,
    time: float,
    bodies: Bodies,
) -> Vibration:
    """The linear model about a state, with what the law sets there, and where it is continuous its derivative."""
    structure = scene.structure
    events = {event.string: event.time for event in scene.breaks}
    broken = np.array([events.get(string.name, math.inf) <= time for string in structure.strings], bool)
    densities = None
    rest = structure.rest_lengths if rest_lengths is None else rest_lengths
    if asked is not None:
        command = asked(time, nodes, velocities)
        lengths = structure.string_lengths(nodes)
        by_density = asked.native.command is Command.FORCE_DENSITY and held is Mode.CONTINUOUS
        if rest_lengths is None:
            rest = command
            if asked.native.command is Command.FORCE_DENSITY:
                rest = lengths * (1 - command / structure.stiffness)
        if by_density or held is Mode.HOLD_FORCE_DENSITY:
            densities = np.maximum(0.0, structure.stiffness * (1 - rest / lengths))
    model = vibration(
        scene, nodes, velocities, rest, force_densities=densities, broken=broken, time=time, bodies=bodies
    )
    if asked is None or held is not Mode.CONTINUOUS:
        return model
    if not model.is_dense:
        raise OptionError(f"the loop through the law is looked at for up to {DENSE // SLOTS} rods and point masses")
    return replace(model, law=asked.derivative(model, velocities, time))


class _Law:
    """A law's commands as a function of the state, and their derivative."""

    def __init__(self, scene: Scene, native: NativeLaw) -> None:
        from tensegrity_mj.dynamics.native.asking import ask_at_nodes
        from tensegrity_mj.dynamics.native.plant import Plant
        from tensegrity_mj.dynamics.native.slots import COMMAND, NODES, STATUS, VELOCITIES

        self.native = native
        self._plant = plant = Plant(scene, native, Actuation.continuous(), OnInfeasible.STOP)
        self._nodes, self._velocities, self._command = plant[NODES], plant[VELOCITIES], plant[COMMAND]
        self._ask, self._status = ask_at_nodes, STATUS

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        """(M,) force densities [N/m] or rest lengths [m].

        Raises:
            InfeasibleError, ControllerError: what the law says there.
        """
        from tensegrity_mj.errors import InfeasibleError

        table = self._plant.table
        self._nodes[:], self._velocities[:] = nodes, velocities
        status = int(self._ask(self._plant.address, time))
        self._plant.raise_if_failed(max(status, int(table[self._status])), time)
        if status == NO_SOLUTION:
            raise InfeasibleError(self._plant.infeasible_message(time))
        return np.array(self._command)

    def derivative(self, model: Vibration, velocities: Array, time: float) -> LawDerivative:
        """Its part of K and D at the state of a model, by central differences."""
        n, nodes = model.size, model.nodes
        at, values = np.zeros((len(model.taut), n)), np.zeros((len(model.taut), n))
        size = float(np.ptp(nodes, axis=0).max(initial=0.0)) or 1.0
        units = np.zeros((n, *nodes.shape))
        for k in range(n):
            units[k] = model.motion(model.project(np.eye(n)[k]))
        largest = np.abs(units).max(axis=(1, 2), initial=0.0)
        for k in np.flatnonzero(largest > 0).tolist():
            h = LAW_STEP * size / largest[k]
            ahead, behind = (self(time, nodes + x * units[k], velocities) for x in (h, -h))
            at[:, k] = (ahead - behind) / (2 * h)
            ahead, behind = (self(time, nodes, velocities + x * units[k]) for x in (h, -h))
            values[:, k] = (ahead - behind) / (2 * h)
        i, j = model.scene.structure.string_nodes.T
        # How lengths change with y: its transpose takes tensions to forces.
        stretch = np.einsum("mx,nmx->mn", model.direction, units[:, j] - units[:, i])
        if self.native.command is Command.FORCE_DENSITY:
            weight = np.where(model.taut, model.length, 0.0)
        else:
            weight = -np.where(model.taut, model.scene.structure.stiffness, 0.0)
        push = (stretch * weight[:, None]).T
        return LawDerivative(push @ at, push @ values)


def _constraint_modes(engine: Any) -> tuple[complex, ...]:
    """Eigenvalues [1/s] of the DAE's constraints with Baumgarte's stabilization, s² + k_d s + k_p = 0."""
    if getattr(getattr(engine, "drift", None), "value", "") != "baumgarte":
        return ()
    omega, zeta = engine.baumgarte_frequency, engine.baumgarte_damping
    root = complex(zeta * zeta - 1) ** 0.5
    return (omega * (-zeta + root), omega * (-zeta - root))


def _step_of(model: Vibration, engine: Any, scheme: Scheme | None, time: float) -> StableStep:
    n, structure = model.size, model.scene.structure
    if scheme is None:
        limit, y = math.inf, np.zeros(n)
    else:
        limit, y = limit_of(model, scheme, _constraint_modes(engine))
    motion = model.motion(y)
    largest = np.abs(motion).max(initial=0.0)
    kinetic = np.sum(y.reshape(-1, SLOTS) ** 2, axis=1)
    body, body_share = _leader(kinetic)
    names = [rod.name for rod in structure.rods] + [point.node for point in structure.point_masses]
    string, string_share = _leader(_string_energies(model, y, limit))
    return StableStep(
        limit=limit,
        scheme=scheme,
        omega=largest_frequency(model),
        time=float(time),
        nodes=np.array(model.nodes),
        motion=motion / largest if largest > 0 else motion,
        rod="" if body is None else names[body],
        rod_share=body_share,
        string="" if string is None else structure.strings[string].name,
        string_share=string_share,
        closed_loop=model.law is not None,
        notes=_notes(model, engine),
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
    i, j = model.scene.structure.string_nodes.T
    apart = moved[j] - moved[i]
    along = np.sum(model.direction * apart, axis=1)
    across = np.sum(apart * apart, axis=1) - along**2
    density = model.tension / np.where(model.length > 0, model.length, 1.0)
    damped = 2 * model.damping / limit if 0 < limit < math.inf else 0.0
    return np.asarray((model.stiffness + damped) * along**2 + density * np.maximum(across, 0.0))


def _notes(model: Vibration, engine: Any) -> tuple[str, ...]:
    scene, structure, notes = model.scene, model.scene.structure, []
    if model.at_edge.any():
        first_one = structure.strings[int(np.argmax(model.at_edge))].name
        notes.append(
            f"{int(model.at_edge.sum())} strings ('{first_one}' is one) are at the edge of slackness: they pull during "
            "half of a motion only, so that the limit may be larger than that of the taut side given here"
        )
    if not model.taut.all() and len(model.taut):
        slack = len(model.taut) - int(model.taut.sum())
        notes.append(f"{slack} of {len(model.taut)} strings are slack in this state and count once they are taut")
    if scene.resistance is not None and scene.resistance.drag is not None:
        notes.append("the damping of drag is not in the model: it matters where a fluid is fast")
    if scene.water is not None:
        notes.append(
            "water is not in the model: added mass makes motions slower, so that the limit is on the safe side of it, "
            "but the damping of drag, which matters where the water is fast, and the stiffness of buoyancy at the "
            "surface are left out"
        )
    if scene.elements:
        names = ", ".join(dict.fromkeys(element.label for element in scene.elements))
        notes.append(
            f"of elements ({names}) the model has differences of their forces, the symmetric part of their stiffness"
        )
    scheme = scheme_of(engine)
    if scene.contact is not None and scheme is not None:
        notes.append(
            "contact is not in the model: where something touches, a step must also be below "
            f"{contact_limit(scene.contact, scheme):.3g} s for what rests to rest, and far below to resolve a landing "
            "(docs/contact.md)"
        )
    implicit = scheme is Scheme.VELOCITY_IMPLICIT and abs(model.string_damper - model.body_damper).max() > 0
    if implicit and model.joints is not None and (model.law is not None or not has_tree_model(model)):
        notes.append(
            "damped strings between rods that share nodes: what this integrator knows of a damper depends on how the "
            "rods hang on each other, which is in the limit of trees of up to 30 rods with supports that stand still "
            "and no law; the limit here is that without dampers, and the real one may be larger or smaller: use RK4, "
            "or measure it with tensegrity-mj stability"
        )
    elif implicit:
        notes.append(
            "dampers between bodies that move: this integrator does not keep angular momentum, and a structure that "
            "spins may spin up without bound at any step (docs/stability.md); at rest the limit holds"
        )
    if hasattr(engine, "least_sine"):
        first, second = structure.rod_nodes.T
        b = (model.nodes[second] - model.nodes[first]) / structure.rod_lengths[:, None]
        sines = np.hypot(b[:, 0], b[:, 1])
        spatial = np.array([rod.support.plane is None for rod in structure.rods], bool)
        near = np.flatnonzero(spatial & (sines < NEAR_POLE))
        if len(near):
            notes.append(
                f"rod '{structure.rods[int(near[0])].name}' is near the pole of the ODE's angles: the limit is that of "
                "motions that are small even there"
            )
    return tuple(notes)
