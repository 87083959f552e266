"""A scene as a dm_control `Physics`, for what is built on dm_control: environments, its viewer, PyMJCF.

    physics = tensegrity_mj.dm_control.physics(scene, timestep=5e-3)
    physics.set_control(rest_lengths - scene.structure.rest_lengths)     # [m]
    physics.step()

It steps as the MuJoCo engine does with rest lengths held from step to step. Two things belong to the engine alone:
external loads, and that a slack string is not damped.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from tensegrity_mj.engines.mujoco import Integrator, MuJoCo
from tensegrity_mj.mjcf import scene_to_mjcf
from tensegrity_mj.scene import Scene

if TYPE_CHECKING:
    from dm_control.mujoco import Physics


def physics(scene: Scene, timestep: float = 1e-3, integrator: Integrator = Integrator.RK4) -> Physics:
    """A dm_control `Physics` of a scene, at the scene's start.

    Controls are changes of the strings' rest lengths [m] from the designed ones. `physics.reset(keyframe_id=0)` goes
    back to the start of a scene that starts in motion; a plain `physics.reset()` starts at rest.

    Raises:
        OptionError: for a time step or an integrator that is none.
        StructureError: for masses or sizes that MuJoCo cannot hold.
    """
    options = MuJoCo(timestep, integrator)
    options.model(scene)  # for its errors: dm_control's would not say what to do
    repair()
    from dm_control.mujoco import Physics

    result = Physics.from_xml_string(scene_to_mjcf(scene, timestep, options.word))
    if result.model.nkey:
        result.reset(keyframe_id=0)
    # A reset leaves what the first step starts from without the strings; DISCRETE would take them for absent.
    result.forward()
    return result


def repair() -> list[str]:
    """Make dm_control work beside a newer MuJoCo that dropped fields; returns the names, none where nothing is amiss.

    dm_control (1.0.50) carries a table of MuJoCo's array fields, made for MuJoCo 3.17, and reads every one of them when
    it builds a Physics. MuJoCo 4.0 has no longer all of them; names that are not there are struck from the table.
    """
    import mujoco

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dm_control looks for a display when imported
        from dm_control.mujoco.wrapper.mjbindings import sizes

    gone = []
    for table, kind in (("mjmodel", mujoco.MjModel), ("mjdata", mujoco.MjData)):
        fields = sizes.array_sizes[table]
        for name in [name for name in fields if not hasattr(kind, name)]:
            del fields[name]
            gone.append(name)
    return gone
