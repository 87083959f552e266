"""Reads a [scene]."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.elements.resistance import Bending, Drag, Resistance
from tensegrity_mj.model.elements.water import Water, Weights
from tensegrity_mj.model.elements.waves import AboveLevel, Wave
from tensegrity_mj.model.events import Break, ControlSpec, Load
from tensegrity_mj.model.motion import Harmonic, Motion
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.model.text.keys import (
    BENDING_KEYS,
    BREAK_KEYS,
    CONTACT_KEYS,
    CONTROL_KEYS,
    CURVE_KEYS,
    DRAG_KEYS,
    HARMONIC_KEYS,
    LOAD_KEYS,
    MOST_POSITIONS,
    MOTION_DATA,
    MOTION_KEYS,
    RESISTANCE_KEYS,
    SCENE_KEYS,
    SHAPE_KEYS,
    TARGET_KEYS,
    WATER_KEYS,
    WAVE_KEYS,
    WAYPOINT_KEYS,
)
from tensegrity_mj.model.text.table import Table, is_list, is_row

Chosen = TypeVar("Chosen", bound=enum.Enum)


def scene_of(top: Table, structure: Structure) -> Scene:
    """The scene of a file, with the structure that it names."""
    table = top.table("scene", SCENE_KEYS) or Table({}, top.where, "scene", SCENE_KEYS)
    nodes, velocities = table.table("initial_nodes", None), table.table("initial_velocities", None)
    still = np.zeros_like(structure.positions)
    return Scene(
        structure=structure,
        name=top.text("name"),
        source=top.text("source", ""),
        gravity=table.vector("gravity", Scene.gravity),
        initial_nodes=None if nodes is None else nodes.node_rows(structure, structure.positions),
        initial_velocities=None if velocities is None else velocities.node_rows(structure, still),
        loads=tuple(_load(item) for item in table.tables("loads", LOAD_KEYS, title="node")),
        breaks=tuple(
            Break(item.text("string"), item.number("time"))
            for item in table.tables("breaks", BREAK_KEYS, title="string")
        ),
        motions=tuple(_motion(item) for item in table.tables("motions", MOTION_KEYS, title="support")),
        target=_target(table, structure),
        control=_control(table),
        duration=table.number("duration", Scene.duration),
        contact=_contact(table),
        resistance=_resistance(table),
        water=_water(table),
    )


def _load(table: Table) -> Load:
    frequency, phase = table.number("angular_frequency", 0.0), table.number("phase", 0.0)
    return Load(table.text("node"), table.vector("force"), frequency, phase)


def _motion(table: Table) -> Motion:
    harmonics = tuple(
        Harmonic(item.vector("amplitude"), item.number("angular_frequency", 0.0), item.number("phase", 0.0))
        for item in table.tables("harmonics", HARMONIC_KEYS)
    )
    rows = "rows of three numbers, one a time"
    columns = [table.get(key, rows, lambda x: is_list(x, is_row), ()) for key in MOTION_DATA[1:]]
    return Motion(table.text("support"), harmonics, table.numbers("times", "a list of numbers", None, ()), *columns)


def _contact(scene: Table) -> Contact | None:
    table = scene.table("contact", CONTACT_KEYS)
    if table is None:
        return None
    return Contact(
        table.number("floor", None),
        table.vector("normal", Contact.normal),
        table.get("rods", "true or false", lambda x: isinstance(x, bool), Contact.rods),
        table.number("friction", Contact.friction),
        table.number("stiffness", Contact.stiffness),
        table.number("damping", Contact.damping),
        table.numbers("impedance", "five numbers [d0, d1, width, midpoint, power]", 5, Contact.impedance),
    )


def _resistance(scene: Table) -> Resistance | None:
    table = scene.table("resistance", RESISTANCE_KEYS)
    if table is None:
        return None
    bending, drag = table.table("bending", BENDING_KEYS), table.table("drag", DRAG_KEYS)
    return Resistance(
        table.number("viscous", Resistance.viscous),
        None if bending is None else _bending(bending),
        None
        if drag is None
        else Drag(
            drag.number("normal", Drag.normal),
            drag.number("tangential", Drag.tangential),
            drag.number("density", Drag.density),
            drag.number("diameter", None),
        ),
        table.vector("wind", Resistance.wind),
    )


def _water(scene: Table) -> Water | None:
    table = scene.table("water", WATER_KEYS)
    if table is None:
        return None
    waves = tuple(
        Wave(
            item.number("amplitude"),
            item.number("wavelength", None),
            item.number("angular_frequency", None),
            item.number("direction", Wave.direction),
            item.number("phase", Wave.phase),
        )
        for item in table.tables("waves", WAVE_KEYS)
    )
    return Water(
        density=table.number("density", Water.density),
        depth=table.number("depth", None),
        waves=waves,
        current=table.vector("current", Water.current),
        drag=table.number("drag", Water.drag),
        tangential_drag=table.number("tangential_drag", Water.tangential_drag),
        added_mass=table.number("added_mass", Water.added_mass),
        inertia=table.number("inertia", None),
        segments=table.get("segments", "an integer", lambda x: type(x) is int, Water.segments),
        weights=_choice(table, "weights", Weights, Water.weights),
        diameter=table.number("diameter", None),
        above=_choice(table, "above", AboveLevel, Water.above),
        viscosity=table.number("viscosity", Water.viscosity),
    )


def _choice(table: Table, key: str, kind: type[Chosen], default: Chosen) -> Chosen:
    return kind(table.choice(key, [member.value for member in kind], default.value))


def _bending(table: Table) -> Bending:
    def is_pair(value: Any) -> bool:
        return is_list(value, lambda name: isinstance(name, str)) and len(value) == 2

    need = 'a list of pairs of rods, as [["rod1", "rod2"]]'
    pairs = table.get("pairs", need, lambda x: is_list(x, is_pair), None)
    return Bending(
        table.number("stiffness", Bending.stiffness),
        table.number("damping", Bending.damping),
        None if pairs is None else tuple((a, b) for a, b in pairs),
    )


def _target(scene: Table, structure: Structure) -> Target | None:
    table = scene.table("target", TARGET_KEYS)
    if table is None:
        return None
    nodes = table.table("nodes", None)
    if sum(key in table.data for key in ("nodes", "waypoints", "shapes")) != 1:
        raise FormatError(
            f"{table.where}: it must hold one of 'nodes' (a set-point), 'waypoints' (a path) or 'shapes' (a curve)"
        )
    if "shapes" in table.data:
        return _curve(table, structure)
    table.allow(TARGET_KEYS[:2])
    if nodes is not None:
        return Target.set_point(nodes.node_rows(structure, structure.positions))
    times, rows = _node_tables(table, "waypoints", "time", WAYPOINT_KEYS, structure)
    return Target.path(times, rows)


def _curve(table: Table, structure: Structure) -> Target:
    table.allow(CURVE_KEYS)
    parameters, shapes = _node_tables(table, "shapes", "parameter", SHAPE_KEYS, structure)
    need = "a list of numbers, one a time"
    times = table.numbers("times", "a list of numbers")
    values, rates, accelerations = (
        table.numbers(key, need, len(times), default)
        for key, default in (("values", ...), ("rates", None), ("accelerations", None))
    )
    return Target.curve(times, values, parameters, shapes, rates, accelerations)


def _node_tables(
    table: Table, key: str, title: str, keys: Sequence[str], structure: Structure
) -> tuple[list[float], list[Array]]:
    """The numbers called `title` and the node positions of an array of tables."""
    numbers, positions = [], []
    items = table.tables(key, keys)
    if len(items) * len(structure.nodes) > MOST_POSITIONS:
        raise FormatError(
            f"{table.where}: {key} has {len(items)} tables for {len(structure.nodes)} nodes each; at most "
            f"{MOST_POSITIONS} positions are read: give fewer"
        )
    for item in items:
        rows = item.table("nodes", None) or Table({}, item.file, item.path, None)
        numbers.append(item.number(title))
        positions.append(rows.node_rows(structure, structure.positions))
    if not numbers:
        raise table.fail(key, "an array of at least one table")
    return numbers, positions


def _control(scene: Table) -> ControlSpec | None:
    table = scene.table("control", CONTROL_KEYS)
    if table is None:
        return None
    options = table.table("options", None)
    for key, value in options.data.items() if options is not None else ():
        if not _is_option(value):
            assert options is not None
            raise options.fail(key, "a number, a text, true or false, or a list of them")
    return ControlSpec(table.text("law"), {} if options is None else options.data)


def _is_option(value: Any) -> bool:
    return isinstance(value, (bool, int, float, str)) or is_list(value, _is_option)
