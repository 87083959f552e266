"""Bodies of a scene's MJCF with their joints: rods as capsules with a thin rod's inertia, and all others."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.mujoco.mjcf_tree import (
    TURNED_AXIS,
    TURNED_SITE,
    BodyTree,
    RodJoint,
    Turn,
    distinct,
    must_turn,
    numbers,
    quaternion,
)
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.rods import centers_and_moments, mass_at_ends, total_mass
from tensegrity_mj.model.scene import Scene

# The axial moment of inertia as a part of the transverse one: strings attach on the axis, so 1e-4 to 1e-6 change no
# motion, while below 1e-12 round-off spins the rod up and above 1e-2 it would no longer be a thin rod.
AXIAL_INERTIA = 1e-5
# Of rods that hang on each other: what is about the axis of a rod is then a small part of what hangs on it, and its
# round-off spins rods up. Between 1e-7 and 1 this changes no node of a chain of 121 in space by more than 1e-14 m; the
# spin that round-off leaves falls in proportion, from 3e-6 to 3e-13 rad/s.
NESTED_AXIAL_INERTIA = 1e-2
LEAST_INERTIA = 1e-14  # kg m²: ten times MuJoCo's mjMINVAL
POINT_RADIUS = 1e-6  # of the structure's size: a point mass touches the floor with a ball of this radius
LOOK: dict[str, Any] = {"contype": "0", "conaffinity": "0", "rgba": "0.4 0.4 0.45 1"}  # the picture of a mass
FLOOR, MEMBER = 1, 2  # bits that say what may touch
# What drives a support is a slide whose armature is this many times all masses of the scene. It is pushed with as much
# times d̈, and what reacts on it changes its acceleration by 1e-14 of that which it would give the whole scene. Between
# 1e12 and 1e30 kg no node of a hanging chain changes by more than 2e-13 m in 6 s; MuJoCo's solver of constraints wants
# no more than there must be.
DRIVE = 1e14


class Names:
    """Names of bodies, joints and sites, unique among their kind: lists of rods, point masses, moved nodes, bodies."""

    def __init__(self, scene: Scene, tree: BodyTree) -> None:
        structure = scene.structure
        rods, points = structure.rods, structure.lone_masses
        moved = [structure.node_names[row] for row, _ in tree.moved_nodes]
        members = [rod.name for rod in rods] + [point.node for point in points] + moved
        own = [body.name for body in structure.bodies]
        bodies = distinct([*members, *own], taken={"world"})
        # The second body of an elastic rod.
        self.bars = distinct([f"{rod.name} end" for rod in rods], taken={"world", *bodies})
        cuts = (len(rods), len(rods) + len(points))
        self.rods, self.points, self.moved = _cut(bodies[: len(members)], cuts)
        self.bodies = bodies[len(members) :]
        # A rod's own name goes to the joint that turns it, not to a slide of another rod.
        self.turns = [rod.name for rod in rods]
        counts = [0 if j.turn is Turn.FREE else j.axes.shape[1] + j.stretches.shape[1] for j in tree.joints]
        counts += [point.translation_basis.shape[1] for point in points]
        counts += [axes.shape[1] for _, axes in tree.moved_nodes]
        wanted = [f"{name} {k + 1}" for name, count in zip(members, counts, strict=True) for k in range(count)]
        given = iter(distinct([*wanted, *own], taken=set(self.turns)))
        slides = [[next(given) for _ in range(count)] for count in counts]
        self.rod_slides, self.point_slides, self.moved_slides = _cut(slides, cuts)
        self.free_joints = list(given)  # of the bodies
        # Where a rod ends at a node whose site another rod's body carries, and no joint of bodies holds it there.
        ends = [f"{structure.node_names[node]} of {rods[other].name}" for node, _, other in tree.forest.closures]
        self.ends = distinct(ends, taken=set(structure.node_names))


def _cut(values: list[Any], cuts: tuple[int, int]) -> tuple[list[Any], list[Any], list[Any]]:
    return values[: cuts[0]], values[cuts[0] : cuts[1]], values[cuts[1] :]


class Bodies:
    """Writer of a scene's bodies into the world of its model.

    Attributes:
        world: where they are added.
        site: the look of sites.
        thickness: [m] of the strings' drawing.
    """

    def __init__(self, world: ET.Element, scene: Scene, tree: BodyTree, names: Names, thickness: float) -> None:
        self.world, self.scene, self.tree, self.names, self.thickness = world, scene, tree, names, thickness
        self.structure = scene.structure
        self.site: dict[str, Any] = {"size": numbers([2 * thickness]), "rgba": "0.2 0.2 0.2 1"}

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
        frame: dict[str, Any] = {"pos": numbers(position), "quat": numbers(quaternion(place))}
        body = ET.SubElement(carrier, "body", name=names.rods[number], **frame)
        turn = names.turns[number]
        if joint.turn is Turn.FREE:
            ET.SubElement(body, "freejoint", name=turn)
        else:
            # Slides come before the turn, so that their axes stay where the support has them.
            self._add_slides(body, names.rod_slides[number], rotation.T @ joint.axes, joint.slides.shape[1])
            if joint.turn is Turn.BALL:
                ET.SubElement(body, "joint", name=turn, type="ball")
            else:
                normal = rotation.T @ self.tree.normals[number]
                ET.SubElement(body, "joint", name=turn, type="hinge", axis=numbers(normal))
        middle, transverse = centers_and_moments(rod.mass, length, structure.rod_lumps[:, number])
        # Where rods touch something they may roll on it: then it is a solid cylinder's.
        thin = AXIAL_INERTIA if structure.class_number < 2 else NESTED_AXIAL_INERTIA
        axial = transverse * (thin if scene.contact is None else 1.0)
        # MuJoCo takes none below mjMINVAL; a part of up to 1e-2 changes no motion either.
        axial = max(axial, min(1e-2 * transverse, LEAST_INERTIA))
        back, ahead = -sigma * length, (1 - sigma) * length
        center = (0.0, 0.0, (middle - sigma) * length)
        turned: dict[str, Any] = {"quat": TURNED_AXIS} if must_turn(center, [np.zeros(3)], length) else {}
        ET.SubElement(
            body,
            "inertial",
            pos=numbers(center),
            mass=numbers([structure.rod_masses[number]]),
            diaginertia=numbers([transverse, transverse, axial]),
            **turned,
        )
        ET.SubElement(
            body,
            "geom",
            name=rod.name,
            type="capsule",
            fromto=numbers([0, 0, back, 0, 0, ahead]),
            size=numbers([rod.radius]),
            **touching(scene, rods=True),
            rgba="0.25 0.35 0.55 1",
        )
        for lump in rod.masses:
            at = numbers([0, 0, back + lump.at * length])
            ET.SubElement(body, "geom", type="sphere", pos=at, size=numbers([1.6 * rod.radius]), **LOOK)
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
        """The bodies of an elastic rod's ends, the second of which slides relative to the first; see `mjcf_elastic`."""
        scene, structure, names = self.scene, self.structure, self.names
        rod, ends = structure.rods[number], scene.nodes0[structure.rod_nodes[number]]
        near, count = int(joint.sigma), joint.axes.shape[1]
        slides = names.rod_slides[number]
        own, (total, first, second) = rod.mass / 6, structure.rod_lumps[:, number]
        heavy: list[dict[str, Any]] = [{}, {}]  # what a body weighs more than its own mass does
        if np.any(scene.gravity):
            heavy = [{"gravcomp": numbers([1 - weight / own])} for weight in mass_at_ends(structure)[number]]
        # The moment of inertia never counts: the bodies only slide.
        inertia: dict[str, Any] = {"mass": numbers([own]), "diaginertia": numbers([rod.mass] * 3)}
        body = ET.SubElement(self.world, "body", name=names.rods[number], pos=numbers(ends[near]), **heavy[near])
        self._add_slides(body, slides[:count], joint.axes, joint.slides.shape[1])
        inner = ET.Element("body", name=names.bars[number], pos=numbers(ends[1 - near] - ends[near]), **heavy[1 - near])
        apart = max(second - first**2 / total, 0.0) if total else 0.0  # of the masses about their own centre
        self._add_slides(inner, slides[count:], joint.stretches, 0, apart)
        for part, node in ((body, rod.nodes[near]), (inner, rod.nodes[1 - near])):
            ET.SubElement(part, "inertial", pos="0 0 0", **inertia)
            self._add_site(part, node, [0, 0, 0])
        body.append(inner)

    def _add_site(
        self, body: ET.Element, name: str, place: ArrayLike, center: ArrayLike = (0, 0, 0), size: float = 0.0
    ) -> None:
        """A site at a place (3,) of a body whose center of mass is at `center` (3,) and which is of this size [m]."""
        turned: dict[str, Any] = {"quat": TURNED_SITE} if must_turn(place, [np.zeros(3), center], size) else {}
        ET.SubElement(body, "site", name=name, pos=numbers(np.asarray(place, float)), **turned, **self.site)

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
            more: dict[str, Any] = {"armature": numbers([mass])} if k >= free and mass else {}
            ET.SubElement(body, "joint", name=name, type="slide", axis=numbers(axis), **more)

    def _add_point(self, number: int) -> None:
        scene, structure = self.scene, self.structure
        point = structure.lone_masses[number]
        position = scene.nodes0[structure.node_index[point.node]]
        body = ET.SubElement(self.world, "body", name=self.names.points[number], pos=numbers(position))
        self._add_slides(body, self.names.point_slides[number], point.translation_basis, 3)
        # The moment of inertia never counts: the body only slides.
        inertia = numbers([point.mass * size(scene) ** 2 * 1e-4] * 3)
        ET.SubElement(body, "inertial", pos="0 0 0", mass=numbers([point.mass]), diaginertia=inertia)
        own = sum(len(rope.points) for rope in structure.ropes)  # the last of them, drawn as strings are
        radius = numbers([self.thickness if number >= len(structure.lone_masses) - own else 4 * self.thickness])
        ET.SubElement(body, "geom", type="sphere", size=radius, **LOOK)
        if scene.contact is not None and scene.contact.floor is not None:
            ball = numbers([POINT_RADIUS * size(scene)])
            ET.SubElement(body, "geom", type="sphere", size=ball, **touching(scene, rods=False), rgba="0 0 0 0")
        ET.SubElement(body, "site", name=point.node, pos="0 0 0", **self.site)

    def _add_moved_node(self, number: int) -> None:
        """Add a node that moves and belongs to no member: only strings feel it, and its mass has no effect."""
        row, axes = self.tree.moved_nodes[number]
        body = ET.SubElement(self.world, "body", name=self.names.moved[number], pos=numbers(self.scene.nodes0[row]))
        self._add_slides(body, self.names.moved_slides[number], axes, 0)
        ET.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        ET.SubElement(body, "site", name=self.structure.node_names[row], pos="0 0 0", **self.site)

    def _add_body(self, number: int) -> None:
        """A body about its centre of mass, drawn as the edges of its hull; one that is held has no joint."""
        body, frame = self.structure.bodies[number], self.structure.frames[number]
        center, rotation = frame.placed(self.scene.nodes0)
        at: dict[str, Any] = {"pos": numbers(center), "quat": numbers(quaternion(rotation))}
        element = ET.SubElement(self.world, "body", name=self.names.bodies[number], **at)
        if not body.held:
            ET.SubElement(element, "freejoint", name=self.names.free_joints[number])
        # Principal axes by LAPACK: MuJoCo's own are found to 1e-12 alone.
        moments, axes = np.linalg.eigh(body.inertia_matrix)
        axes[:, 2] *= np.linalg.det(axes)
        inertia: dict[str, Any] = {"quat": numbers(quaternion(axes)), "diaginertia": numbers(moments)}
        ET.SubElement(element, "inertial", pos="0 0 0", mass=numbers([body.mass]), **inertia)
        for pair in frame.edges:
            ends = numbers(frame.offsets[pair].ravel())
            ET.SubElement(element, "geom", type="capsule", fromto=ends, size=numbers([2 * self.thickness]), **LOOK)
        for name, offset in zip(body.nodes, frame.offsets, strict=True):
            self._add_site(element, name, offset, size=float(np.abs(frame.offsets).max()))


