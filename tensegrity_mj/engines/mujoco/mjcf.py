"""The MJCF of a scene: rods as capsules with a thin rod's inertia, strings as actuated spatial tendons.

Numbers are printed with 17 digits, so the file reloads to the very model that is simulated. Nothing is in the model
that the scene does not use: joints as few as the supports leave, no sensor; contact, a floor, constraints and gravity
only where the scene has them. Rods that share nodes hang on each other (`mjcf_tree`); where they close loops, or are
held at more than one place, `connect` constraints hold them together.

An actuator's control is the change of its string's rest length from the one written here [m]: the tension is
max(0, k (L - L0 - ctrl) + c dL/dt). A control of zero, which is what a viewer or a reset gives, is the structure as
designed. Where a string has a damper that is not all of the string law (a slack string must not be damped): the
engine's callback sees to the rest.

A scene that starts in motion has a keyframe "start" with its velocities; positions are the model's own. External
loads and prescribed motions are not in the file: what drives a support is a slide of enormous armature, which by itself
keeps the velocity that it starts with.

Elastic rods are two bodies that slide, and tendons between them. The body of one end slides as its support lets it, and
that of the other end relative to it. Each has a sixth of the mass. The other two thirds move as the rod's middle does,
which no body can: they are the armature of three tendons, one an axis of the world, whose lengths are that middle's
coordinates. So the mass matrix is that of the two-node bar, m/6 [2 1; 1 2] for each axis. Masses that the rod carries
are three such tendons through their centre, and armature of the slides of the second end. Armature has no weight: what
each body is to weigh more, it does by `gravcomp`.
"""

from __future__ import annotations

import itertools
import os
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.engines.mujoco.mjcf_bodies import DRIVE, FLOOR, Bodies, Names, hardness, size
from tensegrity_mj.engines.mujoco.mjcf_tree import BodyTree, body_tree, distinct, must_turn, numbers
from tensegrity_mj.engines.mujoco.mjcf_tree import initial_velocities as initial_velocities
from tensegrity_mj.engines.mujoco.mjcf_tree import quaternion as quaternion
from tensegrity_mj.engines.mujoco.mjcf_versions import state_oldest
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.elements.resistance import nodal_damping
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

# Friction resists sliding this many times harder than a contact resists depth: what sticks hardly creeps.
FRICTION_IMPEDANCE = 100.0
SOLVER_TOLERANCE = 1e-15  # the solver then stops at round-off, after two or three more of Newton's iterations
UNLIMITED = 1e30  # "inf" does not survive every writer
# A `connect` constraint pulls a gap g to zero as g̈ + 2 ġ/τ + g/τ² = 0, τ being so many time steps (MuJoCo allows 2 and
# more). It leaves 1 - IMPEDANCE, the least there is, of the acceleration a₀ that the gap would have without it: the gap
# stays open by (1 - IMPEDANCE) τ² a₀ = 1.6e-3 h² a₀, of second order, with no number of a scene in it. Measured on a
# four-bar loop under gravity with RK4 (a₀ ~ 20 m/s², h = 1 ms, then 0.1 ms), for τ/h of 2, 4 and 10:
#     gap [m]           8.3e-9, 8.3e-11     3.4e-8, 3.4e-10     2.1e-7, 2.1e-9
#     velocities [m/s]  9.8e-7, 9.7e-8      2.8e-7, 1.1e-8      1.3e-6, 5.1e-9
#     energy [J]        2.1e-6, 2.1e-7      3.7e-7, 2.3e-8      1.1e-6, 1.1e-8
# Shorter, the constraint rings in the integrator's stages and energy errs by the first order; longer, the gap grows. A
# chain of six between two pins with damped strings, and a truss of 14 rods with six closures, show the same.
CONNECT_STEPS, IMPEDANCE = 4.0, 0.9999
MOST_NESTED = 490  # bodies within each other: MuJoCo reads XML of 500 levels


def save_mjcf(scene: Scene, path: str | os.PathLike[str], timestep: float = 1e-3, integrator: str = "RK4") -> Path:
    """Write `scene_to_mjcf` to an .xml file, atomically (a crash leaves the old file or none); returns the path.

    Raises:
        OptionError: for another suffix, or a place where no file can be written.
        FormatError: where writing fails all the same.
    """
    from tensegrity_mj.basics.files import checked, write_text

    destination = checked(path, (".xml",), "MJCF")
    return write_text(destination, scene_to_mjcf(scene, timestep, integrator))


