"""Parts that families of robots share: prestress, and starts that stand, fall on a floor or are pushed over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known, finite
from tensegrity_mj.basics.fields import refused
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import scene_of
from tensegrity_mj.model.elements.contact import Contact, floor_gaps
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.rods import centre_of_mass
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

PRESTRESS = 0.1  # force density over stiffness of strings, where a robot is given neither it nor a tension
FLAT = 1e-9  # of the size of a structure: nodes that far from a plane are in it


def force_density(robot: Any, length: float) -> float:
    """u [N/m] of strings of this length [m], from the fields `prestress` or `tension` of a robot."""
    if robot.prestress is not None and robot.tension is not None:
        raise refused(robot, f"prestress = {robot.prestress!r} and tension = {robot.tension!r} N; give one of them")
    if robot.tension is not None:
        return float(robot.tension) / length
    return robot.stiffness * float(PRESTRESS if robot.prestress is None else robot.prestress)


def stood(structure: Structure, base: Sequence[str]) -> Structure:
    """The structure turned so that these three nodes are in the plane z = 0 below all others, about the origin.

    The first of them is on the x axis. Whether the others are above is for the caller to see.

    Raises:
        OptionError: unless it names three nodes.
    """
    for name in base:
        check_known("base", name, structure.node_names, "node")
    if len(set(base)) != 3:
        raise OptionError(f"base = {tuple(base)!r}; name three nodes")
    nodes = structure.positions
    corners = nodes[[structure.node_index[name] for name in base]]
    centre = corners.mean(axis=0)
    up = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    up *= np.sign(up @ (nodes.mean(axis=0) - centre)) / np.linalg.norm(up)
    x = (corners[0] - centre) / np.linalg.norm(corners[0] - centre)
    turn = np.array([x, np.cross(up, x), up])
    return structure.moved(turn).moved(translation=-turn @ centre)


def on_floor(robot: Any, structure: Structure, base: Sequence[str], source: str) -> Scene:
    """The scene of a robot above a floor at z = 0, from its fields.

    It stands on `base`, is turned by `tilt` [rad], and its lowest surface is `drop` [m] above the floor.

    Raises:
        OptionError: for a base that is none, and where other nodes are below it.
    """
    structure = stood(structure, base)
    low = float(structure.positions[:, 2].min())
    if low < -FLAT * float(np.ptp(structure.positions)):
        raise refused(robot, f"base = {tuple(base)!r}; other nodes are up to {-low:.3g} m below: name three outer ones")
    contact = Contact(floor=0.0, friction=robot.friction)
    structure = structure.moved(np.array(robot.tilt))
    lift = robot.drop - float(floor_gaps(structure, contact, structure.positions).min())
    # A hair above, so that round-off leaves no node inside the floor.
    lift += FLAT * float(np.ptp(structure.positions))
    return scene_of(robot, structure.moved(translation=(0.0, 0.0, lift)), source, contact=contact)


def polygon(count: int, radius: float, turn: float, height: float) -> Array:
    """(count, 3) [m]: a regular polygon about the z axis, its first corner at the angle `turn` [rad]."""
    angles = turn + 2 * np.pi * np.arange(count) / count
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, height)])


UPRIGHT: Vector = (0.0, 0.0, 0.0)


def pushed(scene: Scene, edge: tuple[str, str], speed: float) -> Scene:
    """The scene as after a push over an edge of its base: it turns as one body about the floor below the edge.

    Args:
        edge: names of two nodes that stand on the floor.
        speed: angular velocity [rad/s], positive outwards.

    Raises:
        OptionError: for unknown nodes, or a speed that is none.
    """
    structure, nodes = scene.structure, scene.nodes0
    for name in edge:
        check_known("pushed: edge", name, structure.node_names, "node")
    floor = 0.0 if scene.contact is None or scene.contact.floor is None else scene.contact.floor
    first, second = (nodes[structure.node_index[name]] for name in edge)
    below = np.array([first[0], first[1], floor])
    along = (second - first) / np.linalg.norm(second - first)
    outward = first - centre_of_mass(structure, nodes)
    along *= np.sign(np.cross(along, [0.0, 0.0, 1.0]) @ outward)
    turning = finite("pushed: speed", speed, " [rad/s]") * along
    return scene.moving(angular_velocity=tuple(turning.tolist()), center=tuple(below.tolist()))
