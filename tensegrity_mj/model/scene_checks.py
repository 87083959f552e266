"""What makes a scene valid: that each part of it fits the structure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import LARGEST
from tensegrity_mj.basics.values import CONSTRAINT_TOLERANCE, check_number, check_text, check_vector, size_of, unit_rows
from tensegrity_mj.basics.values import array_of_shape as array_of_shape
from tensegrity_mj.basics.values import index_pairs as index_pairs
from tensegrity_mj.basics.values import sequence_of as sequence_of
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.elements.contact import check_contact
from tensegrity_mj.model.elements.resistance import check_resistance
from tensegrity_mj.model.elements.water import check_water
from tensegrity_mj.model.events import Break, ControlSpec, Load
from tensegrity_mj.model.moved_supports import check_motions
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import check_structure as check_structure
from tensegrity_mj.model.structure_checks import names_of, names_of_nodes, unknown_node
from tensegrity_mj.model.target import Target

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene


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


def check_node_array(structure: Structure, what: str, value: Array) -> None:
    count = len(structure.nodes)
    if value.shape != (count, 3):
        raise SceneError(
            f"{what}: shape {value.shape}; it must be ({count}, 3), a row for each of {names_of_nodes(structure)}"
        )
    fits = np.abs(value) <= LARGEST  # NaN does not
    if not np.all(fits):
        row = int(np.argwhere(~fits)[0][0])
        raise SceneError(
            f"{what}: node '{structure.node_names[row]}' has {value[row].tolist()}; it must be finite, and at most "
            f"{LARGEST:g}"
        )


def check_configuration(
    structure: Structure, nodes: Array, where: str, moved: Mapping[str, Array] | None = None
) -> None:
    """Raise SceneError unless node positions keep rod lengths, supports, planes and fixed nodes.

    Supports in `moved` (rod or fixed node -> displacement (3,) [m]) are that far from where the structure has them.
    """
    size = size_of(structure)
    moved = moved or {}
    still = np.zeros(3)
    for name in structure.fixed_nodes:
        row = structure.node_index[name]
        gap = float(np.linalg.norm(nodes[row] - structure.positions[row] - moved.get(name, still)))
        if gap > CONSTRAINT_TOLERANCE * size:
            raise SceneError(f"{where}: fixed node '{name}' is {gap:.3g} m from its place; it must stay there")
    for number, rod in enumerate(structure.rods):
        i, j = structure.rod_nodes[number]
        length = structure.rod_lengths[number]
        stretch = float(np.linalg.norm(nodes[j] - nodes[i]) - length)
        if abs(stretch) > CONSTRAINT_TOLERANCE * size:
            raise SceneError(
                f"{where}: rod '{rod.name}' would be {length + stretch:.12g} m long; its length is {length:.12g} m"
            )
        sigma = rod.support.sigma
        r = (1 - sigma) * nodes[i] + sigma * nodes[j]
        reference = (1 - sigma) * structure.positions[i] + sigma * structure.positions[j]
        rows = rod.support.constraint_rows
        shift = moved.get(rod.name, still)
        broken = np.abs(unit_rows(rows) @ (r - reference - shift)) if len(rows) else np.zeros(0)
        if np.any(broken > CONSTRAINT_TOLERANCE * size):
            raise SceneError(
                f"{where}: rod '{rod.name}' breaks its support by {broken.max():.3g} m at σ = {sigma}: "
                "the point must keep D r = r̄ of the reference nodes"
                + (f", moved by {shift.tolist()} m" if rod.name in moved else "")
            )
        if rod.support.plane is not None:
            off = abs(float(unit_rows(np.array([rod.support.plane]))[0] @ (nodes[j] - nodes[i])))
            if off > CONSTRAINT_TOLERANCE * size:
                raise SceneError(
                    f"{where}: rod '{rod.name}' leaves its plane by {off:.3g} m; its direction must be orthogonal "
                    f"to the normal {rod.support.plane}"
                )
    for point in structure.point_masses:
        if point.plane is not None:
            row = structure.node_index[point.node]
            off = abs(float(unit_rows(np.array([point.plane]))[0] @ (nodes[row] - structure.positions[row])))
            if off > CONSTRAINT_TOLERANCE * size:
                raise SceneError(f"{where}: the point mass on node '{point.node}' is {off:.3g} m out of its plane")


def check_initial_velocities(scene: Scene, moved: Mapping[str, Array]) -> None:
    """Raise SceneError unless velocities keep all constraints; `moved` are the velocities (3,) of moved supports."""
    structure, nodes, velocities = scene.structure, scene.nodes0, scene.velocities0
    speed = max(float(np.abs(array).max(initial=0.0)) for array in (velocities, *moved.values()))
    if speed == 0.0:
        return
    limit = CONSTRAINT_TOLERANCE * speed
    still = np.zeros(3)
    for name in structure.fixed_nodes:
        v = velocities[structure.node_index[name]]
        if name not in moved and np.any(v != 0):
            raise SceneError(f"initial_velocities: fixed node '{name}' has {v.tolist()} m/s; it must be at rest")
        if np.any(np.abs(v - moved.get(name, still)) > limit):
            raise SceneError(
                f"initial_velocities: fixed node '{name}' has {v.tolist()} m/s; its motion starts with "
                f"{moved[name].tolist()} m/s"
            )
    for number, rod in enumerate(structure.rods):
        i, j = structure.rod_nodes[number]
        b = (nodes[j] - nodes[i]) / np.linalg.norm(nodes[j] - nodes[i])
        stretch = float(b @ (velocities[j] - velocities[i]))
        if abs(stretch) > limit:
            raise SceneError(
                f"initial_velocities: rod '{rod.name}' would lengthen at {stretch:.3g} m/s; the velocities of its "
                "nodes must be equal along it"
            )
        sigma = rod.support.sigma
        at_support = (1 - sigma) * velocities[i] + sigma * velocities[j]
        rows = rod.support.constraint_rows
        rate = moved.get(rod.name, still)
        broken = np.abs(unit_rows(rows) @ (at_support - rate)) if len(rows) else np.zeros(0)
        if np.any(broken > limit):
            raise SceneError(
                f"initial_velocities: rod '{rod.name}' would leave its support at {broken.max():.3g} m/s at σ = "
                f"{sigma}; "
                + (f"its motion starts with {rate.tolist()} m/s" if rod.name in moved else "D ṙ must be zero")
            )
        if rod.support.plane is not None:
            off = abs(float(unit_rows(np.array([rod.support.plane]))[0] @ (velocities[j] - velocities[i])))
            if off > limit:
                raise SceneError(f"initial_velocities: rod '{rod.name}' would turn out of its plane at {off:.3g} m/s")
    for point in structure.point_masses:
        if point.plane is not None:
            off = abs(float(unit_rows(np.array([point.plane]))[0] @ velocities[structure.node_index[point.node]]))
            if off > limit:
                raise SceneError(
                    f"initial_velocities: the point mass on '{point.node}' leaves its plane at {off:.3g} m/s"
                )


def check_no_vanishing_string(scene: Scene) -> None:
    lengths = scene.structure.string_lengths(scene.nodes0)
    for row in np.flatnonzero(lengths <= 1e-12 * size_of(scene.structure))[:1]:
        name = scene.structure.strings[row].name
        raise SceneError(f"initial_nodes: string '{name}' has length {lengths[row]:.3g} m; it must be longer")


# Between the shapes of a curve a polynomial may stretch rods by this part of the structure's size; targets of rods are
# normalised, so that it is the error of where they are that this bounds.
CURVE_TOLERANCE = 1e-6


def check_target(structure: Structure, target: Any) -> None:
    """Raise SceneError unless every waypoint is a configuration of the structure and times increase."""
    count = len(structure.nodes)
    if target.nodes.ndim != 3 or target.nodes.shape[1:] != (count, 3) or len(target.times) != len(target.nodes):
        raise SceneError(
            f"target: {len(target.times)} times and nodes of shape {target.nodes.shape}; "
            f"it needs nodes (W, {count}, 3), one set of them a time"
        )
    times = np.array(target.times, float)
    if len(times) == 0 or not np.all(np.abs(times) <= LARGEST) or np.any(np.diff(times) <= 0):
        raise SceneError(f"target: times {list(target.times)} must be finite, at most {LARGEST:g}, and increase")
    if target.along is not None:
        _check_curve(structure, target)
        return
    for number, nodes in enumerate(target.nodes):
        where = "target" if len(times) == 1 else f"target waypoint {number} (t = {times[number]} s)"
        check_node_array(structure, where, nodes)
        check_configuration(structure, nodes, where)


def _check_curve(structure: Structure, target: Target) -> None:
    """Raise SceneError unless the shapes are configurations and what lies between them nearly so."""
    curve = target.along
    assert curve is not None
    for number, nodes in enumerate(curve.shapes):
        where = f"target shape {number} (parameter {curve.parameters[number]})"
        check_node_array(structure, where, nodes)
        check_configuration(structure, nodes, where)
    first, last = curve.interval
    lowest, highest = curve.extremes(target.times)
    slack = 1e-12 * (last - first)
    if lowest < first - slack or highest > last + slack:
        raise SceneError(
            f"target: the parameter moves within [{lowest:.12g}, {highest:.12g}], but shapes are known in "
            f"[{first:.12g}, {last:.12g}] only: give shapes beyond, or smaller rates and accelerations"
        )
    between = np.linspace(first, last, 8 * len(curve.parameters) + 1)
    pairs = structure.rod_nodes
    nodes = curve.nodes(between)
    lengths = np.linalg.norm(nodes[:, pairs[:, 1]] - nodes[:, pairs[:, 0]], axis=-1)
    stretch = np.abs(lengths - structure.rod_lengths)
    again = float(np.abs(curve.nodes(curve.parameters) - curve.shapes).max())
    if again > CONSTRAINT_TOLERANCE * size_of(structure) or stretch.max(initial=0.0) > CURVE_TOLERANCE * size_of(
        structure
    ):
        row, rod = np.unravel_index(np.argmax(stretch), stretch.shape) if stretch.size else (0, 0)
        raise SceneError(
            f"target: the polynomial through the {len(curve.parameters)} shapes stretches rods by up to "
            f"{stretch.max(initial=0.0):.3g} m (rod '{structure.rods[rod].name}' at parameter {between[row]:.6g}) and "
            f"misses the shapes by {again:.3g} m: give more shapes, at chebyshev_points of the parameter"
        )
