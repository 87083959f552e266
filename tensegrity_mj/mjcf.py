"""The MJCF of a scene: rods as capsules with a thin rod's inertia, strings as actuated spatial tendons.

Numbers are printed with 17 digits, so the file reloads to the very model that is simulated. Nothing is in the model
that the scene does not use: joints as few as the supports leave, no sensor; contact, a floor and gravity only where
the scene has them.

An actuator's control is the change of its string's rest length from the one written here [m]: the tension is
max(0, k (L - L0 - ctrl) + c dL/dt). A control of zero, which is what a viewer or a reset gives, is the structure as
designed. Where a string has a damper that is not all of the string law (a slack string must not be damped): the
engine's callback sees to the rest.

A scene that starts in motion has a keyframe "start" with its velocities; positions are the model's own. External
loads are not in the file.
"""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.contact import Contact
from tensegrity_mj.scene import Scene
from tensegrity_mj.strings import StringLaw
from tensegrity_mj.structure import Rod

Array = NDArray[np.float64]

# The axial moment of inertia as a part of the transverse one: strings attach on the axis, so 1e-4 to 1e-6 change no
# motion, while below 1e-12 round-off spins the rod up and above 1e-2 it would no longer be a thin rod.
AXIAL_INERTIA = 1e-5
# Friction resists sliding this many times harder than a contact resists depth: what sticks hardly creeps.
FRICTION_IMPEDANCE = 100.0
SOLVER_TOLERANCE = 1e-15  # the solver then stops at round-off, after two or three more of Newton's iterations
POINT_RADIUS = 1e-6  # of the structure's size: a point mass touches the floor with a ball of this radius
FLOOR, MEMBER = 1, 2  # bits that tell what may touch
LEAST_INERTIA = 1e-14  # kg m²: ten times MuJoCo's mjMINVAL
UNLIMITED = 1e30  # "inf" does not survive every writer


def save_mjcf(scene: Scene, path: str | os.PathLike[str], timestep: float = 1e-3, integrator: str = "RK4") -> Path:
    """Write `scene_to_mjcf` to an .xml file, atomically (a crash leaves the old file or none); returns the path.

    Raises:
        OptionError: for another suffix, or a place where no file can be written.
        FormatError: where writing fails all the same.
    """
    from tensegrity_mj.files import checked, replacing

    destination = checked(path, (".xml",), "MJCF")
    text = scene_to_mjcf(scene, timestep, integrator)
    with replacing(destination) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
    return destination


