"""The rigid bar cable of the thesis' chapter 3: a hanging chain of rods whose top is moved by a carriage.

    scene = cable(elements=49)                  # in-line 0.5 Hz

The cable hangs along -z from the origin: a fastening arrangement, a rope and a load at its bottom. The thesis' in-line
excitation is along y, and its circular one in the xy plane.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import MOST_FOUND, check_nodes, instance, positive
from tensegrity_mj.basics.fields import field, function_of, refused, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cross import THESIS
from tensegrity_mj.model.elements.resistance import Bending, Drag, Resistance
from tensegrity_mj.model.members import Rod, Support
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.moved_supports import velocities_with_supports
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

# Table 3.1 and §3.3.3: lengths [m] and masses [kg].
FASTENING_LENGTH, FASTENING_MASS = 0.13, 0.0506
ROPE_LENGTH, ROPE_ELEMENTS, ROPE_ELEMENT_MASS = 2.75, 11, 0.0129
LOAD_LENGTH, LOAD_MASS = 0.05, 0.0513
ROPE_RADIUS, END_RADIUS = 0.003, 0.006  # the rope's from Table 3.1; the other one for pictures only
GRAVITY = 9.81  # m/s²
TOP = "rod1"  # the rod whose upper end is moved
IN_LINE, OUT_OF_PLANE, UP = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class RopeMass(enum.Enum):
    """Masses of the rope: the thesis prints two."""

    ELEMENTS = "elements"  # §3.3.3: eleven elements of 0.0129 kg, 0.1419 kg
    TABLE = "table"  # Table 3.1: 0.165 kg

    @property
    def kilograms(self) -> float:
        """Mass of the whole rope [kg]."""
        return ROPE_ELEMENTS * ROPE_ELEMENT_MASS if self is RopeMass.ELEMENTS else 0.165


class Excitation(enum.Enum):
    """Motions of the carriage."""

    IN_LINE = "in-line"  # along y
    CIRCULAR = "circular"  # in the xy plane
    NONE = "none"


class Start(enum.Enum):
    """Frames in which the cable is at rest at t = 0."""

    MOVING_FRAME = "moving frame"  # everything moves with the carriage
    LAB_FRAME = "lab frame"  # the carriage moves, all below it is still


def parts(elements: int) -> tuple[int, int]:
    """Return the numbers of elements of the fastening and of the rope; the load is the last one.

    As nearly as whole numbers can be in the proportion 1 : 11 of the thesis' models, which they are for 12 n + 1.
    """
    fastening = max(1, round((elements - 1) / 12))
    return fastening, elements - 1 - fastening


def arc_lengths(elements: int) -> Array:
    """Return the distance of each node down the cable (K + 1,) [m]."""
    fastening, rope = parts(elements)
    top = FASTENING_LENGTH * np.arange(fastening + 1) / fastening
    middle = FASTENING_LENGTH + ROPE_LENGTH * np.arange(1, rope + 1) / rope
    along = np.concatenate([top, middle, [FASTENING_LENGTH + ROPE_LENGTH + LOAD_LENGTH]])
    return np.round(along, 14)  # sums of printed decimals without their round-off


@value("cable", OptionError, positional=1)
class Cable:
    """A chain of rods that hangs from a moved point.

    Attributes:
        elements: K, 3 or more: those of the fastening and the rope, and the load. 13 is that of §3.3.3, and
            25, 37, ... 121 are those of §3.5.1.
        rope_mass: 0.1419 kg as printed by elements, or the 0.165 kg of Table 3.1.
        excitation: motion of the top, unless a motion is given.
        amplitude: amplitude of the excitation [m]: half its peak-to-peak, or the circle's radius.
        frequency: frequency of the excitation [Hz].
        motion: any motion of the top instead, `Motion...("rod1", ...)`.
        start: the frame in which the cable is at rest at t = 0.
        seed: [rad] by which the straight cable leans out of the plane of the excitation at the start, towards x.
        planar: rods that stay in the plane x = 0; the excitation and the start must, too.
        viscous: c [N s/m²], a force -c v per length.
        bending_stiffness, bending_damping: [N m], [N m s] of each joint: those of a rope [N m²], [N m² s] over the
            length of an element.
        drag: coefficient of the quadratic drag of still air, on the elements' diameters.
        gravity: [m/s²].
        duration: [s].
        name: name of scene and structure.

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """

    elements: int = field(kinds.whole(3), default=13)
    rope_mass: RopeMass = RopeMass.ELEMENTS
    excitation: Excitation = Excitation.IN_LINE
    amplitude: float = field(None, default=0.05)  # checked where there is an excitation
    frequency: float = field(None, default=0.5)
    motion: Motion | None = field(None, default=None)
    start: Start = Start.MOVING_FRAME
    seed: float = field(kinds.finite("rad"), default=0.0)
    planar: bool = False
    viscous: float = field(kinds.not_negative("N s/m²"), default=0.0)
    bending_stiffness: float = field(kinds.not_negative("N m"), default=0.0)
    bending_damping: float = field(kinds.not_negative("N m s"), default=0.0)
    drag: float = field(kinds.not_negative(), default=0.0)
    gravity: float = field(kinds.positive("m/s²"), default=GRAVITY)
    duration: float = 45.0
    name: str = "cable"

    def __call__(self) -> Scene:
        check_nodes("cable: elements", self.elements, self.elements + 1, MOST_FOUND)
        if self.planar and self.seed:
            raise refused(self, f"seed = {self.seed!r} rad leaves the plane that a planar cable stays in: leave it out")
        motions = _motions(self.excitation, self.amplitude, self.frequency, self.motion, self.planar)
        structure = _structure(self.elements, self.rope_mass, self.planar, self.name)
        along = arc_lengths(self.elements)
        nodes = None
        if self.seed:
            first = motions[0].at(0.0)[0] if motions else np.zeros(3)
            nodes = first + np.outer(along, [math.sin(self.seed), 0.0, -math.cos(self.seed)])
        resistance = _resistance(self.viscous, self.bending_stiffness, self.bending_damping, self.drag)
        more = {"initial_nodes": nodes, "motions": motions, "resistance": resistance}
        scene = scene_of(self, structure, f"{THESIS}, section 3.3, pages 66-69", **more)
        if self.start is Start.MOVING_FRAME or not motions:
            return scene
        still = np.zeros_like(scene.nodes0)
        still[0] = motions[0].at(0.0)[1]
        return scene.with_(initial_velocities=velocities_with_supports(structure, scene.nodes0, motions, still))


cable = function_of(Cable)


def scene_of(family: Any, structure: Structure, source: str, **more: Any) -> Scene:
    """The scene of a structure, with the fields `name`, `gravity` and `duration` of its family."""
    gravity = (0.0, 0.0, -family.gravity)
    return Scene(structure, name=family.name, source=source, gravity=gravity, duration=family.duration, **more)


def _resistance(viscous: float, stiffness: float, damping: float, drag: float) -> Resistance | None:
    bending = None if (stiffness, damping) == (0.0, 0.0) else Bending(stiffness, damping)
    found = Resistance(viscous, bending, None if drag == 0.0 else Drag(drag))
    return None if found == Resistance() else found


def _motions(
    excitation: Excitation, amplitude: float, frequency: float, motion: Motion | None, planar: bool
) -> tuple[Motion, ...]:
    if motion is not None:
        instance("cable: motion", motion, Motion, f"use Motion.in_line('{TOP}', ...) or another of its makers")
        if motion.support != TOP:
            raise OptionError(f"cable: the motion is that of '{motion.support}'; it must be that of '{TOP}'")
        return (motion,)
    if excitation is Excitation.NONE:
        return ()
    size = positive("cable: amplitude", amplitude, "m")
    hertz = positive("cable: frequency", frequency, "Hz")
    if excitation is Excitation.IN_LINE:
        return (Motion.in_line(TOP, size, hertz, IN_LINE),)
    if planar:
        raise OptionError("cable: a circular excitation leaves the plane of a planar cable; use an in-line one")
    return (Motion.circular(TOP, size, hertz, UP),)


def chain(
    name: str,
    places: ArrayLike,
    masses: Sequence[float],
    radii: Sequence[float],
    held: Mapping[int, Support],
    free: Support,
) -> Structure:
    """Rods rod1, rod2, ... between nodes n0, n1, ... at places (K + 1, 3) [m]; those that are not held are free."""
    return Structure(
        name=name,
        nodes={f"n{k}": place for k, place in enumerate((np.asarray(places) + 0.0).tolist())},  # no -0.0
        rods=tuple(
            Rod(f"rod{k + 1}", (f"n{k}", f"n{k + 1}"), mass, radius, held.get(k, free))
            for k, (mass, radius) in enumerate(zip(masses, radii, strict=True))
        ),
    )


def _structure(elements: int, rope_mass: RopeMass, planar: bool, name: str) -> Structure:
    fastening, rope = parts(elements)
    masses = [FASTENING_MASS / fastening] * fastening
    # Take the printed value where the elements are those of §3.3.3, without the round-off of a sum and a division.
    printed = rope_mass is RopeMass.ELEMENTS and rope == ROPE_ELEMENTS
    masses += [ROPE_ELEMENT_MASS if printed else rope_mass.kilograms / rope] * rope + [LOAD_MASS]
    plane = OUT_OF_PLANE if planar else None
    radii = [END_RADIUS] * fastening + [ROPE_RADIUS] * rope + [END_RADIUS]
    places = np.outer(arc_lengths(elements), [0.0, 0.0, -1.0])
    return chain(name, places, masses, radii, {0: Support.pinned(0.0, plane)}, Support.free(0.0, plane))
