"""Water around the rods of a scene: Morison's loads on segments, continuous through the surface (thesis, §7.2.2).

The still surface is z = 0, z upwards. A rod is cut into L equal segments. Of each, the part under water is found, and
at its centre, with the velocity v and the acceleration a of the water there and those of the rod, v_s and a_s, act

    inertia     m_w P (C_M a - C_a a_s)              added mass (7.7) and Froude-Krylov (7.8), C_M = 1 + C_a
    drag        ½ ρ C_d d |P u| P u                  (7.9), u = v - v_s: the cross-flow principle
                ½ ρ C_t π d |u∥| u∥                  along the rod, which the thesis leaves out
    buoyancy    -m_w g                               (7.10); the weight of rods is the scene's gravity

per length, P taking what is across the rod and m_w = ρ π d²/4 times the part under water. That part is the volume of a
round cylinder below the surface, which is taken for a plane between the ends of a segment, over the volume of the
segment: with u = (ζ - z) / (½ d cos φ) along the axis of a rod that is inclined by φ, a cross-section at u is wet by

    w(u) = ½ + (asin u + u √(1 - u²)) / π,  0 below -1 and 1 above 1,

which is integrated along the segment, with its first moment for the place where the loads act, to 1e-10 where a segment
that is all but level just touches the surface, and to round-off, 1e-16/|Δu|, elsewhere. Loads act on the axis: the
couple of a buoyancy off the axis, (d/ℓ)² of those that are kept, is left out as are end caps.

The loads of a segment at the distance s ℓ from the first node go to the two nodes with weights that add up to one:
1 - s and s, which keep force and moment of a rigid rod, or the thesis' (7.11)-(7.12), those of a clamped beam. Segments
are taken at their centres: moments of what turns a rod are off by 1/L² of themselves, and loads of waves by no more
than `water_segments` states, which also chooses L.

Added mass is implicit: the accelerations a_i of the nodes of each rod are found with it, as the forces

    F_i = F_i⁰ - Σ_j α_ij P a_j,   α_ij = Σ_segments C_a m_w Δ h_i(s) n_j(s),   n = (1 - s, s), h the weights,

so that every engine solves the same linear equations for each rod (`native.water`).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, not_negative, part, parts, positive, vector, whole
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.elements.resistance import gauss_rule
from tensegrity_mj.model.elements.waves import AboveLevel, IrregularSea, Sea, Wave
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.rods import diameters

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene

MOST_SEGMENTS = 1000  # that may be given
AT_ONCE = 200_000  # waves at segments

# Of u, between the ends of a segment: below it, round-off of differences is more than the error of three points in u.
NEARLY_LEVEL = 1e-5
LEAST_COSINE = 1e-6  # of the inclination φ: a vertical rod is wet up to the surface, within this part of its radius
ANGLES, ANGLE_WEIGHTS = gauss_rule(12)
GAUSS_POINTS, GAUSS_WEIGHTS = gauss_rule(3)


class Weights(enum.Enum):
    """Rule by which loads on a rod are shared between its two nodes."""

    RIGID = "rigid"  # 1 - s and s: a rigid rod's, with the same force and the same moment
    HERMITE = "hermite"  # (7.11)-(7.12): a clamped beam's, as the thesis has it; along the rod, one half each


@value("water")
class Water(Element):
    """Water, waves and current, and how they load rods.

    Attributes:
        density: ρ [kg/m³], > 0.
        depth: h [m], > 0; None for deep water.
        waves: components, superposed.
        current: [m/s], everywhere the same.
        drag: C_d >= 0, on the diameter, across rods.
        tangential_drag: C_t >= 0, on the circumference, along rods.
        added_mass: C_a >= 0.
        inertia: C_M >= 0; None for 1 + C_a, added mass and Froude-Krylov together.
        segments: L of each rod, >= 1; None for as many as its waves need, at least 5, see `water_segments`.
        weights: see `Weights`.
        diameter: d [m] of every rod, > 0; None for twice each rod's own radius.
        above: the waves' fields above the still surface, see `AboveLevel`.
        viscosity: kinematic, ν [m²/s], > 0, of which Reynolds numbers are made and nothing else; sea water at 15 °C.
        sea: an irregular sea, superposed on the waves; None for none.
        string_diameter: d [m] of every string, > 0, by which each piece of its path takes drag as a rod does, straight
            where it is slack, too; None for no loads on strings. They have neither buoyancy nor added mass.
    """

    density: float = field(positive("kg/m³"), default=1025.0)
    depth: float | None = field(positive("m"), default=None, none="None for deep water")
    waves: tuple[Wave, ...] = field(parts(Wave, "Wave(amplitude, wavelength=... or angular_frequency=...)"), default=())
    current: Vector = field(vector("m/s"), default=(0.0, 0.0, 0.0))
    drag: float = field(not_negative(), default=1.2)
    tangential_drag: float = field(not_negative(), default=0.0)
    added_mass: float = field(not_negative(), default=1.0)
    inertia: float | None = field(not_negative(), default=None, none="None for 1 + added_mass")
    segments: int | None = field(whole(1, MOST_SEGMENTS), default=None, none="None for as many as the waves need")
    weights: Weights = field(choice(Weights), default=Weights.RIGID)
    diameter: float | None = field(positive("m"), default=None, none="None for twice each rod's radius")
    above: AboveLevel = field(choice(AboveLevel), default=AboveLevel.EXPONENTIAL)
    viscosity: float = field(positive("m²/s"), default=1.19e-6)
    sea: IrregularSea | None = field(part(IrregularSea), default=None, none="None")
    string_diameter: float | None = field(positive("m"), default=None, none="None for no loads on strings")

    adds_mass = True
    vectorized = True
    compiled = "tensegrity_mj.dynamics.native.water:pack_water"
    arrays = "tensegrity_mj.engines.jax.water:water"
    label = "water"

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        """(7.9)-(7.10) share loads as velocities are shared; Hermite's weights do not."""
        return self.weights is Weights.RIGID

    def adds_mass_to(self, scene: Scene) -> bool:
        """Return whether there are rods and C_a > 0."""
        return self.added_mass > 0 and super().adds_mass_to(scene)

    def act(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
        """F⁰, see `water_forces`."""
        return water_forces(scene, time, nodes, velocities)[0]

    def alpha(self, scene: Scene, time: Array | float, nodes: Array) -> Array:
        """α, see `water_forces`."""
        return water_forces(scene, time, nodes, np.zeros_like(nodes))[1]

    @property
    def components(self) -> tuple[Wave, ...]:
        """The waves and those of the sea."""
        return self.waves if self.sea is None else (*self.waves, *self.sea.waves)

    @property
    def inertia_coefficient(self) -> float:
        """C_M."""
        return 1 + self.added_mass if self.inertia is None else self.inertia


def sea_of(scene: Scene) -> Sea:
    """The waves and the current of a scene that has water."""
    water = scene.water
    assert water is not None
    return Sea.of(water.components, -scene.gravity[2], water.depth, water.current, water.above)


def wet_parts(first: Array, second: Array) -> tuple[Array, Array]:
    """Compute the part of a segment under water, and the centre of that part as a part of the way along the segment.

    With u = sin θ the integrals are of trigonometric functions, which Gauss' rule of twelve points has to 1e-13.

    Args:
        first, second: u at the two ends of the segment, depth of the axis over ½ d cos φ; they broadcast.
    """
    first, second = np.broadcast_arrays(np.asarray(first, float), np.asarray(second, float))
    step = second - first
    level = np.abs(step) < NEARLY_LEVEL
    size = np.where(level, 1.0, step)
    start, end = np.arcsin(np.clip(first, -1, 1)), np.arcsin(np.clip(second, -1, 1))
    part, moment = np.zeros_like(step), np.zeros_like(step)
    for point, weight in zip(ANGLES, ANGLE_WEIGHTS, strict=True):
        angle = start + point * (end - start)
        wet = weight * (end - start) / size * np.cos(angle) * (0.5 + (angle + np.sin(angle) * np.cos(angle)) / np.pi)
        part, moment = part + wet, moment + wet * (np.sin(angle) - first) / size
    # The length wholly under water, u > 1, at one end.
    low = np.where(first > 1, 0.0, np.clip((1 - first) / size, 0, 1))
    high = np.where(second > 1, 1.0, np.clip((1 - first) / size, 0, 1))
    sunk = np.where((first > 1) | (second > 1), high - low, 0.0)
    part, moment = part + sunk, moment + 0.5 * sunk * (low + high)
    near_part, near_moment = np.zeros_like(step), np.zeros_like(step)
    for point, weight in zip(GAUSS_POINTS, GAUSS_WEIGHTS, strict=True):
        wet = weight * wetness(first + point * step)
        near_part, near_moment = near_part + wet, near_moment + point * wet
    part, moment = np.where(level, near_part, part), np.where(level, near_moment, moment)
    return part, np.where(part > 0, moment / np.where(part > 0, part, 1.0), 0.5)


def wetness(u: Array) -> Array:
    """w(u), of one cross-section."""
    x = np.clip(u, -1.0, 1.0)
    return np.asarray(0.5 + (np.arcsin(x) + x * np.sqrt(1 - x * x)) / np.pi)


def shares(weights: Weights, s: Array) -> tuple[Array, Array]:
    """h_1 and h_2: the parts of a load at the place s that the first and the second node take."""
    second = s if weights is Weights.RIGID else s * s * (3 - 2 * s)
    return 1 - second, second


@dataclass(frozen=True, eq=False)
class Segments:
    """The wet parts of all segments of all rods, (..., R, L) each, vectors (..., R, L, 3).

    Attributes:
        part: under water, of each segment.
        place: s of its centre, along the rod.
        points: that centre [m]; of a dry segment, its height is at most 0.
        axes: (..., R, 1, 3) unit vectors of the rods.
        flow: velocity of the water against the rod there, u [m/s].
        undisturbed: velocity of the water there, v [m/s].
        acceleration: of the water there, a [m/s²].
    """

    part: Array
    place: Array
    points: Array
    axes: Array
    flow: Array
    undisturbed: Array
    acceleration: Array


def samples_at_once(scene: Scene) -> int:
    """Samples of a run whose segments, with all waves there, are held in memory together."""
    assert scene.water is not None
    strings = 0 if scene.water.string_diameter is None else len(scene.structure.paths.nodes)
    members = max(1, len(scene.structure.rods), strings)
    each = members * scene.water_segments.count * max(1, len(scene.water.components))
    return max(1, AT_ONCE // each)


def segments_of(scene: Scene, time: Array | float, nodes: Array, velocities: Array, strings: bool = False) -> Segments:
    """The wet parts of segments at times (...) [s], positions and velocities (..., N, 3) that go with them.

    Of rods, or of strings: R are then the pieces of their paths.
    """
    water, structure, sea = scene.water, scene.structure, sea_of(scene)
    assert water is not None
    pairs, count = structure.paths.nodes if strings else structure.rod_nodes, scene.water_segments.count
    d = np.full(len(pairs), water.string_diameter) if strings else diameters(structure, water.diameter)
    x1, v1 = nodes[..., pairs[:, 0], None, :], velocities[..., pairs[:, 0], None, :]
    span, turn = nodes[..., pairs[:, 1], None, :] - x1, velocities[..., pairs[:, 1], None, :] - v1
    t = np.asarray(time, float)[..., None, None]
    size = np.linalg.norm(span, axis=-1, keepdims=True)
    axes = np.divide(span, size, out=np.zeros_like(span), where=size > 0)  # a slack string's ends may meet
    cuts = x1 + (np.arange(count + 1) / count)[:, None] * span
    depth = sea.elevation(t, cuts[..., 0], cuts[..., 1]) - cuts[..., 2]
    half = 0.5 * d[:, None] * np.maximum(np.hypot(axes[..., 0], axes[..., 1]), LEAST_COSINE)
    part, along = wet_parts(depth[..., :-1] / half, depth[..., 1:] / half)
    place = (np.arange(count) + along) / count
    points = x1 + place[..., None] * span
    # Of a dry segment nothing counts, but high above the water the fields are beyond all floats.
    points[..., 2] = np.where(part > 0, points[..., 2], np.minimum(points[..., 2], 0.0))
    undisturbed = sea.velocity(t, points)
    flow = undisturbed - v1 - place[..., None] * turn
    return Segments(part, place, points, axes, flow, undisturbed, sea.acceleration(t, points))


def water_forces(scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> tuple[Array, Array]:
    """Compute the forces of the water apart from its reaction to the rods' accelerations, and that reaction.

    Args:
        scene: any; without water, all is zero.
        time: (...) [s].
        nodes, velocities: (..., N, 3) [m], [m/s].

    Returns:
        F⁰ (..., N, 3) [N] on the nodes, and α (..., R, 2, 2) [kg] of the rods; the whole is F_i⁰ - Σ_j α_ij P a_j.
    """
    structure, out = scene.structure, np.zeros_like(nodes)
    alpha = np.zeros((*nodes.shape[:-2], len(structure.rods), 2, 2))
    if scene.water is None:
        return out, alpha
    found = []
    if len(structure.rods):
        loads, alpha = rod_loads(scene, time, nodes, velocities)
        found.append((structure.rod_nodes, loads))
    if scene.water.string_diameter is not None:
        found.append((structure.paths.nodes, string_loads(scene, time, nodes, velocities)))
    for pairs, loads in found:
        for end in range(2):
            for row, pair in enumerate(pairs):
                out[..., pair[end], :] += loads[..., row, end, :]
    return out, alpha


def rod_loads(scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> tuple[Array, Array]:
    """Compute F⁰ (..., R, 2, 3) [N] on each rod's ends, and α, as `water_forces`, in a scene with water and rods."""
    water, structure = scene.water, scene.structure
    assert water is not None
    wet = segments_of(scene, time, nodes, velocities)
    d = diameters(structure, water.diameter)[:, None]
    length = structure.rod_lengths[:, None] / scene.water_segments.count
    mass = water.density * np.pi * d**2 / 4 * length * wet.part
    drag, friction = _drag(water, wet, 0.5 * water.density * d * length * wet.part)
    gravity = np.array(scene.gravity)
    normal = (water.inertia_coefficient * mass)[..., None] * _across(wet, wet.acceleration)
    normal += drag
    normal -= mass[..., None] * _across(wet, gravity)
    axial = friction - mass * np.sum(gravity * wet.axes, axis=-1)
    linear, weights = (1 - wet.place, wet.place), shares(water.weights, wet.place)
    shared = [[np.sum(water.added_mass * mass * own * other, axis=-1) for other in linear] for own in weights]
    return _at_ends(water, wet, normal, axial), np.stack([np.stack(row, axis=-1) for row in shared], axis=-2)


def string_loads(scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
    """(..., S, 2, 3) [N]: drag at the ends of each piece of the strings' paths, of a scene whose strings take it."""
    water = scene.water
    assert water is not None
    assert water.string_diameter is not None
    wet = segments_of(scene, time, nodes, velocities, strings=True)
    length = np.linalg.norm(scene.structure.paths.spans(nodes), axis=-1)[..., None] / scene.water_segments.count
    surface = 0.5 * water.density * water.string_diameter * length * wet.part
    return _at_ends(water, wet, *_drag(water, wet, surface))


def _across(wet: Segments, v: Array) -> Array:
    """P v."""
    return np.asarray(v - np.sum(v * wet.axes, axis=-1, keepdims=True) * wet.axes)


def _drag(water: Water, wet: Segments, surface: Array) -> tuple[Array, Array]:
    """(7.9) of segments: across them (..., 3), and along them."""
    flow, slip = _across(wet, wet.flow), np.sum(wet.flow * wet.axes, axis=-1)
    across = (water.drag * surface * np.linalg.norm(flow, axis=-1))[..., None] * flow
    return across, water.tangential_drag * np.pi * surface * np.abs(slip) * slip


def _at_ends(water: Water, wet: Segments, normal: Array, axial: Array) -> Array:
    """(..., R, 2, 3): loads on segments, across and along them, shared between the two ends of their members."""
    weights = shares(water.weights, wet.place)
    along = weights if water.weights is Weights.RIGID else (np.full_like(wet.place, 0.5),) * 2
    loads = [
        np.sum(weights[end][..., None] * normal + (along[end] * axial)[..., None] * wet.axes, axis=-2)
        for end in range(2)
    ]
    return np.stack(loads, axis=-2)


def check_water(scene: Scene) -> None:
    """Raise SceneError unless a scene's water fits its structure and its gravity."""
    water, structure = scene.water, scene.structure
    assert water is not None
    drags = water.string_diameter is not None
    if not structure.rods and not (drags and structure.strings):
        raise refused(
            water,
            f"structure '{structure.name}' has no rod, and water loads rods, and strings by their string_diameter: "
            "leave water out",
        )
    if drags and scene.breaks:
        raise refused(water, "strings that break would go on taking drag: leave string_diameter or the breaks out")
    x, y, z = scene.gravity
    if x or y or z > 0:
        raise refused(
            water,
            f"gravity = {scene.gravity!r}; the still surface is z = 0, so that gravity must be (0, 0, -g) with g >= 0: "
            "turn the scene",
        )
    if water.components and z == 0:
        raise refused(water, "there are waves without gravity, which makes them: give the scene gravity (0, 0, -g)")