def scene_to_mjcf(scene: Scene, timestep: float = 1e-3, integrator: str = "RK4") -> str:
    """MJCF text of a scene; `integrator` is MuJoCo's own word.

    Sites are named as the nodes, tendons and actuators as the strings, a rod's body and the joint that turns it as the
    rod. MuJoCo has one set of names for all bodies and one for all joints: where a name is taken there, a number is
    added. What needs a node's body finds it by the site.
    """
    structure = scene.structure
    # Scene names are free texts; XML cannot hold control characters.
    title = "".join(letter if letter.isprintable() else " " for letter in scene.name)
    root = ET.Element("mujoco", model=title)
    root.append(ET.Comment(f" {_remarks(scene)} "))
    ET.SubElement(root, "compiler", angle="radian", autolimits="false", balanceinertia="false", boundmass="0")
    option = ET.SubElement(
        root,
        "option",
        timestep=_numbers([timestep]),
        integrator=integrator,
        gravity=_numbers(scene.gravity),
    )
    # Only flags that change what is computed: a reset behind one's back must never happen.
    if scene.contact is None:
        ET.SubElement(option, "flag", contact="disable", constraint="disable", autoreset="disable")
    else:
        option.set("cone", "elliptic")  # Coulomb's, where the other one favours some directions
        option.set("impratio", _numbers([FRICTION_IMPEDANCE]))
        option.set("tolerance", _numbers([SOLVER_TOLERANCE]))
        # With the exact mass that each contact feels, its law is the one that docs/contact.md states.
        ET.SubElement(option, "flag", autoreset="disable", diagexact="enable")
    _visual(root, scene)

    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 4", dir="0 0 -1", directional="true")
    _floor(world, scene)
    thickness = 0.25 * min((rod.radius for rod in structure.rods), default=0.02 * _size(scene))
    site: dict[str, Any] = {"size": _numbers([2 * thickness]), "rgba": "0.2 0.2 0.2 1"}
    for name in structure.fixed_nodes:
        position = scene.nodes0[structure.node_index[name]]
        ET.SubElement(world, "site", name=name, pos=_numbers(position), **site)
    names = _Names(scene)
    for number in range(len(structure.rods)):
        _rod_body(world, scene, number, names, site)
    for number in range(len(structure.point_masses)):
        _point_body(world, scene, number, names, site, thickness)
    if structure.strings:
        _strings(root, scene, thickness)
    if np.any(scene.velocities0):
        keyframe = ET.SubElement(root, "keyframe")
        ET.SubElement(keyframe, "key", name="start", qvel=_numbers(initial_velocities(scene)))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def initial_velocities(scene: Scene) -> Array:
    """MuJoCo's qvel (nv,) of the scene's start, in the order of its joints: rods, then point masses.

    A free or a ball joint counts angular velocity in the body's frame; slides count the velocity of r at σ.
    """
    structure, velocities = scene.structure, scene.velocities0
    parts: list[Array] = []
    for rod, (i, j), length in zip(structure.rods, structure.rod_nodes, structure.rod_lengths, strict=True):
        b = scene.nodes0[j] - scene.nodes0[i]
        b = b / np.linalg.norm(b)
        spin = np.cross(b, (velocities[j] - velocities[i]) / length)  # ω = b × ḃ: no spin about the axis
        sigma, plane = rod.support.sigma, rod.support.plane
        E = rod.support.translation_basis
        parts.append(E.T @ ((1 - sigma) * velocities[i] + sigma * velocities[j]))
        parts.append(rotation_to(b).T @ spin if plane is None else np.array([spin @ _unit(plane)]))
    for point in structure.point_masses:
        parts.append(point.translation_basis.T @ velocities[structure.node_index[point.node]])
    return np.concatenate(parts)


class _Names:
    """Names of bodies and joints, unique among their kind: lists over the rods, and over the point masses."""

    def __init__(self, scene: Scene) -> None:
        rods, points = scene.structure.rods, scene.structure.point_masses
        members = [rod.name for rod in rods] + [point.node for point in points]
        bodies = _distinct(members, taken={"world"})
        self.rods, self.points = bodies[: len(rods)], bodies[len(rods) :]
        # A rod's own name goes to the joint that turns it, whatever the slides of the others are called.
        self.turns = [rod.name for rod in rods]
        counts = [0 if _is_free(rod) else rod.support.translation_basis.shape[1] for rod in rods]
        counts += [point.translation_basis.shape[1] for point in points]
        wanted = [f"{name} {k + 1}" for name, count in zip(members, counts, strict=True) for k in range(count)]
        given = iter(_distinct(wanted, taken=set(self.turns)))
        slides = [[next(given) for _ in range(count)] for count in counts]
        self.rod_slides, self.point_slides = slides[: len(rods)], slides[len(rods) :]


def _is_free(rod: Rod) -> bool:
    """Whether one free joint is all that the rod needs."""
    return rod.support.plane is None and rod.support.translation_basis.shape[1] == 3


def _distinct(names: Iterable[str], taken: set[str]) -> list[str]:
    """The names, those that are taken already with the first free number behind."""
    taken, result = set(taken), []
    for name in names:
        candidate, number = name, 2
        while candidate in taken:
            candidate, number = f"{name} ({number})", number + 1
        taken.add(candidate)
        result.append(candidate)
    return result