def scene_to_mjcf(scene: Scene, timestep: float = 1e-3, integrator: str = "RK4") -> str:
    """MJCF text of a scene; `integrator` is MuJoCo's own word.

    Sites are named as the nodes, tendons and actuators as the strings, a rod's body and the joint that turns it as the
    rod. MuJoCo has one set of names for all bodies and one for all joints: where a name is taken there, a number is
    added. What needs a node's body finds it by the site.

    Raises:
        StructureError: where more rods hang on each other than MuJoCo reads.
    """
    structure = scene.structure
    require(None, scene, "MuJoCo's model")
    tree = body_tree(scene)
    if tree.depth > MOST_NESTED:
        raise StructureError(
            f"structure '{structure.name}': {tree.depth} rods hang on each other; MuJoCo reads at most {MOST_NESTED} "
            "bodies within each other: use the DAE, or fewer and longer rods"
        )
    # Scene names are free texts; XML cannot hold control characters.
    title = "".join(letter if letter.isprintable() else " " for letter in scene.name)
    root = ET.Element("mujoco", model=title)
    root.append(ET.Comment(f" {_remarks(scene)} "))
    ET.SubElement(root, "compiler", angle="radian", autolimits="false", balanceinertia="false", boundmass="0")
    option = ET.SubElement(
        root,
        "option",
        timestep=numbers([timestep]),
        integrator=integrator,
        gravity=numbers(scene.gravity),
    )
    _flags(option, scene, tree)
    _visual(root, scene)

    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 4", dir="0 0 -1", directional="true")
    _floor(root, world, scene)
    thickness = 0.25 * min((rod.radius for rod in structure.rods), default=0.02 * size(scene))
    names = Names(scene, tree)
    Bodies(world, scene, tree, names, thickness).add()
    if structure.strings:
        _strings(root, scene, thickness)
    add_bars(root, world, scene, tree, names)
    _closures(root, scene, tree, names, timestep)
    _exclude_joined(root, scene, names)
    if np.any(scene.velocities0):
        keyframe = ET.SubElement(root, "keyframe")
        ET.SubElement(keyframe, "key", name="start", qvel=numbers(initial_velocities(scene)))
    state_oldest(root)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _floor(root: ET.Element, world: ET.Element, scene: Scene) -> None:
    contact = scene.contact
    if contact is None or contact.floor is None:
        return
    bits: dict[str, Any] = {"contype": str(FLOOR), "conaffinity": "0", **hardness(contact)}
    look: dict[str, Any] = {"rgba": "0.8 0.82 0.84 1"}
    taken = {rod.name for rod in scene.structure.rods}
    level = contact.floor
    if contact.terrain is not None:
        name = distinct(["terrain"], taken=taken)[0]
        middle, sizes, shares = contact.terrain.height_field()
        rows: dict[str, Any] = dict(zip(("nrow", "ncol"), map(str, shares.shape), strict=True))
        field: dict[str, Any] = {"size": numbers(sizes), "elevation": numbers(shares[::-1].ravel())}  # text runs down
        ET.SubElement(ET.SubElement(root, "asset"), "hfield", name=name, **rows, **field)
        place: dict[str, Any] = {"pos": numbers(middle + level * contact.up)}
        ET.SubElement(world, "geom", name=name, type="hfield", hfield=name, **place, **bits, **look)
        level += contact.terrain.lowest
    # Endless: the size is for viewers, its last number a spacing of lines.
    origin, rotation = level * contact.up, rotation_to(contact.up)
    if must_turn(origin, [np.zeros(3)], 0.0):
        rotation = rotation @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # about its normal
    place = {"pos": numbers(origin), "quat": numbers(quaternion(rotation))}
    name = distinct(["floor"], taken=taken)[0]
    extent = numbers([0, 0, 0.1 * size(scene)])
    ET.SubElement(world, "geom", name=name, type="plane", **place, **bits, size=extent, **look)


