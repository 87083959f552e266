"""A scene as a composer Entity: what it is in an arena, what can be observed of it, how it starts.

An attached model keeps no options of its own: PyMJCF merges them with those of the model that takes it in, and refuses
where they differ. So the element holds the scene's bodies, strings and what pushes its nodes alone, and `adopt_options`
sets on the whole what to run with. Keyframes, lights and statistics are left out for the same reason.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer import define
from dm_control.composer.observation import observable
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.basics.checks import member, real_array
from tensegrity_mj.dm_control.models import model
from tensegrity_mj.dm_control.readings import HeldForces, StringActuators, point_velocities
from tensegrity_mj.dm_control.repairing import repair
from tensegrity_mj.dm_control.stepping import checked_command
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco.engine import MuJoCo
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities
from tensegrity_mj.engines.mujoco.settings import Integrator
from tensegrity_mj.errors import OptionError, StructureError
from tensegrity_mj.model.scene import Scene

if TYPE_CHECKING:
    from dm_control.mjcf import RootElement


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
        """‖s‖ (M,) [m]."""
        return np.array(physics.bind(self._tendons).length) if self._tendons else np.zeros(0)

    def rest_lengths(self, physics: Any) -> Array:
        """L0 (M,) [m]."""
        return self._strings.rest_lengths(self._ctrl(physics), self.string_lengths(physics))

    def force_densities(self, physics: Any) -> Array:
        """u (M,) [N/m]."""
        return self._strings.force_densities(self._ctrl(physics), self.string_lengths(physics), physics.time())

    def tensions(self, physics: Any) -> Array:
        """T (M,) [N] at this state."""
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
        """Once a physics step: forces on nodes, breaks, no damping in slack strings."""
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
    """What the entity's method of that name reads, as an observable."""

    def made(self: composer.Observables) -> Any:
        return observable.Generic(getattr(self._entity, name))

    made.__name__, made.__doc__ = name, getattr(TensegrityEntity, name).__doc__  # dm_control keeps it by its name
    return define.observable(made)


class TensegrityObservables(composer.Observables):  # type: ignore[misc]
    """What can be observed of a scene, in its own frame; SI units."""

    nodes, velocities = _observed("nodes"), _observed("velocities")
    string_lengths, rest_lengths = _observed("string_lengths"), _observed("rest_lengths")
    tensions = _observed("tensions")


# Parts of the model that belong to the whole, not to one of its members.
_WHOLE = ("compiler", "option", "statistic", "visual", "keyframe")


def element(scene: Scene, command: Command = Command.REST_LENGTH, name: str | None = None) -> RootElement:
    """A PyMJCF RootElement of a scene, to be attached to another model at any frame.

    Controls are changes of rest lengths [m] from the designed ones, or force densities [N/m]. It is at rest when
    attached; `TensegrityEntity` gives it the scene's velocities, which are `mjcf.initial_velocities` in the order of
    the element's joints. Free rods have three slides and a ball joint, since MuJoCo allows a free joint at the top of
    the world only; their coordinates are the same.

    Args:
        scene: the experiment.
        command: what the actuators take.
        name: of the model, which becomes the prefix of all names; the scene's by default.

    Raises:
        OptionError: for a command that is none, a name that PyMJCF cannot hold, or a scene with contact.
        StructureError: for names with a slash, which PyMJCF keeps to itself, for rods that share nodes, for bodies, and
            for what MuJoCo cannot hold.
        SceneError: for supports that move, and for water that adds mass to rods.
    """
    if scene.contact is not None:
        raise OptionError(
            f"scene '{scene.name}' has contact, whose floor and solver options belong to a whole model: attach "
            "scene.with_(contact=None) and give the arena what it is to touch, or use physics(scene) or an Environment"
        )
    if scene.structure.bodies:
        raise StructureError(
            f"'{scene.structure.bodies[0].name}' is a body (structure.bodies): PyMJCF elements are for rods and point "
            "masses; use physics(scene) or an Environment"
        )
    options = MuJoCo()
    options.model(scene)  # for its errors
    member("command", command, Command)
    if name is not None and (not isinstance(name, str) or not name or "/" in name):
        raise OptionError(f"name = {name!r}; it must be a text without '/', which PyMJCF puts between names")
    root = model(scene, command, options)
    for part in root.iter():
        if "/" in part.get("name", ""):
            raise StructureError(
                f"{part.tag} '{part.get('name')}': PyMJCF puts '/' between the names of models; rename it without one"
            )
    for part in [part for part in root if part.tag in _WHOLE]:
        root.remove(part)
    root.set("model", (name or root.get("model") or "").replace("/", " ") or "tensegrity")
    world = root.find("worldbody")
    assert world is not None
    for light in world.findall("light"):
        world.remove(light)
    for number, body in enumerate(world.findall("body")[: len(scene.structure.rods)]):
        _unfree(body, scene, number)
    repair()
    from dm_control import mjcf

    return mjcf.from_xml_string(ET.tostring(root, encoding="unicode"))


def _unfree(body: ET.Element, scene: Scene, number: int) -> None:
    """Replace a rod's free joint by slides along the scene's axes and a ball joint: the same coordinates."""
    free = body.find("freejoint")
    if free is None:
        return
    body.remove(free)
    first, second = scene.nodes0[scene.structure.rod_nodes[number]]
    rotation = rotation_to((second - first) / np.linalg.norm(second - first))
    for at, axis in enumerate(rotation):  # rows: the scene's axes seen from the body
        body.insert(at, ET.Element("joint", type="slide", axis=" ".join(repr(float(x)) for x in axis)))
    body.insert(3, ET.Element("joint", name=free.get("name", ""), type="ball"))


def adopt_options(
    root: Any,
    scene: Scene,
    timestep: float = 1e-3,
    integrator: Integrator = Integrator.RK4,
    rotation: ArrayLike | None = None,
) -> None:
    """Give a PyMJCF model the options that a scene is run with: time step, integrator, gravity, and no autoreset.

    Call it on the model that elements of the scene are attached to. Compiler settings are left alone;
    `TensegrityEntity` checks that they have not changed the scene's masses.

    Args:
        root: the RootElement of the whole, an arena's `mjcf_model` for instance.
        scene: the experiment.
        timestep: h [s].
        integrator: see `Integrator`.
        rotation: (3, 3), of the frame that the element is attached at: gravity is turned with it. None for no turn.

    Raises:
        OptionError: for values that are none of these.
    """
    options = MuJoCo(timestep, integrator)
    matrix = np.eye(3) if rotation is None else real_array("rotation", rotation, (3, 3), scalar=False)
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-9 or np.linalg.det(matrix) < 0:
        raise OptionError(f"rotation = {matrix.tolist()}; it must be a rotation matrix")
    root.option.timestep = options.timestep
    root.option.integrator = options.word
    root.option.gravity = matrix @ np.array(scene.gravity)
    root.option.flag.autoreset = "disable"  # a reset behind one's back would hide a divergence
