"""A scene as a composer Entity: what it is in an arena, what can be observed of it, how it starts."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer import define
from dm_control.composer.observation import observable
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import member
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities
from tensegrity_mj.errors import OptionError
from tensegrity_mj.learning.dm_control.models import element
from tensegrity_mj.learning.dm_control.readings import HeldForces, StringActuators, point_velocities
from tensegrity_mj.learning.dm_control.stepping import checked_command
from tensegrity_mj.model.scene import Scene


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
        return np.array(physics.bind(self._tendons).length) if self._tendons else np.zeros(0)

    def rest_lengths(self, physics: Any) -> Array:
        """Rest lengths L0 (M,) [m]."""
        return self._strings.rest_lengths(self._ctrl(physics), self.string_lengths(physics))

    def force_densities(self, physics: Any) -> Array:
        """Force densities u (M,) [N/m]."""
        return self._strings.force_densities(self._ctrl(physics), self.string_lengths(physics), physics.time())

    def tensions(self, physics: Any) -> Array:
        """Tensions T (M,) [N] at this state."""
        rates = np.array(physics.bind(self._tendons).velocity) if self._tendons else np.zeros(0)
        return self._strings.tensions(self._ctrl(physics), self.string_lengths(physics), rates, physics.time())

    def _ctrl(self, physics: Any) -> Array:
        return np.array(physics.bind(self.actuators).ctrl) if self.actuators else np.zeros(0)

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
            values = self._strings.limited(values, self._ctrl(physics), self.string_lengths(physics), period)
            physics.bind(self.actuators).ctrl = self._strings.controls(values)

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
            ctrl, lengths = self._ctrl(physics), self.string_lengths(physics)
            limits = self._strings.force_limits(ctrl, lengths, physics.time())
            physics.bind(self.actuators).forcerange = limits
        if self._load_actuators:
            option = physics.model.opt
            middle = option.integrator == mujoco.mjtIntegrator.mjINT_RK4
            state = self.nodes(physics), self.velocities(physics)
            forces = self._forces.controls(physics.time(), option.timestep, middle, *state)
            physics.bind(self._load_actuators).ctrl = forces


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
