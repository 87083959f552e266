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
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array, rotation_to
from tensegrity_mj.engines.mujoco.mjcf_tree import (
    TURNED_AXIS,
    TURNED_SITE,
    BodyTree,
    Names,
    RodJoint,
    Turn,
    add,
    body_tree,
    distinct,
    initial_velocities,
    must_turn,
    numbers,
    quaternion,
)
from tensegrity_mj.engines.mujoco.mjcf_versions import state_oldest
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.elements.contact import FRICTION_IMPEDANCE, Contact, held_nodes, holds_spin
from tensegrity_mj.model.elements.resistance import nodal_damping
from tensegrity_mj.model.rods import axial_moment, centers_and_moments, mass_at_ends, total_mass
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

# Of a cost, which is of the second order in what accelerations lack. In six_bar_push and prism_drop they are off by up
# to 2e-4 of their size at 1e-15, 4e-8 at 1e-22 and 1e-10 at 1e-28, for 1.2, 1.5 and 1.6 of Newton's iterations a step.
# The stiff constraints that close loops need one, and below 1e-26 their round-off is taken for what is left to do: 1.6
# times the time of a step of suspended_cable, at the same motion.
SOLVER_TOLERANCE, LOOP_TOLERANCE, LOOP_CONTACT_TOLERANCE = 1e-28, 1e-15, 1e-22
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
# The axial moment of inertia as a part of the transverse one: strings attach on the axis, so 1e-4 to 1e-6 change no
# motion, while below 1e-12 round-off spins the rod up and above 1e-2 it would no longer be a thin rod.
AXIAL_INERTIA = 1e-5
# Of rods that hang on each other: what is about the axis of a rod is then a small part of what hangs on it, and its
# round-off spins rods up. Between 1e-7 and 1 this changes no node of a chain of 121 in space by more than 1e-14 m; the
# spin that round-off leaves falls in proportion, from 3e-6 to 3e-13 rad/s.
NESTED_AXIAL_INERTIA = 1e-2
LEAST_INERTIA = 1e-14  # kg m²: ten times MuJoCo's mjMINVAL
POINT_RADIUS = 1e-3  # m: a point mass touches the floor with the lowest point of a ball of this radius
LOOK = {"contype": "0", "conaffinity": "0", "rgba": "0.4 0.4 0.45 1"}  # the picture of a mass
FLOOR, MEMBER = 1, 2  # bits that say what may touch
# What drives a support is a slide whose armature is this many times all masses of the scene. It is pushed with as much
# times d̈, and what reacts on it changes its acceleration by 1e-14 of that which it would give the whole scene. Between
# 1e12 and 1e30 kg no node of a hanging chain changes by more than 2e-13 m in 6 s; MuJoCo's solver of constraints wants
# no more than there must be.
DRIVE = 1e14


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
    add(root, "compiler", angle="radian", autolimits="false", balanceinertia="false", boundmass="0")
    option = add(root, "option", timestep=timestep, integrator=integrator, gravity=scene.gravity)
    _flags(option, scene, tree)
    nodes = scene.nodes0
    extent = float(np.linalg.norm(np.ptp(nodes, axis=0))) or 1e-3
    add(root, "statistic", center=0.5 * (nodes.min(axis=0) + nodes.max(axis=0)), extent=extent)

    world = add(root, "worldbody")
    add(world, "light", pos="0 0 4", dir="0 0 -1", directional="true")
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
        add(add(root, "keyframe"), "key", name="start", qvel=initial_velocities(scene))
    state_oldest(root)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _floor(root: ET.Element, world: ET.Element, scene: Scene) -> None:
    contact = scene.contact
    if contact is None or contact.floor is None:
        return
    bits, look = {"contype": str(FLOOR), "conaffinity": "0", **hardness(contact)}, {"rgba": "0.8 0.82 0.84 1"}
    taken = {rod.name for rod in scene.structure.rods}
    level = contact.floor
    if contact.terrain is not None:
        name = distinct(["terrain"], taken=taken)[0]
        middle, sizes, shares = contact.terrain.height_field()
        rows, columns = map(str, shares.shape)
        text = shares[::-1]  # which runs down
        add(add(root, "asset"), "hfield", name=name, nrow=rows, ncol=columns, size=sizes, elevation=text)
        add(world, "geom", name=name, type="hfield", hfield=name, pos=middle + level * contact.up, **bits, **look)
        level += contact.terrain.lowest
    # Endless: the size is for viewers, its last number a spacing of lines.
    origin, rotation = level * contact.up, rotation_to(contact.up)
    if must_turn(origin, [np.zeros(3)], 0.0):
        rotation = rotation @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # about its normal
    name = distinct(["floor"], taken=taken)[0]
    at = {"pos": origin, "quat": quaternion(rotation)}
    add(world, "geom", name=name, type="plane", **at, **bits, size=[0, 0, 0.1 * size(scene)], **look)


