"""What makes a scene valid: that each part of it fits the structure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tensegrity_mj.errors import SceneError
from tensegrity_mj.moved_supports import check_motions
from tensegrity_mj.scene import Break, ControlSpec, Load, Scene, Target
from tensegrity_mj.structure import Structure
from tensegrity_mj.validation.configurations import (
    check_configuration,
    check_initial_velocities,
    check_no_vanishing_string,
    check_node_array,
)
from tensegrity_mj.validation.contacts import check_contact
from tensegrity_mj.validation.members import names_of, unknown_node
from tensegrity_mj.validation.resistances import check_resistance
from tensegrity_mj.validation.targets import check_target
from tensegrity_mj.validation.values import check_number, check_text, check_vector
from tensegrity_mj.validation.waters import check_water


def check_scene(scene: Scene) -> None:
    """Raise SceneError if the scene does not fit its structure."""
    structure = scene.structure
    if not isinstance(structure, Structure):
        raise SceneError(f"structure = {structure!r}; it must be a Structure")
    count = len(structure.nodes)
    check_text("name of the scene", scene.name, SceneError)
    check_text("source", scene.source, SceneError)
    check_vector("gravity", scene.gravity, SceneError, "m/s²")
    check_number("duration", scene.duration, "> 0 s", lambda x: x > 0, SceneError)
    for what in ("initial_nodes", "initial_velocities"):
        value = getattr(scene, what)
        if value is not None:
            check_node_array(structure, what, value)
    check_motions(scene)
    start = {motion.support: motion.at(0.0) for motion in scene.motions}
    check_configuration(structure, scene.nodes0, "initial_nodes", {name: d[0] for name, d in start.items()})
    check_initial_velocities(scene, {name: d[1] for name, d in start.items()})
    check_no_vanishing_string(scene)

    if not callable(scene.loads):
        for number, load in enumerate(scene.loads):
            if not isinstance(load, Load):
                raise SceneError(f"loads[{number}] = {load!r}: it must be a Load, or loads a function of time")
            if not isinstance(load.node, str) or load.node not in structure.node_index:
                raise SceneError(f"loads[{number}]: {unknown_node(load.node, structure)}")
            check_vector(f"loads[{number}] on node '{load.node}': force", load.force, SceneError, "N")
            for what in ("angular_frequency", "phase"):
                check_number(f"loads[{number}].{what}", getattr(load, what), "finite", lambda x: True, SceneError)
    else:
        try:
            forces = np.asarray(scene.loads(0.0), float)
        except Exception as error:
            raise SceneError(f"loads: the function failed at t = 0: {type(error).__name__}: {error}") from error
        if forces.shape != (count, 3) or not np.all(np.isfinite(forces)):
            raise SceneError(
                f"loads: the function gave shape {forces.shape} at t = 0; it must give finite ({count}, 3) [N]"
            )

    _check_breaks(scene)
    if scene.contact is not None:
        check_contact(scene)
    if scene.resistance is not None:
        check_resistance(scene.structure, scene.resistance)
    if scene.water is not None:
        check_water(scene)
    if scene.target is not None:
        if not isinstance(scene.target, Target):
            raise SceneError(f"target = {scene.target!r}: use Target.set_point(nodes), Target.path or Target.curve")
        check_target(structure, scene.target)
    if scene.control is not None:
        _check_control(scene.control)


def _check_control(control: Any) -> None:
    if not isinstance(control, ControlSpec):
        raise SceneError(f"control = {control!r}: use ControlSpec(law, options)")
    if not isinstance(control.law, str) or not control.law:
        raise SceneError(f"control: law = {control.law!r}; it must be the name of a law")
    check_text("control: law", control.law, SceneError)
    if not isinstance(control.options, Mapping):
        raise SceneError(f"control: options = {control.options!r}; they must map each option's name to its value")
    for key, value in control.options.items():
        if not isinstance(key, str) or not key:
            raise SceneError(f"control: option {key!r}: its name must be a non-empty string")
        check_text("control: name of an option", key, SceneError)
        _check_option(f"control: option '{key}'", value)


def _check_option(what: str, value: Any) -> None:
    if isinstance(value, list):
        for item in value:
            _check_option(what, item)
    elif isinstance(value, str):
        check_text(what, value, SceneError)
    elif not isinstance(value, (bool, int, float)) or value != value:
        raise SceneError(f"{what}: {value!r} is no number, text or truth value, nor a list of them")


def _check_breaks(scene: Scene) -> None:
    known = {string.name for string in scene.structure.strings}
    broken: set[str] = set()
    for number, event in enumerate(scene.breaks):
        if not isinstance(event, Break):
            raise SceneError(f"breaks[{number}] = {event!r}: it must be a Break(string, time)")
        if event.string not in known:
            names = names_of(string.name for string in scene.structure.strings)
            raise SceneError(f"breaks[{number}]: unknown string '{event.string}'; the strings are {names}")
        what = f"breaks[{number}] of string '{event.string}': time"
        check_number(what, event.time, ">= 0 s", lambda x: x >= 0, SceneError)
        if event.string in broken:
            raise SceneError(f"breaks[{number}]: string '{event.string}' breaks twice; give one time for each string")
        broken.add(event.string)
