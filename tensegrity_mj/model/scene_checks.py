"""Checks of a scene: each part of it must fit the structure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, norm
from tensegrity_mj.basics.kinds import LARGEST
from tensegrity_mj.basics.remembered import Remembered
from tensegrity_mj.basics.texts import closest
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.elements import contact, element, resistance, water
from tensegrity_mj.model.members import unit_rows
from tensegrity_mj.model.moved_supports import check_motions
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import CONSTRAINT_TOLERANCE, names_of, size_of, unknown_node
from tensegrity_mj.model.target import Target

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene


def check_scene(scene: Scene) -> None:
    """Raise SceneError if the scene does not fit its structure."""
    structure = scene.structure
    for what in ("initial_nodes", "initial_velocities"):
        value = getattr(scene, what)
        if value is not None:
            check_node_array(structure, what, value)
    check_motions(scene)
    start = {motion.support: motion.at(float(scene.start_time)) for motion in scene.motions}
    given = scene.nodes0 is not structure.positions  # which fit the structure that they are of
    if given:
        check_configuration(structure, scene.nodes0, "initial_nodes", {name: d[0] for name, d in start.items()})
    rates = {name: d[1] for name, d in start.items()}
    check_velocities(structure, scene.nodes0, scene.velocities0, rates, "initial_velocities")
    if given:
        _check_no_vanishing_string(scene)
    _check_loads(scene)
    _check_breaks(scene)
    if scene.contact is not None:
        contact.check_contact(scene)
    if scene.resistance is not None:
        resistance.check_resistance(structure, scene.resistance)
    if scene.water is not None:
        water.check_water(scene)
    element.check_elements(scene)
    if scene.target is not None:
        check_target(structure.massless, scene.target)


def _check_loads(scene: Scene) -> None:
    structure = scene.structure
    if not callable(scene.loads):
        for number, load in enumerate(scene.loads):
            if load.node not in structure.node_index:
                raise SceneError(f"loads[{number}]: {unknown_node(load.node, structure.nodes)}")
        return
    at, shape = float(scene.start_time), structure.positions.shape
    try:
        forces = np.asarray(scene.loads(at), float)
    except Exception as error:
        raise SceneError(f"loads: the function failed at t = {at:g}: {type(error).__name__}: {error}") from error
    if forces.shape != shape or not np.all(np.isfinite(forces)):
        raise SceneError(
            f"loads: the function gave shape {forces.shape} at t = {at:g}; it must give finite {shape} [N]"
        )


def _check_breaks(scene: Scene) -> None:
    known = {string.name for string in scene.structure.strings}
    broken: set[str] = set()
    for number, event in enumerate(scene.breaks):
        if event.string not in known:
            names = [string.name for string in scene.structure.strings]
            meant = closest(str(event.string), names)
            raise SceneError(
                f"breaks[{number}]: unknown string '{event.string}'{meant}; the strings are {names_of(names)}"
            )
        if event.string in broken:
            raise SceneError(f"breaks[{number}]: string '{event.string}' breaks twice; give one time for each string")
        broken.add(event.string)


def check_node_array(structure: Structure, what: str, value: Array) -> None:
    count = len(structure.nodes)
    if value.shape != (count, 3):
        raise SceneError(
            f"{what}: shape {value.shape}; it must be ({count}, 3), a row for each of {names_of(structure.nodes)}"
        )
    fits = np.abs(value) <= LARGEST  # NaN does not
    if not np.all(fits):
        row = int(np.argwhere(~fits)[0][0])
        raise SceneError(
            f"{what}: node '{structure.node_names[row]}' has {value[row].tolist()}; it must be finite, and at most "
            f"{LARGEST:g}"
        )


def _deviations(
    structure: Structure, values: Array, base: Array, moved: Mapping[str, Array]
) -> Iterator[tuple[str, Any, float]]:
    """Deviations of rods and point masses from each of their supports and planes.

    Args:
        values, base: (N, 3) of the nodes, and what supports hold them at: positions, or velocities.
        moved: how far each moved support is from there.
    """
    away, still = values - base, np.zeros(3)
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes.tolist(), strict=True):
        support, sigma = rod.support, rod.support.sigma
        if support.directions or support.plane is not None:
            off = (1 - sigma) * away[i] + sigma * away[j] - moved.get(rod.name, still)
            yield "support", rod, float(np.abs(unit_rows(support.constraint_rows) @ off).max())
        if support.plane is not None:
            yield "plane", rod, abs(float(unit_rows(np.array([support.plane]))[0] @ (values[j] - values[i])))
    for point in structure.point_masses:
        if point.plane is not None:
            row = structure.node_index[point.node]
            yield "mass", point, abs(float(unit_rows(np.array([point.plane]))[0] @ away[row]))
    found = structure.constraint_rows @ away.ravel()
    for one, off in zip(structure.constraints, found.tolist(), strict=True):
        yield "constraint", one, abs(off - float(one.unit @ moved.get(one.name, still)))


def check_configuration(
    structure: Structure, nodes: Array, where: str, moved: Mapping[str, Array] | None = None
) -> None:
    """Raise SceneError unless node positions keep rod lengths, supports, planes and fixed nodes.

    Supports in `moved` (rod or fixed node -> displacement (3,) [m]) are that far from where the structure has them.
    """
    limit, moved = CONSTRAINT_TOLERANCE * size_of(structure), moved or {}
    for name in structure.fixed_nodes:
        row = structure.node_index[name]
        gap = float(np.linalg.norm(nodes[row] - structure.positions[row] - moved.get(name, np.zeros(3))))
        if gap > limit:
            raise SceneError(f"{where}: fixed node '{name}' is {gap:.3g} m from its place; it must stay there")
    lengths = np.linalg.norm(nodes[structure.rod_nodes[:, 1]] - nodes[structure.rod_nodes[:, 0]], axis=1)
    for row in np.flatnonzero((np.abs(lengths - structure.rod_lengths) > limit) & ~structure.elastic)[:1]:
        raise SceneError(
            f"{where}: rod '{structure.rods[row].name}' would be {lengths[row]:.12g} m long; its length is "
            f"{structure.rod_lengths[row]:.12g} m"
        )
    for body, frame in zip(structure.bodies, structure.frames, strict=True):
        off = frame.out_of_shape(nodes)
        off = max(off, float(np.abs((nodes - structure.positions)[frame.rows]).max())) if body.held else off
        if off > limit:
            how = "is held, and must stay at its place" if body.held else "is rigid: all its nodes move as one"
            raise SceneError(f"{where}: a node of body '{body.name}' is {off:.3g} m off; it {how}")
    for what, member, off in _deviations(structure, nodes, structure.positions, moved):
        if off <= limit:
            continue
        if what == "mass":
            raise SceneError(f"{where}: the point mass on node '{member.node}' is {off:.3g} m out of its plane")
        if what == "plane":
            raise SceneError(
                f"{where}: rod '{member.name}' leaves its plane by {off:.3g} m; its direction must be orthogonal to "
                f"the normal {member.support.plane}"
            )
        if what == "constraint":
            raise SceneError(
                f"{where}: constraint '{member.name}' is off by {off:.3g} m; its nodes must give what the reference "
                "nodes do" + (f", moved by {moved[member.name].tolist()} m" if member.name in moved else "")
            )
        raise SceneError(
            f"{where}: rod '{member.name}' breaks its support by {off:.3g} m at σ = {member.support.sigma}: the point "
            "must keep D r = r̄ of the reference nodes"
            + (f", moved by {moved[member.name].tolist()} m" if member.name in moved else "")
        )


def check_velocities(
    structure: Structure, nodes: Array, velocities: Array, moved: Mapping[str, Array], where: str
) -> None:
    """Raise SceneError unless velocities keep all constraints; `moved` are the velocities (3,) of moved supports."""
    limit = CONSTRAINT_TOLERANCE * max(float(np.abs(array).max(initial=0.0)) for array in (velocities, *moved.values()))
    if limit == 0.0:
        return
    for name in structure.fixed_nodes:
        v = velocities[structure.node_index[name]]
        if np.any(v != 0) if name not in moved else np.any(np.abs(v - moved[name]) > limit):
            need = f"its motion starts with {moved[name].tolist()} m/s" if name in moved else "it must be at rest"
            raise SceneError(f"{where}: fixed node '{name}' has {v.tolist()} m/s; {need}")
    first, second = structure.rod_nodes.T
    b = nodes[second] - nodes[first]
    stretch = np.sum(b * (velocities[second] - velocities[first]), axis=1) / np.linalg.norm(b, axis=1)
    for row in np.flatnonzero((np.abs(stretch) > limit) & ~structure.elastic)[:1]:
        raise SceneError(
            f"{where}: rod '{structure.rods[row].name}' would lengthen at {stretch[row]:.3g} m/s; the velocities of "
            "its nodes must be equal along it"
        )
    for body, frame in zip(structure.bodies, structure.frames, strict=True):
        off = np.abs(velocities[frame.rows]).max() if body.held else frame.strain_rate(nodes, velocities)
        if off > limit:
            how = "held, and at rest" if body.held else "rigid: give its nodes v + ω × x, as `moving` does"
            raise SceneError(f"{where}: a node of body '{body.name}' is {off:.3g} m/s off; it is {how}")
    for what, member, off in _deviations(structure, velocities, np.zeros_like(velocities), moved):
        if off <= limit:
            continue
        if what == "mass":
            raise SceneError(f"{where}: the point mass on '{member.node}' leaves its plane at {off:.3g} m/s")
        if what == "plane":
            raise SceneError(f"{where}: rod '{member.name}' would turn out of its plane at {off:.3g} m/s")
        start = moved.get(member.name)
        if what == "constraint":
            need = "they must keep it" if start is None else f"its motion starts with {start.tolist()} m/s"
            raise SceneError(f"{where}: nodes would leave constraint '{member.name}' at {off:.3g} m/s; {need}")
        need = "D ṙ must be zero" if start is None else f"its motion starts with {start.tolist()} m/s"
        at = f"at {off:.3g} m/s at σ = {member.support.sigma}"
        raise SceneError(f"{where}: rod '{member.name}' would leave its support {at}; {need}")


def _check_no_vanishing_string(scene: Scene) -> None:
    structure, paths = scene.structure, scene.structure.paths
    lengths = norm(paths.spans(scene.nodes0))
    for row in np.flatnonzero(lengths <= 1e-12 * size_of(structure))[:1]:
        one, other = (structure.node_names[k] for k in paths.nodes[row])
        raise SceneError(
            f"initial_nodes: string '{structure.strings[paths.strings[row]].name}' has length {lengths[row]:.3g} m "
            f"between '{one}' and '{other}'; it must be longer"
        )


# Between the shapes of a curve a polynomial may stretch rods by this part of the structure's size; targets of rods are
# normalised, so that it is the error of where they are that this bounds.
CURVE_TOLERANCE = 1e-6
_fitting = Remembered()  # targets that were found to fit, by structure


def check_target(structure: Structure, target: Target) -> None:
    """Raise SceneError unless every waypoint is a configuration of the structure and times increase."""
    # What is kept is the target, so that no other one has its id.
    _fitting.get(structure, id(target), lambda: _check_target(structure, target))


def _check_target(structure: Structure, target: Target) -> Target:
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
        return target
    for number, nodes in enumerate(target.nodes):
        where = "target" if len(times) == 1 else f"target waypoint {number} (t = {times[number]} s)"
        check_node_array(structure, where, nodes)
        check_configuration(structure, nodes, where)
    return target


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
    stretch = np.where(structure.elastic, 0.0, np.abs(lengths - structure.rod_lengths))
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
