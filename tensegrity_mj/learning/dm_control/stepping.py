"""A dm_control Physics and a composer Entity that keep a scene's strings and forces true to it from step to step.

The Physics is of the scene alone; the Entity is the scene in an arena: what can be observed of it, how it starts.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer import define
from dm_control.composer.observation import observable
from dm_control.mujoco import Physics
from dm_control.rl.control import PhysicsError
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import member
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco.contact import hold_spins
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities
from tensegrity_mj.errors import ControllerError, DivergenceError, OptionError
from tensegrity_mj.learning.dm_control.models import element
from tensegrity_mj.learning.dm_control.readings import HeldForces, StringActuators, Strings, point_velocities
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.energy import BEYOND


class PhysicsDivergence(DivergenceError, PhysicsError):  # type: ignore[misc]
    """Divergence of a step, as our error and as dm_control's PhysicsError: a value became infinite or NaN."""


class ScenePhysics(Physics):  # type: ignore[misc]
    """A dm_control Physics of a scene; make it with `physics(scene)`.

    Attributes:
        scene: what it is a model of.
        command: what its actuators take: changes of rest lengths, or force densities.
    """

    scene: Scene
    command: Command

    @classmethod
    def of_scene(cls, scene: Scene, command: Command, text: str) -> ScenePhysics:
        """Make the Physics of a scene from the MJCF text of `models.model`."""
        result: ScenePhysics = cls.from_xml_string(text)
        result._equip(scene, command)
        result.reset()
        return result

    def _equip(self, scene: Scene, command: Command) -> None:
        self.scene, self.command = scene, command
        self.string_actuators, self.forces = StringActuators(scene, command, self.timestep()), HeldForces(scene)
        model = self.model.ptr
        hold_spins(model, scene)
        self._sites = np.array([model.site(name).id for name in scene.structure.node_names], np.int64)
        self._bodies = np.asarray(model.site_bodyid[self._sites])
        self._size = len(scene.structure.strings)

    # Reading

    def nodes(self) -> Array:
        """Node positions (N, 3) [m]."""
        return np.array(self.data.ptr.site_xpos[self._sites])

    def velocities(self) -> Array:
        """Node velocities (N, 3) [m/s]."""
        return point_velocities(self.model.ptr, self.data.ptr, self._bodies, self.data.ptr.site_xpos[self._sites])

    def string_lengths(self) -> Array:
        """String lengths ‖s‖ (M,) [m]."""
        return np.array(self.data.ptr.ten_length)

    def rest_lengths(self) -> Array:
        """Rest lengths L0 (M,) [m]."""
        return self.string_actuators.rest_lengths(self._strings())

    def force_densities(self) -> Array:
        """Force densities u (M,) [N/m]."""
        return self.string_actuators.force_densities(self._strings())

    def tensions(self) -> Array:
        """Tensions T (M,) [N] at this very state (MuJoCo's actuator_force is that of the last stage)."""
        return self.string_actuators.tensions(self._strings())

    def _strings(self) -> Strings:
        data = self.data.ptr
        return Strings(np.array(data.ctrl[: self._size]), self.string_lengths(), np.array(data.ten_velocity), data.time)

    # Acting

    def set_control(self, control: ArrayLike) -> None:
        """Controls (M,) of the strings as MuJoCo has them: changes of rest lengths [m], or force densities [N/m].

        Raises:
            ControllerError: for another shape, or a value that is not finite.
        """
        self.data.ptr.ctrl[: self._size] = self._checked("control", control)

    def set_command(self, command: ArrayLike, period: float | None = None) -> None:
        """Rest lengths (M,) [m], or force densities [N/m], held until the next command.

        Kept within the limits of the strings; within that of the winches' speed if the `period` [s] to the next command
        is given.

        Raises:
            ControllerError: for another shape, or a value that is not finite.
        """
        values = self._checked(self.command.value, command)
        self.set_control(self.string_actuators.control(values, self._strings(), period))

    def _checked(self, what: str, value: ArrayLike) -> Array:
        names = [string.name for string in self.scene.structure.strings]
        return checked_command(what, value, names)

    # Stepping

    def step(self, nstep: int = 1) -> None:
        """Advance by so many time steps.

        Raises:
            PhysicsDivergence: where a value becomes infinite or NaN.
            OptionError, ElementError: where the scene's load function or an element fails.
        """
        if self.string_actuators.needs_limits or len(self.forces):
            model, data = self.model.ptr, self.data.ptr
            for _ in range(nstep):
                # Once a step: forces on nodes, breaks and damping of slack strings; a callback would at each stage.
                if self.string_actuators.needs_limits:
                    model.actuator_forcerange[: self._size] = self.string_actuators.force_limits(self._strings())
                if len(self.forces):
                    forces = self.forces.controls(data.time, model.opt, self.nodes(), self.velocities())
                    data.ctrl[self._size :] = forces
                self._advance(1)
        else:
            self._advance(nstep)

    def _advance(self, nstep: int) -> None:
        try:
            super().step(nstep)
        except PhysicsError as error:
            self._diverged(" ".join(str(error).split()), error)
        data = self.data.ptr
        if not (np.all(np.abs(data.qpos) < BEYOND) and np.all(np.abs(data.qvel) < BEYOND)):
            self._diverged(f"positions or velocities are beyond {BEYOND:g} m or m/s", None)

    def _diverged(self, cause: str, error: Exception | None) -> None:
        time, h = float(self.data.time), float(self.model.opt.timestep)
        raise PhysicsDivergence(
            f"diverged by t = {time:.6g} s: {cause}; reduce the time step (h = {h:g} s), or give milder actions; "
            "reset() begins anew",
            time,
        ) from error

    # Starting

    def reset(self, keyframe_id: int | None = None) -> None:
        """Go back to the scene's start, with the structure as designed."""
        super().reset(keyframe_id)
        self.data.ptr.qvel[:] = initial_velocities(self.scene)
        self.settle()

    def settle(self) -> None:
        """Take up a start: the lengths there, and the structure as designed."""
        self.forward()  # for the lengths
        self.data.ptr.ctrl[: self._size] = self.string_actuators.designed(self.string_lengths())
        self.after_reset()

    def after_reset(self) -> None:
        """Compute derived quantities as dm_control does, but with the strings, whose controls act from the start."""
        self.forward()

    # Copies

    def copy(self, share_model: bool = False) -> ScenePhysics:
        """A copy in the same state."""
        result: ScenePhysics = super().copy(share_model)
        result._equip(self.scene, self.command)
        return result

    def __getstate__(self) -> Any:
        return super().__getstate__(), self.scene, self.command

    def __setstate__(self, state: Any) -> None:
        data, scene, command = state
        super().__setstate__(data)
        self._equip(scene, command)