def _rod_body(world: ET.Element, scene: Scene, number: int, names: _Names, site: dict[str, Any]) -> None:
    structure = scene.structure
    rod, length = structure.rods[number], float(structure.rod_lengths[number])
    sigma, plane = rod.support.sigma, rod.support.plane  # the body's frame sits at σ: the point that r follows
    first, second = scene.nodes0[structure.rod_nodes[number]]
    rotation = rotation_to((second - first) / np.linalg.norm(second - first))
    position = (1 - sigma) * first + sigma * second
    place: dict[str, Any] = {"pos": _numbers(position), "quat": _numbers(quaternion(rotation))}
    body = ET.SubElement(world, "body", name=names.rods[number], **place)
    turn = names.turns[number]
    if _is_free(rod):
        ET.SubElement(body, "freejoint", name=turn)
    else:
        # Slides come before the turn, so that their axes stay where the support has them.
        for name, axis in zip(names.rod_slides[number], rod.support.translation_basis.T, strict=True):
            ET.SubElement(body, "joint", name=name, type="slide", axis=_numbers(rotation.T @ axis))
        if plane is None:
            ET.SubElement(body, "joint", name=turn, type="ball")
        else:
            ET.SubElement(body, "joint", name=turn, type="hinge", axis=_numbers(rotation.T @ _unit(plane)))
    transverse = rod.mass * length**2 / 12
    # Where rods touch something they may roll on it: then it is a solid cylinder's.
    axial = transverse * (AXIAL_INERTIA if scene.contact is None else 1.0)
    # MuJoCo takes none below mjMINVAL; a part of up to 1e-2 changes no motion either.
    axial = max(axial, min(1e-2 * transverse, LEAST_INERTIA))
    back, ahead = -sigma * length, (1 - sigma) * length
    ET.SubElement(
        body,
        "inertial",
        pos=_numbers([0, 0, (0.5 - sigma) * length]),
        mass=_numbers([rod.mass]),
        diaginertia=_numbers([transverse, transverse, axial]),
    )
    ET.SubElement(
        body,
        "geom",
        name=rod.name,
        type="capsule",
        fromto=_numbers([0, 0, back, 0, 0, ahead]),
        size=_numbers([rod.radius]),
        **_touching(scene, rods=True),
        rgba="0.25 0.35 0.55 1",
    )
    for name, height in zip(rod.nodes, (back, ahead), strict=True):
        ET.SubElement(body, "site", name=name, pos=_numbers([0, 0, height]), **site)


def _point_body(
    world: ET.Element, scene: Scene, number: int, names: _Names, site: dict[str, Any], thickness: float
) -> None:
    point = scene.structure.point_masses[number]
    position = scene.nodes0[scene.structure.node_index[point.node]]
    body = ET.SubElement(world, "body", name=names.points[number], pos=_numbers(position))
    for name, axis in zip(names.point_slides[number], point.translation_basis.T, strict=True):
        ET.SubElement(body, "joint", name=name, type="slide", axis=_numbers(axis))
    # The moment of inertia never counts: the body only slides.
    inertia = _numbers([point.mass * _size(scene) ** 2 * 1e-4] * 3)
    ET.SubElement(body, "inertial", pos="0 0 0", mass=_numbers([point.mass]), diaginertia=inertia)
    radius = _numbers([4 * thickness])
    ET.SubElement(body, "geom", type="sphere", size=radius, contype="0", conaffinity="0", rgba="0.4 0.4 0.45 1")
    if scene.contact is not None and scene.contact.floor is not None:
        ball = _numbers([POINT_RADIUS * _size(scene)])
        ET.SubElement(body, "geom", type="sphere", size=ball, **_touching(scene, rods=False), rgba="0 0 0 0")
    ET.SubElement(body, "site", name=point.node, pos="0 0 0", **site)


def _floor(world: ET.Element, scene: Scene) -> None:
    contact = scene.contact
    if contact is None or contact.floor is None:
        return
    # Endless: the size is for viewers, its last number a spacing of lines.
    place: dict[str, Any] = {
        "pos": _numbers(contact.floor * contact.up),
        "quat": _numbers(quaternion(rotation_to(contact.up))),
    }
    name = _distinct(["floor"], taken={rod.name for rod in scene.structure.rods})[0]
    bits: dict[str, Any] = {"contype": str(FLOOR), "conaffinity": "0"}
    look: dict[str, Any] = {"size": _numbers([0, 0, 0.1 * _size(scene)]), "rgba": "0.8 0.82 0.84 1"}
    ET.SubElement(world, "geom", name=name, type="plane", **place, **bits, **_hardness(contact), **look)


