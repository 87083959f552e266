"""The MJCF of a scene as dm_control needs it, and a Physics of it.

It adds two things to `mjcf.scene_to_mjcf`, since dm_control has no place for a control callback:

- Where actions are force densities, an actuator's gain is minus its string's length, so that its control is u itself:
  the rest length L0 = L (1 - u/k) is renewed at every stage of the integrator, without a callback.
- Forces on nodes (loads, wind, drag, elements) are three more actuators a node. They push along the scene's axes,
  however the rod has turned by then.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

from tensegrity_mj.basics.checks import member
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco import mjcf, mjcf_tree, settings
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.learning.dm_control.readings import pushed_nodes
from tensegrity_mj.model.scene import Scene

if TYPE_CHECKING:
    from tensegrity_mj.learning.dm_control.stepping import ScenePhysics


def physics(
    scene: Scene,
    timestep: float = 1e-3,
    integrator: settings.Integrator = settings.Integrator.RK4,
    command: Command = Command.REST_LENGTH,
) -> ScenePhysics:
    """A dm_control `Physics` of a scene, at the scene's start.

        physics = tensegrity_mj.learning.dm_control.physics(scene, timestep=5e-3)
        physics.set_control(rest_lengths - scene.structure.rest_lengths)     # [m]
        physics.step()

    It steps as the MuJoCo engine does with rest lengths (or force densities) held from step to step. Controls are
    changes of the strings' rest lengths [m] from the designed ones, or force densities [N/m] with
    `Command.FORCE_DENSITY`; `set_command` takes the rest lengths themselves. `reset()` goes back to the scene's start.

    Raises:
        OptionError: for a time step, an integrator or a command that is none.
        StructureError: for rods that share nodes, and for masses or sizes that MuJoCo cannot hold.
        SceneError: for supports that move, and for water that adds mass to rods.
    """
    options = settings.MuJoCo(timestep, integrator)
    member("command", command, Command)
    options.model(scene)  # for its errors: dm_control's would not say what to do
    from tensegrity_mj.learning.dm_control.repairing import repair

    repair()
    from tensegrity_mj.learning.dm_control.stepping import ScenePhysics

    return ScenePhysics.of_scene(scene, command, ET.tostring(model(scene, command, options), encoding="unicode"))


def model(scene: Scene, command: Command, options: settings.MuJoCo) -> ET.Element:
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