def checked_command(what: str, value: ArrayLike, names: list[str]) -> Array:
    """Return the value as finite floats, one a string; raise ControllerError that names the string at fault."""
    try:
        array = np.asarray(value)
        if np.iscomplexobj(array):
            raise ValueError
        array = array.astype(float)
    except (TypeError, ValueError):
        raise ControllerError(f"{what} = {value!r}; it must be {len(names)} real numbers, one a string") from None
    if array.shape != (len(names),):
        raise ControllerError(f"{what} has shape {array.shape}; it must be ({len(names)},), a value a string")
    if not np.all(np.isfinite(array)):
        number = int(np.argmin(np.isfinite(array)))
        raise ControllerError(f"{what} of string '{names[number]}' = {array[number]}; it must be finite")
    return array


class TensegrityEntity(composer.Entity):  # type: ignore[misc]
    """A scene that can be attached to an arena or to another entity, any number of times.

        arena = composer.Arena()
        adopt_options(arena.mjcf_model, scene)
        robot = TensegrityEntity(scene)
        arena.attach(robot)

    Positions and velocities are those in the entity's own frame, which is the scene's world frame: a control law made
    for the scene can be fed with them wherever the entity is.

    Args:
        scene: the experiment.
        command: what its actuators take.
        name: of the model; the scene's by default.

    Attributes:
        scene: what it is made from.
        actuators: one a string, in the scene's order.
        joints: in the order of `mjcf.initial_velocities`.

    Raises:
        OptionError, StructureError: as `element`.
    """

    def _build(self, scene: Scene, command: Command = Command.REST_LENGTH, name: str | None = None) -> None:
        member("command", command, Command)
        self.scene = scene
        self._mjcf_root = element(scene, command, name)
        self._command, self._forces = command, HeldForces(scene)
        self._strings = StringActuators(scene, command, timestep=1e-3)
        root, structure = self._mjcf_root, scene.structure
        actuators = list(root.actuator.general)
        self.actuators = tuple(actuators[: len(structure.strings)])
        self._load_actuators = tuple(actuators[len(structure.strings) :])
        self._tendons = tuple(root.tendon.spatial)
        self._sites = tuple(root.find("site", node) for node in structure.node_names)
        self._bodies = tuple(root.worldbody.body)
        self.joints = tuple(joint for body in self._bodies for joint in body.joint)

    def _build_observables(self) -> TensegrityObservables:
        return TensegrityObservables(self)

    @property
    def mjcf_model(self) -> Any:
        """The PyMJCF root element."""
        return self._mjcf_root

    # Reading

    def nodes(self, physics: Any) -> Array:
        """Node positions (N, 3) [m] in the entity's frame."""
        origin, turn, _ = self._frame(physics)
        return np.asarray((physics.bind(self._sites).xpos - origin) @ turn)

    def velocities(self, physics: Any) -> Array:
        """Node velocities (N, 3) [m/s] relative to the entity's frame, which may itself move."""
        _, turn, body = self._frame(physics)
        sites = np.asarray(physics.bind(self._sites).element_id)
        model, data = physics.model.ptr, physics.data.ptr
        points = data.site_xpos[sites]
        own = point_velocities(model, data, model.site_bodyid[sites], points)
        return np.asarray((own - point_velocities(model, data, np.full(len(sites), body), points)) @ turn)

    def string_lengths(self, physics: Any) -> Array:
        """String lengths ‖s‖ (M,) [m]."""
        return self._state(physics).lengths

    def rest_lengths(self, physics: Any) -> Array:
        """Rest lengths L0 (M,) [m]."""
        return self._strings.rest_lengths(self._state(physics))

    def force_densities(self, physics: Any) -> Array:
        """Force densities u (M,) [N/m]."""
        return self._strings.force_densities(self._state(physics))

    def tensions(self, physics: Any) -> Array:
        """Tensions T (M,) [N] at this state."""
        return self._strings.tensions(self._state(physics))

    def _state(self, physics: Any) -> Strings:
        if not self._tendons:
            return Strings(np.zeros(0), np.zeros(0), np.zeros(0), physics.time())
        bound, ctrl = physics.bind(self._tendons), np.array(physics.bind(self.actuators).ctrl)
        return Strings(ctrl, np.array(bound.length), np.array(bound.velocity), physics.time())

    def _frame(self, physics: Any) -> tuple[Array, Array, int]:
        """Origin (3,), rotation (3, 3) and body of the frame that the entity is attached at."""
        frame = mjcf.get_attachment_frame(self._mjcf_root)
        if frame is None:
            return np.zeros(3), np.eye(3), 0
        bound = physics.bind(frame)
        return np.array(bound.xpos), np.array(bound.xmat).reshape(3, 3), int(bound.element_id)

    # Acting

    def set_command(self, physics: Any, command: ArrayLike, period: float | None = None) -> None:
        """Set rest lengths (M,) [m], or force densities [N/m]: as `ScenePhysics.set_command`."""
        names = [string.name for string in self.scene.structure.strings]
        values = checked_command(self._command.value, command, names)
        if self.actuators:
            physics.bind(self.actuators).ctrl = self._strings.control(values, self._state(physics), period)

    # Hooks of composer; whoever steps without a composer Environment calls them likewise.

    def after_compile(self, physics: Any, random_state: Any = None) -> None:
        """Take the arena's time step, and see that its compiler settings left the masses as they are.

        Raises:
            OptionError: naming the body and what to look for.
        """
        self._strings = StringActuators(self.scene, self._command, physics.timestep())
        for body in self._bodies:
            bound, wanted = physics.bind(body), body.inertial
            found = np.array([bound.mass, *bound.inertia], float)
            if not np.allclose(found, [wanted.mass, *wanted.diaginertia], rtol=1e-9, atol=0):
                raise OptionError(
                    f"body '{body.full_identifier}' has {found[0]:.9g} kg and {found[1:]} kg m² instead of "
                    f"{wanted.mass:.9g} and {wanted.diaginertia}: take inertiafromgeom, balanceinertia, boundmass, "
                    "boundinertia and settotalmass out of the compiler settings of the model it is attached to"
                )

    def initialize_episode(self, physics: Any, random_state: Any = None) -> None:
        """Give it the scene's initial velocities, and the strings as designed; positions are the model's own."""
        physics.bind(self.joints).qvel = initial_velocities(self.scene)
        mujoco.mj_fwdPosition(physics.model.ptr, physics.data.ptr)  # for the lengths
        if self.actuators:
            physics.bind(self.actuators).ctrl = self._strings.designed(self.string_lengths(physics))

    def before_substep(self, physics: Any, random_state: Any = None) -> None:
        """Renew, once a physics step, forces on nodes, breaks and damping of slack strings."""
        if self._strings.needs_limits:
            physics.bind(self.actuators).forcerange = self._strings.force_limits(self._state(physics))
        if self._load_actuators:
            state = self.nodes(physics), self.velocities(physics)
            physics.bind(self._load_actuators).ctrl = self._forces.controls(physics.time(), physics.model.opt, *state)


def _observed(name: str) -> Any:
    """Make an observable of the entity's method of that name."""

    def made(self: composer.Observables) -> Any:
        return observable.Generic(getattr(self._entity, name))

    made.__name__, made.__doc__ = name, getattr(TensegrityEntity, name).__doc__  # dm_control keeps it by its name
    return define.observable(made)


class TensegrityObservables(composer.Observables):  # type: ignore[misc]
    """Observables of a scene, in its own frame; SI units."""

    nodes, velocities = _observed("nodes"), _observed("velocities")
    string_lengths, rest_lengths = _observed("string_lengths"), _observed("rest_lengths")
    tensions = _observed("tensions")