def _flags(option: ET.Element, scene: Scene, tree: BodyTree) -> None:
    """Set the flags that change what is computed; MuJoCo must never reset a state without a warning."""
    constrained = scene.contact is not None or bool(tree.forest.closures)
    # Newton 1.8 reads this flag of a file alone, and lets what has none fall at its own 9.81 m/s².
    gravity = None if np.any(scene.gravity) else "disable"
    if not constrained:
        add(option, "flag", contact="disable", constraint="disable", autoreset="disable", gravity=gravity)
        return
    moved = [joint.moved for joint in tree.joints] + [axes for _, axes in tree.moved_nodes]
    driven = sum(axes.shape[1] for axes in moved)
    # The solver measures what is left to do by the mean of all inertia, of which drives are all that it would see.
    loops = LOOP_TOLERANCE if scene.contact is None else LOOP_CONTACT_TOLERANCE
    tolerance = loops if tree.forest.closures else SOLVER_TOLERANCE
    option.set("tolerance", numbers([tolerance / (DRIVE * driven) if driven else tolerance]))
    if scene.contact is not None:
        option.set("cone", "elliptic")  # Coulomb's, where the other one favours some directions
        option.set("impratio", numbers([FRICTION_IMPEDANCE]))
    # With the exact mass that each constraint feels, the law of a contact is the one that docs/contact.md states.
    contact = "disable" if scene.contact is None else None
    add(option, "flag", autoreset="disable", diagexact="enable", gravity=gravity, contact=contact)


def _closures(root: ET.Element, scene: Scene, tree: BodyTree, names: Names, timestep: float) -> None:
    """Joints that the tree of bodies leaves open."""
    if not tree.forest.closures:
        return
    equality = add(root, "equality")
    law = {"solref": [CONNECT_STEPS * timestep, 1.0], "solimp": [IMPEDANCE, IMPEDANCE, 1.0, 0.5, 1.0]}
    for (node, _, _), end in zip(tree.forest.closures, names.ends, strict=True):
        add(equality, "connect", name=end, site1=scene.structure.node_names[node], site2=end, **law)


def _exclude_joined(root: ET.Element, scene: Scene, names: Names) -> None:
    """Exclude contact of rods that share a node or that the scene names, besides those that MuJoCo knows."""
    if scene.contact is None or not scene.contact.rods:
        return
    pairs = {pair for rows in scene.structure.rods_at.values() for pair in itertools.combinations(sorted(rows), 2)}
    rods = {rod.name: row for row, rod in enumerate(scene.structure.rods)}
    pairs |= {(min(two), max(two)) for two in ((rods[a], rods[b]) for a, b in scene.contact.exclude)}
    if not pairs:
        return
    contact = add(root, "contact")
    for first, second in sorted(pairs):
        add(contact, "exclude", body1=names.rods[first], body2=names.rods[second])


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
    tendons, actuators = add(root, "tendon"), add(root, "actuator")
    strings = scene.structure.strings
    for string, gain, bias, most in zip(strings, *actuator_numbers(scene.structure), strict=True):
        tendon = add(tendons, "spatial", name=string.name, width=thickness, rgba="0.8 0.2 0.15 1")
        for name in string.nodes:
            add(tendon, "site", site=name)
        law = {"gainprm": gain, "biastype": "affine", "biasprm": bias, "forcelimited": "true"}
        add(actuators, "general", name=string.name, tendon=string.name, **law, forcerange=[-UNLIMITED, most])


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
        "By itself this model lets rods turn about their own axes, which tensegrity_mj hinders.": holds_spin(scene),
        "The motions of the scene's supports are not in this file: what drives them is.": bool(scene.motions),
    }
    return " ".join(text for text, holds in remarks.items() if holds)