def _flags(option: ET.Element, scene: Scene, tree: BodyTree) -> None:
    """Set the flags that change what is computed; MuJoCo must never reset a state without a warning."""
    constrained = scene.contact is not None or bool(tree.forest.closures)
    # Newton 1.8 reads this flag of a file alone, and lets what has none fall at its own 9.81 m/s².
    without: dict[str, Any] = {} if np.any(scene.gravity) else {"gravity": "disable"}
    if not constrained:
        ET.SubElement(option, "flag", contact="disable", constraint="disable", autoreset="disable", **without)
        return
    moved = [joint.moved for joint in tree.joints] + [axes for _, axes in tree.moved_nodes]
    driven = sum(axes.shape[1] for axes in moved)
    # The solver measures what is left to do by the mean of all inertia, of which drives are all that it would see.
    option.set("tolerance", numbers([SOLVER_TOLERANCE / (DRIVE * driven) if driven else SOLVER_TOLERANCE]))
    if scene.contact is None:
        without["contact"] = "disable"
    else:
        option.set("cone", "elliptic")  # Coulomb's, where the other one favours some directions
        option.set("impratio", numbers([FRICTION_IMPEDANCE]))
    # With the exact mass that each constraint feels, the law of a contact is the one that docs/contact.md states.
    ET.SubElement(option, "flag", autoreset="disable", diagexact="enable", **without)


def _closures(root: ET.Element, scene: Scene, tree: BodyTree, names: Names, timestep: float) -> None:
    """Joints that the tree of bodies leaves open."""
    if not tree.forest.closures:
        return
    equality = ET.SubElement(root, "equality")
    for (node, _, _), end in zip(tree.forest.closures, names.ends, strict=True):
        ET.SubElement(
            equality,
            "connect",
            name=end,
            site1=scene.structure.node_names[node],
            site2=end,
            solref=numbers([CONNECT_STEPS * timestep, 1.0]),
            solimp=numbers([IMPEDANCE, IMPEDANCE, 1.0, 0.5, 1.0]),
        )


def _exclude_joined(root: ET.Element, scene: Scene, names: Names) -> None:
    """Exclude contact of rods that share a node or that the scene names, besides those that MuJoCo knows."""
    if scene.contact is None or not scene.contact.rods:
        return
    pairs = {pair for rows in scene.structure.rods_at.values() for pair in itertools.combinations(sorted(rows), 2)}
    rods = {rod.name: row for row, rod in enumerate(scene.structure.rods)}
    pairs |= {(min(two), max(two)) for two in ((rods[a], rods[b]) for a, b in scene.contact.exclude)}
    if not pairs:
        return
    contact = ET.SubElement(root, "contact")
    for first, second in sorted(pairs):
        ET.SubElement(contact, "exclude", body1=names.rods[first], body2=names.rods[second])


def actuator_numbers(structure: Structure) -> tuple[Array, Array, Array]:
    """Gains (M,) [N/m], biases (M, 3) [k L0, -k, -c] and largest forces (M,) [N] of the strings' actuators.

    A constant force T has the gain 1 and the biases [-T, 0, -c].
    """
    k, c, constant = structure.stiffness, structure.damping, structure.curves.constant
    # Without a damper the two laws are the same, and the limit alone keeps a slack string from pushing.
    pushing = (c > 0) & ~structure.clipped
    first = np.where(constant, -structure.curves.tensions[:, 0], k * structure.rest_lengths)
    return np.where(constant, 1.0, k), np.stack([first, -k, -c], axis=1) + 0.0, np.where(pushing, UNLIMITED, 0.0)


def controls_for(structure: Structure, lengths: Array, rates: Array, tensions: Array) -> Array:
    """ctrl (M,) with which MuJoCo's tensions at lengths and rates are the ones given, where these are above zero."""
    k, c, constant = structure.stiffness, structure.damping, structure.curves.constant
    off = (c * rates - tensions) / np.where(constant, 1.0, k)
    return np.where(constant, structure.curves.tensions[:, 0] + off, lengths - structure.rest_lengths + off)