def drive(scene: Scene) -> float:
    """Armature [kg] of the slides that drive supports."""
    return DRIVE * (total_mass(scene.structure) or 1.0)


def touching(scene: Scene, rods: bool) -> dict[str, Any]:
    """Attributes of a geom that touches the floor, if there is one, and `rods`, if they touch; nothing otherwise."""
    contact = scene.contact
    if contact is None:
        return {"contype": "0", "conaffinity": "0"}
    member = MEMBER if rods and contact.rods else 0
    bits = {"contype": str(member), "conaffinity": str(member + (FLOOR if contact.floor is not None else 0))}
    return bits | hardness(contact)


def hardness(contact: Contact) -> dict[str, Any]:
    """Friction, stiffness and damping, the same for all that touch: no mean of two materials is ever taken."""
    return {
        "condim": "1" if contact.friction == 0 else "6" if contact.rolling > 0 else "4" if contact.torsion > 0 else "3",
        "friction": numbers([contact.friction, contact.torsion, contact.rolling]),
        "solref": numbers([-contact.stiffness, -contact.damping]),
        "solimp": numbers(contact.impedance),
    }


def size(scene: Scene) -> float:
    """Largest extent of the structure at the start [m]; 1 mm for a point."""
    return float(np.max(np.ptp(scene.nodes0, axis=0), initial=0.0)) or 1e-3