def add_bars(root: ET.Element, world: ET.Element, scene: Scene, tree: BodyTree, names: Names) -> None:
    """Add the tendons of all elastic rods, behind those of strings."""
    structure = scene.structure
    rows = np.flatnonzero(structure.elastic).tolist()
    if not rows:
        return
    if np.any(scene.gravity):
        add(world, "body", gravcomp="1")  # MuJoCo looks for gravcomp where a body has one above zero
    found = root.find("tendon")
    tendons = add(root, "tendon") if found is None else found
    called = distinct([structure.rods[row].name for row in rows], {string.name for string in structure.strings})
    for row, name in zip(rows, called, strict=True):
        rod, joint = structure.rods[row], tree.joints[row]
        spring = {"stiffness": rod.stiffness, "damping": rod.damping, "springlength": structure.rod_lengths[row]}
        bar = add(tendons, "spatial", name=name, **spring, width=rod.radius, rgba="0.25 0.35 0.55 1")
        for node in rod.nodes:
            add(bar, "site", site=node)
        total, first, _ = structure.rod_lumps[:, row]
        for mass, at in ((2 * rod.mass / 3, 0.5), *([(total, first / total)] if total else [])):
            for shares in np.hstack([joint.axes, abs(joint.sigma - at) * joint.stretches]):
                moving = [(slide, share) for slide, share in zip(names.rod_slides[row], shares, strict=True) if share]
                fixed = add(tendons, "fixed", armature=mass) if moving else tendons
                for slide, share in moving:
                    add(fixed, "joint", joint=slide, coef=share)


