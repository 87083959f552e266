"""A study's state as a scene by itself, for engines and for files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.events import Load
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.statics.model import StaticModel, weights_and_loads
from tensegrity_mj.statics.state import StaticState


def standalone_scene(state: StaticState) -> Scene:
    """The scene that starts in this state at rest: further loads are loads of it, and broken strings are left out.

    Loads that are no Python function are as they are at t = 0, and so is the scene in balance there. Holds are of the
    study: where there are any, the scene lets go of them.

    Raises:
        StructureError, SceneError: where what is left makes no valid scene.
    """
    scene, model = state.scene(), state.model
    whole = model.whole
    if not whole.all():
        strings = scene.structure.strings
        gone = {string.name for string, there in zip(strings, whole, strict=True) if not there}
        kept = tuple(string for string in strings if string.name not in gone)
        scene = scene.with_(
            structure=replace(scene.structure, strings=kept),
            breaks=tuple(event for event in scene.breaks if event.string not in gone),
        )
    # Besides weights and the scene's own loads: the state of a path that began under loads has some.
    further = state.parameter * model.loads + (model.forces - weights_and_loads(state.model.scene, model.start))
    return _loaded(scene, further) if np.any(further) else scene


def require_rigid_and_free(model: StaticModel) -> None:
    """Refuse what engines do not have.

    Raises:
        OptionError: for elastic rods, and holds.
    """
    if np.any((model.compliance > 0) & ~model.structure.elastic):
        raise OptionError(
            "engine: rods without a stiffness are rigid there, and the study's are elastic: use with_elastic_rods() of "
            "the structure, or leave one of the two out"
        )
    if model.holds:
        raise OptionError("engine: it has no holds; give the structure a support there, or leave the engine out")


def _loaded(scene: Scene, further: Array) -> Scene:
    if callable(scene.loads):
        own: Callable[[float], object] = scene.loads
        return scene.with_(loads=lambda time: np.asarray(own(time), float) + further)
    names = scene.structure.node_names
    added = tuple(
        Load(name, (float(f[0]), float(f[1]), float(f[2]))) for name, f in zip(names, further, strict=True) if np.any(f)
    )
    return scene.with_(loads=(*scene.loads, *added))