def _strings(root: ET.Element, scene: Scene, thickness: float) -> None:
    # MuJoCo's polynomial stiffness is that of tendons, about lengths that no control moves, as winches do rest lengths.
    tendons, actuators = ET.SubElement(root, "tendon"), ET.SubElement(root, "actuator")
    strings = scene.structure.strings
    for string, gain, bias, most in zip(strings, *actuator_numbers(scene.structure), strict=True):
        tendon = ET.SubElement(tendons, "spatial", name=string.name, width=numbers([thickness]), rgba="0.8 0.2 0.15 1")
        for name in string.nodes:
            ET.SubElement(tendon, "site", site=name)
        ET.SubElement(
            actuators,
            "general",
            name=string.name,
            tendon=string.name,
            gainprm=numbers([gain]),
            biastype="affine",
            biasprm=numbers(bias),
            forcelimited="true",
            forcerange=numbers([-UNLIMITED, most]),
        )


def _remarks(scene: Scene) -> str:
    damped = np.any(scene.structure.damping > 0)
    curved = any(len(string.curve) > 1 for string in scene.structure.strings)
    remarks = {
        "SI units, z up. Generated by tensegrity_mj; do not edit: change scene.toml and export again.": True,
        "ctrl is the change of a string's rest length [m].": True,
        "By itself, without tensegrity_mj, this model lets the damper of a slack string act.": damped,
        "Tension curves of strings are not in this file: it has their first slopes.": curved,
        "ctrl of a string of constant force is what is taken off it [N].": np.any(scene.structure.curves.constant),
        'The motion starts with the velocities of the keyframe "start".': np.any(scene.velocities0),
        "The scene's external loads are not in this file.": bool(scene.loads),
        "What resists the motion of the scene is not in this file.": scene.resistance is not None
        or bool(len(nodal_damping(scene.structure)[0])),
        "The water of the scene is not in this file.": scene.water is not None,
        "The linear constraints of its nodes are not in this file.": bool(scene.structure.constraints),
        "The motions of the scene's supports are not in this file: what drives them is.": bool(scene.motions),
    }
    return " ".join(text for text, holds in remarks.items() if holds)


def _visual(root: ET.Element, scene: Scene) -> None:
    nodes = scene.nodes0
    center = 0.5 * (nodes.min(axis=0) + nodes.max(axis=0))
    extent = float(np.linalg.norm(np.ptp(nodes, axis=0))) or 1e-3
    ET.SubElement(root, "statistic", center=numbers(center), extent=numbers([extent]))


def add_bars(root: ET.Element, world: ET.Element, scene: Scene, tree: BodyTree, names: Names) -> None:
    """Add the tendons of all elastic rods, behind those of strings."""
    structure = scene.structure
    rows = np.flatnonzero(structure.elastic).tolist()
    if not rows:
        return
    if np.any(scene.gravity):
        ET.SubElement(world, "body", gravcomp="1")  # MuJoCo looks for gravcomp where a body has one above zero
    found = root.find("tendon")
    tendons = ET.SubElement(root, "tendon") if found is None else found
    called = distinct([structure.rods[row].name for row in rows], {string.name for string in structure.strings})
    for row, name in zip(rows, called, strict=True):
        rod, joint = structure.rods[row], tree.joints[row]
        look: dict[str, Any] = {"width": numbers([rod.radius]), "rgba": "0.25 0.35 0.55 1"}
        spring = {"stiffness": rod.stiffness, "damping": rod.damping, "springlength": structure.rod_lengths[row]}
        law: dict[str, Any] = {key: numbers([value]) for key, value in spring.items()}
        bar = ET.SubElement(tendons, "spatial", name=name, **law, **look)
        for node in rod.nodes:
            ET.SubElement(bar, "site", site=node)
        total, first, _ = structure.rod_lumps[:, row]
        for mass, at in ((2 * rod.mass / 3, 0.5), *([(total, first / total)] if total else [])):
            for shares in np.hstack([joint.axes, abs(joint.sigma - at) * joint.stretches]):
                moving = [(slide, share) for slide, share in zip(names.rod_slides[row], shares, strict=True) if share]
                fixed = ET.SubElement(tendons, "fixed", armature=numbers([mass])) if moving else tendons
                for slide, share in moving:
                    ET.SubElement(fixed, "joint", joint=slide, coef=numbers([share]))
