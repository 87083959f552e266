"""Scenes: a structure, all that one experiment needs of its surroundings, and how the whole stands and starts.

SI units; world frame right-handed, z up; arrays of node positions and velocities are (N, 3), rows in the
order of `Structure.node_names`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from tensegrity_mj.basics import notebook_pictures
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import SAME_ARRAY, field, refused, value
from tensegrity_mj.basics.kinds import array, choice, not_negative, part, parts, positive, text, vector
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.elements.elastic_rods import ElasticRods
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.elements.resistance import NodalDamping, Resistance
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.elements.water_segments import SegmentCount, segment_count
from tensegrity_mj.model.events import Break, ControlSpec, Load, LoadFunction, NodalLoads, loads_kind
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.moved_supports import moved_positions, velocities_with_supports
from tensegrity_mj.model.redundancy import Redundancy, redundancy
from tensegrity_mj.model.rods import lumped_masses
from tensegrity_mj.model.ropes import RopeStart, completed, with_ropes
from tensegrity_mj.model.scene_checks import check_scene, check_velocities
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import CONSTRAINT_TOLERANCE
from tensegrity_mj.model.target import Target

STILL = (0.0, 0.0, 0.0)


@value("whole")
class Whole:
    """A structure rotated about the origin, then translated, then given a velocity; all of it in the world frame.

    Attributes:
        rotation: vector along the axis, as long as the angle [rad], by the right hand.
        translation: after the rotation [m].
        velocity: of the center [m/s].
        angular_velocity: about the center [rad/s].
        center: a point of space [m], where the structure stands by then; None for its centre of mass.
    """

    rotation: Vector = field(vector("rad"), default=STILL)
    translation: Vector = field(vector("m"), default=STILL)
    velocity: Vector = field(vector("m/s"), default=STILL)
    angular_velocity: Vector = field(vector("rad/s"), default=STILL)
    center: Vector | None = field(vector("m"), default=None, none="None for the centre of mass")

    def __attrs_post_init__(self) -> None:
        if math.hypot(*self.rotation) > 2 * math.pi:
            raise refused(self, f"rotation = {list(self.rotation)}; its length is an angle in rad, of at most 2π")

    def start(self, scene: Scene) -> Scene:
        """Return the scene whose nodes have the velocity of the whole added to their own at t = 0.

        Raises:
            SceneError: where supports, planes or fixed nodes do not let the whole move so.
        """
        if not any((*self.velocity, *self.angular_velocity)):
            return scene
        structure, nodes = scene.structure, scene.nodes0
        middle = np.average(nodes, axis=0, weights=lumped_masses(structure))
        center = middle if self.center is None else np.array(self.center)
        rates = np.array(self.velocity) + np.cross(self.angular_velocity, nodes - center)
        for row in (structure.node_index[name] for name in structure.fixed_nodes):
            if np.abs(rates[row]).max() <= CONSTRAINT_TOLERANCE * np.abs(rates).max():
                rates[row] = 0.0  # on the axis, but for round-off
        try:
            check_velocities(structure, nodes, rates, {}, "whole")
        except SceneError as error:
            raise SceneError(
                f"{error}: the ground holds it there, so that the whole cannot start with velocity = "
                f"{list(self.velocity)} and angular_velocity = {list(self.angular_velocity)}; give what its supports "
                "allow (center = a point that stays), velocities of nodes by initial_velocities, or free it"
            ) from None
        return scene.with_(initial_velocities=scene.velocities0 + rates)


@value("scene {name!r}")
class Scene:
    """One experiment with a structure.

    Attributes:
        structure: the structure that moves.
        name, source: short name; where its numbers come from (thesis page, paper).
        gravity: g [m/s²]; zero by default.
        initial_nodes: (N, 3) [m] at the start; by default the structure's reference nodes, moved with their supports.
        initial_velocities: (N, 3) [m/s]; at rest by default, seen from the supports where these move.
        loads: external forces on nodes, either `Load`s or a function t -> (N, 3) [N].
        breaks: strings that break, each at its time.
        target: goal of a controller, for all nodes but those of ropes.
        control: the law that the scene is run with unless another is given.
        duration: [s] of a run unless another duration is given.
        start_time: [s] at which runs begin; loads, motions, breaks, waves and laws go by the same clock.
        contact: of rods with a floor and with each other; None, the default, for none.
        motions: of supports that do not stand still, one a support.
        resistance: of a fluid against rods, and of joints against bending; None, the default, for none.
        water: with its surface at z = 0, waves and current; None, the default, for none.
        elements: other effects on nodes, see `Element`.
        rope_start: velocities of the points of strings with mass where supports move and no initial velocities are
            given: at rest in the world, or as on a straight line between the string's ends.

    Raises:
        SceneError: on construction, if the motion stretches a rod, breaks a support, or does not fit.
    """

    structure: Structure = field(part(Structure))
    name: str = field(text(), default="")
    source: str = field(text(), default="")
    gravity: Vector = field(vector("m/s²"), default=(0.0, 0.0, 0.0))
    initial_nodes: Array | None = field(array("(N, 3)"), default=None, none="None", eq=SAME_ARRAY)
    initial_velocities: Array | None = field(array("(N, 3)"), default=None, none="None", eq=SAME_ARRAY)
    loads: tuple[Load, ...] | LoadFunction = field(loads_kind(), default=())
    breaks: tuple[Break, ...] = field(parts(Break), default=())
    target: Target | None = field(
        part(Target, "Target.set_point(nodes), Target.path or Target.curve"), default=None, none="None"
    )
    control: ControlSpec | None = field(part(ControlSpec), default=None, none="None")
    duration: float = field(positive("s"), default=10.0)
    contact: Contact | None = field(
        part(Contact, "Contact(floor=0.0), Contact(rods=True) or both"), default=None, none="None"
    )
    motions: tuple[Motion, ...] = field(
        parts(Motion, "Motion.in_line, Motion.circular, Motion.data or Motion.by_function"), default=()
    )
    resistance: Resistance | None = field(part(Resistance), default=None, none="None")
    water: Water | None = field(part(Water), default=None, none="None")
    elements: tuple[Element, ...] = field(parts(Element, "objects of subclasses of Element"), default=())
    rope_start: RopeStart = field(choice(RopeStart), default=RopeStart.REST)
    start_time: float = field(not_negative("s"), default=0.0)

    __hash__ = None  # type: ignore[assignment]

    def __attrs_post_init__(self) -> None:
        if self.name == "":
            object.__setattr__(self, "name", self.structure.name)
        if self.structure.ropes:
            self._complete()
        check_scene(self)

    def _complete(self) -> None:
        """Ropes stand straight where a start has none of their nodes, and break at their first part."""
        structure = self.structure
        for what, base in (("initial_nodes", structure.positions), ("initial_velocities", 0 * structure.positions)):
            given = getattr(self, what)
            if given is not None:
                object.__setattr__(self, what, completed(structure, given, base))
        parts = {rope.string.name: rope.parts[0].name for rope in structure.ropes}
        breaks = (replace(event, string=parts.get(event.string, event.string)) for event in self.breaks)
        object.__setattr__(self, "breaks", tuple(breaks))

    def __repr__(self) -> str:
        structure = self.structure
        size = f"{len(structure.nodes)} nodes, {len(structure.rods)} rods, {len(structure.strings)} strings"
        law = f", law {self.control.law}" if self.control is not None else ""
        return f"<Scene {self.name!r}: {size}{law}, {self.duration:g} s>"

    def _repr_png_(self) -> bytes | None:
        """Draw the scene at the start, for notebooks; None where that fails: they show the text then."""
        return notebook_pictures.draw(self)

    @cached_property
    def nodes0(self) -> Array:
        """Node positions (N, 3) [m] at the start."""
        if self.initial_nodes is not None:
            return self.initial_nodes
        motions = self.motions
        return moved_positions(self.structure, motions, self.start_time) if motions else self.structure.positions

    @cached_property
    def velocities0(self) -> Array:
        """Node velocities (N, 3) [m/s] at the start."""
        if self.initial_velocities is not None:
            return self.initial_velocities
        still = np.zeros_like(self.nodes0)
        if not self.motions:
            return still
        found = velocities_with_supports(self.structure, self.nodes0, self.motions, time=self.start_time)
        return with_ropes(self.structure, found, still) if self.rope_start is RopeStart.INTERPOLATED else found

    @cached_property
    def redundancy(self) -> Redundancy:
        """Rods whose forces are not unique, and those that make the start singular."""
        return redundancy(self.structure, self.nodes0)

    @cached_property
    def water_segments(self) -> SegmentCount:
        """The segments of each rod, of a scene that has water: given, or chosen for its waves."""
        return segment_count(self)

    @cached_property
    def break_times(self) -> Array:
        """Times at which the strings break (M,) [s], ∞ for never."""
        times = {event.string: event.time for event in self.breaks}
        return np.array([times.get(string.name, np.inf) for string in self.structure.strings], float)

    @cached_property
    def effects(self) -> tuple[Element, ...]:
        """Effects on nodes other than strings and gravity, in the order in which forces add up."""
        loads = (NodalLoads(),) if callable(self.loads) or self.loads else ()
        resistance = () if self.resistance is None else self.resistance.elements
        nodal = (NodalDamping(),) if any(point.damping for point in self.structure.point_masses) else ()
        own = (ElasticRods(),) if self.structure.elastic.any() else ()
        return (*loads, *resistance, *nodal, *(() if self.water is None else (self.water,)), *self.elements, *own)

    @property
    def adding_mass(self) -> tuple[Element, ...]:
        """The effects that add mass to rods: none without rods, and none of water whose added_mass is 0."""
        return tuple(one for one in self.effects if one.adds_mass_to(self))

    def nodal_forces(self, time: float) -> Array:
        """External forces (N, 3) [N] at a time [s]; neither gravity nor resistance nor water is among them."""
        if callable(self.loads):
            return np.asarray(self.loads(time), float)
        forces = np.zeros((len(self.structure.nodes), 3))
        for load in self.loads:
            row = self.structure.node_index[load.node]
            forces[row] += np.array(load.force) * np.cos(load.angular_frequency * time + load.phase)
        return forces

    def moving(self, velocity: Vector = STILL, angular_velocity: Vector = STILL, center: Vector | None = None) -> Scene:
        """Return a copy that starts with a velocity of the whole added to its nodes', as `scene.whole` of a file does.

        Arguments are the fields of `Whole`; SceneError where supports, planes or fixed nodes do not let it move so.
        """
        return Whole(velocity=velocity, angular_velocity=angular_velocity, center=center).start(self)

    def with_(self, **changes: object) -> Scene:
        """A copy with some attributes changed; validated like a new one."""
        return replace(self, **changes)  # type: ignore[arg-type]