def _touching(scene: Scene, rods: bool) -> dict[str, Any]:
    """Attributes of a geom that touches the floor, if there is one, and `rods`, if they touch; nothing otherwise."""
    contact = scene.contact
    if contact is None:
        return {"contype": "0", "conaffinity": "0"}
    member = MEMBER if rods and contact.rods else 0
    bits = {"contype": str(member), "conaffinity": str(member + (FLOOR if contact.floor is not None else 0))}
    return bits | _hardness(contact)


def _hardness(contact: Contact) -> dict[str, Any]:
    """Friction, stiffness and damping, the same for all that touch: no mean of two materials is ever taken."""
    return {
        "condim": "3" if contact.friction > 0 else "1",
        "friction": _numbers([contact.friction, 0, 0]),
        "solref": _numbers([-contact.stiffness, -contact.damping]),
        "solimp": _numbers(contact.impedance),
    }


def _strings(root: ET.Element, scene: Scene, thickness: float) -> None:
    structure = scene.structure
    tendons, actuators = ET.SubElement(root, "tendon"), ET.SubElement(root, "actuator")
    clipped = structure.string_law is StringLaw.CLIPPED
    for string, rest_length in zip(structure.strings, structure.rest_lengths, strict=True):
        tendon = ET.SubElement(tendons, "spatial", name=string.name, width=_numbers([thickness]), rgba="0.8 0.2 0.15 1")
        for name in string.nodes:
            ET.SubElement(tendon, "site", site=name)
        k, c = string.stiffness, string.damping
        # Without a damper the two laws are the same, and the limit alone keeps a slack string from pushing.
        most = 0.0 if clipped or c == 0 else UNLIMITED
        ET.SubElement(
            actuators,
            "general",
            name=string.name,
            tendon=string.name,
            gainprm=_numbers([k]),
            biastype="affine",
            biasprm=_numbers([k * rest_length, -k, -c]),
            forcelimited="true",
            forcerange=_numbers([-UNLIMITED, most]),
        )


def _remarks(scene: Scene) -> str:
    remarks = [
        "SI units, z up. Generated by tensegrity_mj; do not edit: change scene.toml and export again.",
        "ctrl is the change of a string's rest length [m].",
    ]
    if np.any(scene.structure.damping > 0):
        remarks.append("By itself, without tensegrity_mj, this model lets the damper of a slack string act.")
    if np.any(scene.velocities0):
        remarks.append('The motion starts with the velocities of the keyframe "start".')
    if scene.loads:
        remarks.append("The scene's external loads are not in this file.")
    return " ".join(remarks)


def _size(scene: Scene) -> float:
    return float(np.max(np.ptp(scene.nodes0, axis=0), initial=1e-3))


def _unit(vector: Iterable[float]) -> Array:
    array: Array = np.array(tuple(vector), float)
    return array / float(np.linalg.norm(array))


def _visual(root: ET.Element, scene: Scene) -> None:
    nodes = scene.nodes0
    center = 0.5 * (nodes.min(axis=0) + nodes.max(axis=0))
    extent = max(float(np.linalg.norm(np.ptp(nodes, axis=0))), 1e-3)
    ET.SubElement(root, "statistic", center=_numbers(center), extent=_numbers([extent]))


def rotation_to(b: Array) -> Array:
    """A rotation matrix whose z axis is the unit vector b."""
    axis = int(np.argmin(np.abs(b)))
    x = np.eye(3)[axis] - b[axis] * b
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(b, x), b])


def quaternion(rotation: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation matrix, from its largest component for accuracy."""
    r = rotation
    squares = np.array(
        [
            1 + r[0, 0] + r[1, 1] + r[2, 2],
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    products = np.array(
        [
            [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], squares[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], squares[2], r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[3]],
        ]
    )
    q = products[largest] / (2 * math.sqrt(squares[largest]))
    return np.asarray(q / np.linalg.norm(q))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0