class Bodies:
    """Writer of a scene's bodies into the world of its model.

    Attributes:
        world: where they are added.
        site: the look of sites.
        thickness: [m] of the strings' drawing.
    """

    def __init__(self, world: ET.Element, scene: Scene, tree: BodyTree, names: Names, thickness: float) -> None:
        self.world, self.scene, self.tree, self.names, self.thickness = world, scene, tree, names, thickness
        self.structure, self.held = scene.structure, held_nodes(scene.structure, scene.contact)
        self.site = {"size": 2 * thickness, "rgba": "0.2 0.2 0.2 1"}

    def add(self) -> None:
        """Add the fixed nodes that stand still, and everything that moves."""
        moved = {row for row, _ in self.tree.moved_nodes}
        for name in self.structure.fixed_nodes:
            row = self.structure.node_index[name]
            if row not in moved:
                self._add_site(self.world, name, self.scene.nodes0[row])
        elements: dict[int, ET.Element] = {-1: self.world}
        for number in self.tree.order:
            joint = self.tree.joints[number]
            if joint.turn is Turn.NONE:
                self._add_bar(number, joint)
            else:
                elements[number] = self._add_rod(elements[joint.parent], number, joint)
        for number in range(len(self.structure.lone_masses)):
            self._add_point(number)
        for number in range(len(self.tree.moved_nodes)):
            self._add_moved_node(number)
        for number in range(len(self.structure.bodies)):
            self._add_body(number)

    def _add_rod(self, carrier: ET.Element, number: int, joint: RodJoint) -> ET.Element:
        scene, structure, names = self.scene, self.structure, self.names
        rod, length = structure.rods[number], float(structure.rod_lengths[number])
        sigma = joint.sigma
        position, rotation = self._frame(number)
        place = rotation
        if joint.parent >= 0:
            origin, carried = self._frame(joint.parent)
            position, place = carried.T @ (position - origin), carried.T @ rotation
        body = add(carrier, "body", name=names.rods[number], pos=position, quat=quaternion(place))
        turn = names.turns[number]
        if joint.turn is Turn.FREE:
            add(body, "freejoint", name=turn)
        else:
            # Slides come before the turn, so that their axes stay where the support has them.
            self._add_slides(body, names.rod_slides[number], rotation.T @ joint.axes, joint.slides.shape[1])
            if joint.turn is Turn.BALL:
                add(body, "joint", name=turn, type="ball")
            else:
                add(body, "joint", name=turn, type="hinge", axis=rotation.T @ self.tree.normals[number])
        middle, transverse = centers_and_moments(rod.mass, length, structure.rod_lumps[:, number])
        thin = AXIAL_INERTIA if structure.class_number < 2 else NESTED_AXIAL_INERTIA
        axial = transverse * thin if scene.contact is None else axial_moment(rod)
        # MuJoCo takes none below mjMINVAL; a part of up to 1e-2 changes no motion either.
        axial = max(axial, min(1e-2 * transverse, LEAST_INERTIA))
        back, ahead = -sigma * length, (1 - sigma) * length
        center = (0.0, 0.0, (middle - sigma) * length)
        turned = TURNED_AXIS if must_turn(center, [np.zeros(3)], length) else None
        mass, moments = structure.rod_masses[number], [transverse, transverse, axial]
        add(body, "inertial", pos=center, mass=mass, diaginertia=moments, quat=turned)
        shape = {"type": "capsule", "fromto": [0, 0, back, 0, 0, ahead], "size": rod.radius}
        apart = self.held[structure.rod_nodes[number]]
        bits = touching(scene, rods=True, floor=not apart.any())
        add(body, "geom", name=rod.name, **shape, **bits, rgba="0.25 0.35 0.55 1")
        if apart.any():  # as a plane knows a capsule by the half balls at its ends, so here the one that is not held
            for height in np.array([back, ahead])[~apart]:
                add(body, "geom", type="sphere", pos=[0, 0, height], size=rod.radius, **touching(scene), rgba="0 0 0 0")
        for lump in rod.masses:
            add(body, "geom", type="sphere", pos=[0, 0, back + lump.at * length], size=1.6 * rod.radius, **LOOK)
        closures = zip(self.tree.forest.closures, names.ends, strict=True)
        own = {node: name for (node, _, other), name in closures if other == number}
        for name, height in zip(rod.nodes, (back, ahead), strict=True):
            node = structure.node_index[name]
            if self.tree.forest.owner[node] == number:
                self._add_site(body, name, [0, 0, height], center, length)
            elif node in own:
                self._add_site(body, own[node], [0, 0, height], center, length)
        return body

    def _add_bar(self, number: int, joint: RodJoint) -> None:
        """The bodies of an elastic rod's ends, the second of which slides relative to the first; see `mjcf`."""
        scene, structure, names = self.scene, self.structure, self.names
        rod, ends = structure.rods[number], scene.nodes0[structure.rod_nodes[number]]
        near, count = int(joint.sigma), joint.axes.shape[1]
        slides = names.rod_slides[number]
        own, (total, first, second) = rod.mass / 6, structure.rod_lumps[:, number]
        weights = mass_at_ends(structure)[number]  # what a body weighs more than its own mass does
        heavy: Any = 1 - weights / own if np.any(scene.gravity) else [None, None]
        body = add(self.world, "body", name=names.rods[number], pos=ends[near], gravcomp=heavy[near])
        self._add_slides(body, slides[:count], joint.axes, joint.slides.shape[1])
        place = ends[1 - near] - ends[near]
        inner = add(ET.Element("none"), "body", name=names.bars[number], pos=place, gravcomp=heavy[1 - near])
        apart = max(second - first**2 / total, 0.0) if total else 0.0  # of the masses about their own centre
        self._add_slides(inner, slides[count:], joint.stretches, 0, apart)
        for part, node in ((body, rod.nodes[near]), (inner, rod.nodes[1 - near])):
            # The moment of inertia never counts: the bodies only slide.
            add(part, "inertial", pos="0 0 0", mass=own, diaginertia=[rod.mass] * 3)
            self._add_site(part, node, [0, 0, 0])
        body.append(inner)

    def _add_site(
        self, body: ET.Element, name: str, place: ArrayLike, center: ArrayLike = (0, 0, 0), size: float = 0.0
    ) -> None:
        """A site at a place (3,) of a body whose center of mass is at `center` (3,) and which is of this size [m]."""
        turned = TURNED_SITE if must_turn(place, [np.zeros(3), center], size) else None
        add(body, "site", name=name, pos=place, quat=turned, **self.site)

    def _frame(self, number: int) -> tuple[Array, Array]:
        """Position and rotation of a rod's body at the start, in the world."""
        first, second = self.scene.nodes0[self.structure.rod_nodes[number]]
        sigma = self.tree.joints[number].sigma
        return (1 - sigma) * first + sigma * second, self.tree.built[number]

    def _add_slides(
        self, body: ET.Element, names: list[str], axes: Array, free: int, armature: float | None = None
    ) -> None:
        """Add slides along axes (3, n), those after the free ones with an armature [kg], by default that of drives."""
        mass = drive(self.scene) if armature is None else armature
        for k, (name, axis) in enumerate(zip(names, axes.T, strict=True)):
            add(body, "joint", name=name, type="slide", axis=axis, armature=mass if k >= free and mass else None)

    def _add_point(self, number: int) -> None:
        scene, structure = self.scene, self.structure
        point = structure.lone_masses[number]
        position = scene.nodes0[structure.node_index[point.node]]
        body = add(self.world, "body", name=self.names.points[number], pos=position)
        self._add_slides(body, self.names.point_slides[number], point.translation_basis, 3)
        # The moment of inertia never counts: the body only slides.
        inertia = [point.mass * size(scene) ** 2 * 1e-4] * 3
        add(body, "inertial", pos="0 0 0", mass=point.mass, diaginertia=inertia)
        own = sum(len(rope.points) for rope in structure.ropes)  # the last of them, drawn as strings are
        radius = self.thickness if number >= len(structure.lone_masses) - own else 4 * self.thickness
        add(body, "geom", type="sphere", size=radius, **LOOK)
        if scene.contact is not None and not self.held[structure.node_index[point.node]]:
            at = POINT_RADIUS * scene.contact.up  # the body does not turn
            add(body, "geom", type="sphere", pos=at, size=POINT_RADIUS, **touching(scene), rgba="0 0 0 0")
        add(body, "site", name=point.node, pos="0 0 0", **self.site)

    def _add_moved_node(self, number: int) -> None:
        """Add a node that moves and belongs to no member: only strings feel it, and its mass has no effect."""
        row, axes = self.tree.moved_nodes[number]
        body = add(self.world, "body", name=self.names.moved[number], pos=self.scene.nodes0[row])
        self._add_slides(body, self.names.moved_slides[number], axes, 0)
        add(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        add(body, "site", name=self.structure.node_names[row], pos="0 0 0", **self.site)

    def _add_body(self, number: int) -> None:
        """A body about its centre of mass, drawn as the edges of its hull; one that is held has no joint."""
        body, frame = self.structure.bodies[number], self.structure.frames[number]
        center, rotation = frame.placed(self.scene.nodes0)
        element = add(self.world, "body", name=self.names.bodies[number], pos=center, quat=quaternion(rotation))
        if not body.held:
            add(element, "freejoint", name=self.names.free_joints[number])
        # Principal axes by LAPACK: MuJoCo's own are found to 1e-12 alone.
        moments, axes = np.linalg.eigh(body.inertia_matrix)
        axes[:, 2] *= np.linalg.det(axes)
        add(element, "inertial", pos="0 0 0", mass=body.mass, quat=quaternion(axes), diaginertia=moments)
        for pair in frame.edges:
            add(element, "geom", type="capsule", fromto=frame.offsets[pair], size=2 * self.thickness, **LOOK)
        for name, offset in zip(body.nodes, frame.offsets, strict=True):
            self._add_site(element, name, offset, size=float(np.abs(frame.offsets).max()))


def drive(scene: Scene) -> float:
    """Armature [kg] of the slides that drive supports."""
    return DRIVE * (total_mass(scene.structure) or 1.0)


def touching(scene: Scene, *, rods: bool = False, floor: bool = True) -> dict[str, Any]:
    """Attributes of a geom that touches the `floor`, if there is one, and `rods`, if they touch; nothing otherwise."""
    contact = scene.contact
    if contact is None:
        return {"contype": "0", "conaffinity": "0"}
    member = MEMBER if rods and contact.rods else 0
    bits = {"contype": str(member), "conaffinity": str(member + (FLOOR if floor and contact.floor is not None else 0))}
    return bits | hardness(contact)


def hardness(contact: Contact) -> dict[str, Any]:
    """Friction, stiffness and damping, the same for all that touch: no mean of two materials is ever taken."""
    stiffness, damping, impedance = contact.spring
    return {
        "condim": "1" if contact.friction == 0 else "6" if contact.rolling > 0 else "4" if contact.torsion > 0 else "3",
        "friction": [contact.friction, contact.torsion, contact.rolling],
        "solref": [-stiffness, -damping],
        "solimp": impedance,
    }


def size(scene: Scene) -> float:
    """Largest extent of the structure at the start [m]; 1 mm for a point."""
    return float(np.max(np.ptp(scene.nodes0, axis=0), initial=0.0)) or 1e-3
