"""Reads a [scene]."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import item_of
from tensegrity_mj.errors import FormatError
from tensegrity_mj.model.composition import rotation_matrix
from tensegrity_mj.model.ground import Ground
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.model.text.codec import built, read, read_key
from tensegrity_mj.model.text.keys import (
    CURVE_KEYS,
    GROUND_KEYS,
    MOST_POSITIONS,
    SCENE_KEYS,
    SHAPE_KEYS,
    TARGET_KEYS,
    WAYPOINT_KEYS,
)
from tensegrity_mj.model.text.records import load_ground
from tensegrity_mj.model.text.table import Table
from tensegrity_mj.model.whole import Whole


def scene_of(top: Table, structure: Structure, folder: Path | None = None) -> Scene:
    """The scene of a file, with the structure that it names, which stands and starts as `whole` says.

    Its records are in files relative to a folder.
    """
    table = top.inside("scene", SCENE_KEYS) if "scene" in top.data else Table({}, top.where, "scene", SCENE_KEYS)
    whole = read(Whole, table.inside("whole")) if "whole" in table.data else None
    placed = structure if whole is None else structure.moved(whole.rotation, whole.translation)
    keys, given = item_of(Scene).keys, {}
    for key in SCENE_KEYS:
        if key in table.data and key in keys:
            by_node = BY_NODE.get(key)
            # What belongs to the world, such as a target, knows the structure where it stands.
            known = structure if key in ("initial_nodes", "initial_velocities") else placed.massless
            given[key] = by_node(table, known) if by_node else read_key(keys[key], table, key)
    if whole is not None:
        turn = rotation_matrix(whole.rotation).T
        shifts = {"initial_nodes": np.array(whole.translation), "initial_velocities": np.zeros(3)}
        given |= {key: given[key] @ turn + shift for key, shift in shifts.items() if key in given}
    scene = Scene(structure=placed, name=top.text("name"), source=top.text("source", ""), **given)
    if "ground" in table.data:
        scene = _shaken(table.inside("ground", GROUND_KEYS), folder, scene)
    return scene if whole is None else whole.start(scene)


def _shaken(table: Table, folder: Path | None, scene: Scene) -> Scene:
    keys, name = item_of(Ground).keys, table.text("file")
    if folder is None:
        raise table.fail("file", "in a file: a text on its own has no folder that a path could be relative to")
    given = {key: read_key(keys[key], table, key) for key in GROUND_KEYS[1:] if key in table.data}
    return built(table, Ground, lambda: load_ground(folder / name, **given).shake(scene))


def _initial_nodes(scene: Table, structure: Structure) -> Array:
    return scene.inside("initial_nodes").node_rows(structure, structure.positions)


def _initial_velocities(scene: Table, structure: Structure) -> Array:
    return scene.inside("initial_velocities").node_rows(structure, np.zeros_like(structure.positions))


def _target(scene: Table, structure: Structure) -> Target:
    table = scene.inside("target", TARGET_KEYS)
    if sum(key in table.data for key in ("nodes", "waypoints", "shapes")) != 1:
        raise FormatError(
            f"{table.where}: it must hold one of 'nodes' (a set-point), 'waypoints' (a path) or 'shapes' (a curve)"
        )
    if "shapes" in table.data:
        return _curve(table, structure)
    table.allow(TARGET_KEYS[:2])
    if "nodes" in table.data:
        return Target.set_point(table.inside("nodes").node_rows(structure, structure.positions))
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
        rows = item.inside("nodes") if "nodes" in item.data else Table({}, item.file, item.path, None)
        numbers.append(item.number(title))
        positions.append(rows.node_rows(structure, structure.positions))
    if not numbers:
        raise table.fail(key, "an array of at least one table")
    return numbers, positions


# What names nodes of the structure.
BY_NODE: dict[str, Callable[[Table, Structure], Any]] = {
    "initial_nodes": _initial_nodes,
    "initial_velocities": _initial_velocities,
    "target": _target,
}
