"""The MJCF of a scene as dm_control needs it, and a PyMJCF element that other models take in.

It adds two things to `mjcf.scene_to_mjcf`, since dm_control has no place for a control callback:

- Where actions are force densities, an actuator's gain is minus its string's length, so that its control is u itself:
  the rest length L0 = L (1 - u/k) is renewed at every stage of the integrator, without a callback.
- Forces on nodes (loads, wind, drag, elements) are three more actuators a node. They push along the scene's axes,
  however the rod has turned by then.

An attached model keeps no options of its own: PyMJCF merges them with those of the model that takes it in, and refuses
where they differ. So an element holds the scene's bodies, strings and what pushes its nodes alone, and `adopt_options`
sets on the whole what to run with. Keyframes, lights and statistics are left out for the same reason.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import rotation_to
from tensegrity_mj.basics.checks import member, real_array
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco import mjcf, mjcf_tree
from tensegrity_mj.engines.mujoco.settings import Integrator, MuJoCo
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.errors import OptionError, StructureError
from tensegrity_mj.learning.dm_control.readings import pushed_nodes
from tensegrity_mj.learning.dm_control.repairing import repair
from tensegrity_mj.model.scene import Scene

if TYPE_CHECKING:
    from dm_control.mjcf import RootElement


def model(scene: Scene, command: Command, options: MuJoCo) -> ET.Element:
    """The MJCF of a scene for the given command, forces on nodes included; actuators of strings come first.

    Raises:
        StructureError: where rods share nodes.
        SceneError: where supports move, or something adds mass to rods, as water does.
    """
    require(None, scene, "dm_control models")
    root = ET.fromstring(mjcf.scene_to_mjcf(scene, options.timestep, options.word))
    if command is Command.FORCE_DENSITY:
        for actuator, string in zip(root.iterfind("actuator/general"), scene.structure.strings, strict=True):
            actuator.set("gaintype", "affine")
            actuator.set("gainprm", "0 -1 0")
            actuator.set("biasprm", f"0 0 {-string.damping!r}")
    nodes = pushed_nodes(scene)
    if nodes:
        world = root.find("worldbody")
        assert world is not None
        (axes,) = mjcf_tree.distinct(["load axes"], set(scene.structure.node_names))
        ET.SubElement(world, "site", name=axes, pos="0 0 0", size="1e-6", rgba="0 0 0 0")
        actuators = root.find("actuator")
        if actuators is None:
            actuators = ET.SubElement(root, "actuator")
        gears = {"x": "1 0 0 0 0 0", "y": "0 1 0 0 0 0", "z": "0 0 1 0 0 0"}
        pushes = [(node, letter) for node in nodes for letter in gears]
        taken = {string.name for string in scene.structure.strings}
        names = mjcf_tree.distinct((f"load on {node} {letter}" for node, letter in pushes), taken)
        for name, (node, letter) in zip(names, pushes, strict=True):
            ET.SubElement(actuators, "general", name=name, site=node, refsite=axes, gear=gears[letter])
    return root


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
