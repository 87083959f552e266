"""Scenes: a structure and what one experiment needs of the world, and nothing else.

SI units; world frame right-handed, z up; arrays of node positions and velocities are (N, 3), rows in the
order of `Structure.node_names`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.elements.resistance import Bending, Drag, Resistance
from tensegrity_mj.model.elements.water import Water
from tensegrity_mj.model.elements.water_segments import SegmentCount, segment_count
from tensegrity_mj.model.elements.waves import Wave
from tensegrity_mj.model.events import Break, ControlSpec, Load, LoadFunction, _plain_load
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.moved_supports import moved_positions, velocities_with_supports
from tensegrity_mj.model.redundancy import Redundancy, redundancy
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target


@dataclass(frozen=True, eq=False)
class Scene:
    """One experiment with a structure.

    Attributes:
        structure: what moves.
        name, source: short name; where its numbers come from (thesis page, paper).
        gravity: g [m/s²]; zero by default.
        initial_nodes: (N, 3) [m] at t = 0; by default the structure's reference nodes, moved with their supports.
        initial_velocities: (N, 3) [m/s]; at rest by default, seen from the supports where these move.
        loads: external forces on nodes, either `Load`s or a function t -> (N, 3) [N].
        breaks: strings that break, each at its time.
        target: what a controller aims at.
        control: the law that the scene is run with unless another is given.
        duration: [s], what the scene is run for unless told otherwise.
        contact: what may touch: rods and a floor, rods and rods; None, the default, for nothing.
        motions: of supports that do not stand still, one a support.
        resistance: of a fluid against rods, and of joints against bending; None, the default, for none.
        water: with its surface at z = 0, waves and current; None, the default, for none.

    Raises:
        SceneError: on construction, if the motion stretches a rod, breaks a support, or does not fit.
    """

    structure: Structure
    name: str = ""
    source: str = ""
    gravity: Vector = (0.0, 0.0, 0.0)
    initial_nodes: Array | None = None
    initial_velocities: Array | None = None
    loads: tuple[Load, ...] | LoadFunction = ()
    breaks: tuple[Break, ...] = ()
    target: Target | None = None
    control: ControlSpec | None = None
    duration: float = 10.0
    contact: Contact | None = None
    motions: tuple[Motion, ...] = ()
    resistance: Resistance | None = None
    water: Water | None = None

    def __post_init__(self) -> None:
        from tensegrity_mj.basics.values import sequence_of
        from tensegrity_mj.model.scene_checks import check_scene

        if not callable(self.loads):
            object.__setattr__(self, "loads", sequence_of("loads", self.loads, SceneError))
        object.__setattr__(self, "breaks", sequence_of("breaks", self.breaks, SceneError))
        object.__setattr__(self, "motions", sequence_of("motions", self.motions, SceneError))
        for name in ("initial_nodes", "initial_velocities"):
            value = getattr(self, name)
            if value is not None:
                try:
                    value = np.array(value, float, order="C")  # compiled code reads them row by row
                except (TypeError, ValueError):
                    value = np.array([])  # check_scene reports the shape
                value.flags.writeable = False
                object.__setattr__(self, name, value)
        if self.name == "" and isinstance(self.structure, Structure):
            object.__setattr__(self, "name", self.structure.name)
        check_scene(self)
        x, y, z = (float(v) for v in self.gravity)
        object.__setattr__(self, "gravity", (x, y, z))
        object.__setattr__(self, "duration", float(self.duration))
        object.__setattr__(self, "breaks", tuple(Break(str(e.string), float(e.time)) for e in self.breaks))
        if self.contact is not None:
            object.__setattr__(self, "contact", _plain_contact(self.contact))
        if self.resistance is not None:
            object.__setattr__(self, "resistance", _plain_resistance(self.resistance))
        if self.water is not None:
            object.__setattr__(self, "water", _plain_water(self.water))
        if not callable(self.loads):
            object.__setattr__(self, "loads", tuple(_plain_load(load) for load in self.loads))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return False
        arrays = ("initial_nodes", "initial_velocities")
        plain = [item.name for item in fields(self) if item.name not in arrays]
        return all(getattr(self, a) == getattr(other, a) for a in plain) and all(
            _same_array(getattr(self, a), getattr(other, a)) for a in arrays
        )

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def nodes0(self) -> Array:
        """Node positions (N, 3) [m] at t = 0."""
        if self.initial_nodes is not None:
            return self.initial_nodes
        return moved_positions(self.structure, self.motions) if self.motions else self.structure.positions

    @cached_property
    def velocities0(self) -> Array:
        """Node velocities (N, 3) [m/s] at t = 0."""
        if self.initial_velocities is not None:
            return self.initial_velocities
        still = np.zeros_like(self.nodes0)
        return velocities_with_supports(self.structure, self.nodes0, self.motions) if self.motions else still

    @cached_property
    def redundancy(self) -> Redundancy:
        """Rods whose forces are not unique, and those that make the start singular."""
        return redundancy(self.structure, self.nodes0)

    @cached_property
    def water_segments(self) -> SegmentCount:
        """The segments of each rod, of a scene that has water: given, or chosen for its waves."""
        return segment_count(self)

    def nodal_forces(self, time: float) -> Array:
        """External forces (N, 3) [N] at a time [s]; neither gravity nor resistance nor water is among them."""
        if callable(self.loads):
            return np.asarray(self.loads(time), float)
        forces = np.zeros((len(self.structure.nodes), 3))
        for load in self.loads:
            row = self.structure.node_index[load.node]
            forces[row] += np.array(load.force) * np.cos(load.angular_frequency * time + load.phase)
        return forces

    def with_(self, **changes: object) -> Scene:
        """A copy with some attributes changed; validated like a new one."""
        return replace(self, **changes)  # type: ignore[arg-type]


def _plain_contact(contact: Contact) -> Contact:
    x, y, z = (float(v) for v in contact.normal)
    d0, d1, width, midpoint, power = (float(v) for v in contact.impedance)
    return Contact(
        None if contact.floor is None else float(contact.floor),
        (x, y, z),
        contact.rods,
        float(contact.friction),
        float(contact.stiffness),
        float(contact.damping),
        (d0, d1, width, midpoint, power),
    )


def _plain_resistance(resistance: Resistance) -> Resistance:
    x, y, z = (float(v) for v in resistance.wind)
    bending, drag = resistance.bending, resistance.drag
    if bending is not None:
        pairs = None if bending.pairs is None else tuple((str(a), str(b)) for a, b in bending.pairs)
        bending = Bending(float(bending.stiffness), float(bending.damping), pairs)
    if drag is not None:
        diameter = None if drag.diameter is None else float(drag.diameter)
        drag = Drag(float(drag.normal), float(drag.tangential), float(drag.density), diameter)
    return Resistance(float(resistance.viscous), bending, drag, (x, y, z))


def _plain_water(water: Water) -> Water:
    x, y, z = (float(v) for v in water.current)
    return Water(
        float(water.density),
        _plain(water.depth),
        tuple(_plain_wave(wave) for wave in water.waves),
        (x, y, z),
        float(water.drag),
        float(water.tangential_drag),
        float(water.added_mass),
        _plain(water.inertia),
        None if water.segments is None else int(water.segments),
        water.weights,
        _plain(water.diameter),
        water.above,
        float(water.viscosity),
    )


def _plain_wave(wave: Wave) -> Wave:
    length, frequency = _plain(wave.wavelength), _plain(wave.angular_frequency)
    return Wave(float(wave.amplitude), length, frequency, float(wave.direction), float(wave.phase))


def _plain(value: float | None) -> float | None:
    return None if value is None else float(value)


def _same_array(a: Array | None, b: Array | None) -> bool:
    return (a is None) == (b is None) and (a is None or b is None or np.array_equal(a, b))
