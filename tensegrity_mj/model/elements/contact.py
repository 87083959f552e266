"""Contact in a scene: of rods with a floor and with each other, and their distances.

A rod's surface for contact is its capsule: the cylinder of the rod's radius from node to node, and a half ball of that
radius beyond each node. A point mass touches the floor with its very point, and no rod. Strings touch nothing, and
rods that share a node do not touch each other.

The force is MuJoCo's soft contact. Where two surfaces are r < 0 apart, so that they overlap by -r, and close at the
rate v = dr/dt, the contact's own acceleration is a mean of the one without the contact, a⁰, and a damped spring's,

    a = (1 - d) a⁰ + d (-b v - k r),    b = damping / d₁,    k = stiffness d / d₁²,

in so far as the force does not pull; d = d(r) is the impedance, from d₀ at touch to d₁ at the depth `width`. The force
follows from the mass that the contact feels, so that heavy and light structures bounce alike. See docs/contact.md.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, bisect, unit
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import choice, direction, each, flag, many, number, pair, part, within
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.model.elements.terrain import Terrain
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.rods import total_mass
from tensegrity_mj.model.structure import Structure

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene


SHARE = within(1e-4, 0.9999)
# Friction resists sliding this many times harder than a contact resists depth: what sticks hardly creeps.
FRICTION_IMPEDANCE = 100.0
FRICTION = number("0, or within [1e-5, 1e5]", lambda x: x == 0 or 1e-5 <= x <= 1e5)
# The depth over which a contact becomes hard, by default: to which it stops this speed [m/s]. In proportion to
# 1/√stiffness, as all depths of a landing are; where it stays as it is, a harder floor comes no nearer to a rigid one.
SOFTENED_SPEED = 0.2


class Spin(enum.Enum):
    """Turning of rods about their own axes."""

    HELD = "held"  # strings hinder it: what friction does about the axis of a rod has no effect
    FREE = "free"  # against the axial moment of inertia of the rod's section, a solid cylinder's without one


class Spring(NamedTuple):
    """Stiffness [1/s²], damping [1/s] and impedance of a contact, as its law has them."""

    stiffness: float
    damping: float
    impedance: tuple[float, float, float, float, float]


class ContactLaw(enum.Enum):
    """Law of friction."""

    MUJOCO = "mujoco"  # MuJoCo's convex one: what slides is pushed away from the floor by μ times its damping
    # In the DAE alone: friction against the slip, of μ times the normal force that there is without it.
    COULOMB = "coulomb"


@value("contact")
class Contact:
    """Contacts in a scene and their stiffness. MuJoCo has all of it, the DAE that of rods, and points on a plane.

    The stiffness is the one number that says how hard contacts are: damping and impedance follow from it where they are
    not given (`spring` has all three). The default has a time constant of 2.5 ms: a body that lands at 2 m/s sinks in
    by some 2 mm and hardly bounces. MuJoCo's (timeconst τ, dampratio ζ) are the stiffness 1 / (τ ζ)² and the damping
    2 / τ. With ζ = 1 RK4 resolves a landing with steps up to τ / 10, the other integrators up to τ / 100; a run with a
    larger one says so before it starts (`contact_steps` has it for all ζ).

    Attributes:
        floor: height of the floor along `normal` [m]: bodies stay where normal · x >= floor. None for no floor. Nodes
            that supports keep from moving along the normal do not touch a plane floor.
        normal: of the floor, upwards; of any length but zero.
        terrain: heights above the level of the floor, whose normal is then z; None for a floor that is a plane.
        rods: whether rods touch each other, those that share a node excepted.
        exclude: pairs of names of rods that do not touch each other either, such as diagonals that cross.
        friction: Coulomb's coefficient of sliding friction, within [1e-5, 1e5]; 0 for none.
        torsion: of friction that resists a turn about the contact's normal [m]: its torque by the normal force, about
            2/3 of the radius of what touches times `friction`. 0 for none.
        rolling: of friction that resists rolling [m]: its torque by the normal force. 0 for none.
        stiffness: [1/s²], > 0 and at most 1e12: force by depth, on the mass that the contact feels.
        damping: [1/s], within [0, 1e7]: force by speed, likewise. None for critical damping, 2 √stiffness.
        impedance: (d₀, d₁, width [m], midpoint, power) of d(r): it grows from d₀ at touch to d₁ >= d₀ at the depth
            `width`, on an S of this power, half way at the midpoint. MuJoCo's solimp. d₀, d₁ and midpoint are within
            [0.0001, 0.9999], the width is at least 1e-9 m, the power within [1, 50]. None for (0.01, 0.95,
            0.2 m/s / √stiffness, 0.5, 2).
        law: see `ContactLaw`.
        spin: whether rods turn about their own axes, a `Spin` or its text.

    Raises:
        SceneError: beyond these ranges. MuJoCo would take other values silently; or overflow, as (midpoint)^(1 -
            power) may; or reach an acceleration of more than 1e10 m/s², which it takes for a divergence, at a depth of
            1 cm or a speed of 1 km/s.
    """

    floor: float | None = field(number("a finite height [m]", lambda x: True), default=None, none="None for no floor")
    normal: Vector = field(direction(), default=(0.0, 0.0, 1.0))
    rods: bool = field(flag(), default=False)
    friction: float = field(FRICTION, default=0.6)
    stiffness: float = field(number("> 0 and at most 1e12 [1/s²]", lambda x: 0 < x <= 1e12), default=1.6e5)
    damping: float | None = field(
        number("within [0, 1e7] [1/s]", lambda x: 0 <= x <= 1e7), default=None, none="None for critical damping"
    )
    impedance: tuple[float, float, float, float, float] | None = field(
        each(
            "five numbers [d0, d1, width, midpoint, power]",
            d0=SHARE,
            d1=SHARE,
            width=number("at least 1e-9 m", lambda x: x >= 1e-9),
            midpoint=SHARE,
            power=within(1, 50),
        ),
        default=None,
        none="None for what follows from the stiffness",
    )
    torsion: float = field(FRICTION, default=0.0)
    rolling: float = field(FRICTION, default=0.0)
    exclude: tuple[tuple[str, str], ...] = field(many(pair("rod"), "pairs of rods"), default=())
    law: ContactLaw = field(choice(ContactLaw), default=ContactLaw.MUJOCO)
    terrain: Terrain | None = field(part(Terrain, "Ramp, Stairs, Rough or Heights"), default=None, none="None")
    spin: Spin = field(choice(Spin), default=Spin.HELD)

    def __attrs_post_init__(self) -> None:
        d0, d1, *_ = self.spring.impedance
        if d1 < d0:
            raise refused(
                self,
                f"impedance: d1 = {d1:g} at the depth `width` is below d0 = {d0:g} at touch; a contact that softens as "
                "it is pressed may give energy: make d1 at least d0",
            )
        if self.friction == 0 and (self.torsion or self.rolling):
            raise refused(
                self,
                f"torsion = {self.torsion:g} m and rolling = {self.rolling:g} m, but friction = 0: what slides freely "
                "has neither; give friction, or leave them out",
            )
        if self.terrain is not None and (self.floor is None or self.up[2] != 1.0):
            raise refused(
                self,
                f"terrain: with floor = {self.floor} and normal = {list(self.normal)}; heights are along z above the "
                "level of a floor: give its height, and no other normal",
            )

    @property
    def spring(self) -> Spring:
        """Stiffness, damping and impedance, with what follows from the stiffness where it is not given."""
        rate = self.stiffness**0.5
        damping = 2 * rate if self.damping is None else self.damping
        return Spring(self.stiffness, damping, self.impedance or (0.01, 0.95, SOFTENED_SPEED / rate, 0.5, 2.0))

    @property
    def up(self) -> Array:
        """The floor's unit normal (3,)."""
        return unit(np.array(self.normal, float))


def holds_spin(scene: Scene) -> bool:
    """Return whether a scene has contact that holds rods from turning about their own axes.

    Without friction nothing turns them: normal forces pass through the axis.
    """
    contact = scene.contact
    turning = any(rod.support.plane is None and rod.stiffness is None for rod in scene.structure.rods)
    return contact is not None and contact.spin is Spin.HELD and contact.friction > 0 and turning


HELD = 3e-5  # of a unit normal along what moves: supports hold the node, which a force would move by 1e-9 of the free
MOST_BALLS = 10_000  # along a rod, that are held against uneven ground together
MOST_CROSSING = 6  # pairs of rods that a message names
PIECE = 1_000_000  # pairs of boxes that are checked together


def floor_gaps(structure: Structure, contact: Contact, nodes: Array) -> Array:
    """(N,) [m]: how far each node's ball is above the floor, negative inside it; ∞ of what touches none."""
    radii = np.full(len(structure.nodes), np.nan)
    if contact.floor is None:
        return np.full(len(radii), np.inf)
    for rod, ends in zip(structure.rods, structure.rod_nodes, strict=True):
        radii[ends] = np.fmax(radii[ends], rod.radius)
    radii[[structure.node_index[point.node] for point in structure.lone_masses]] = 0.0
    radii[held_nodes(structure, contact)] = np.nan
    return np.where(np.isfinite(radii), _clearance(contact, nodes, radii), np.inf)


def held_nodes(structure: Structure, contact: Contact | None) -> NDArray[np.bool_]:
    """(N,): which nodes supports keep from moving along the normal of a plane floor; these do not touch it."""
    found = np.zeros(len(structure.nodes), bool)
    if contact is None or contact.floor is None or contact.terrain is not None:
        return found

    def kept(basis: Array) -> bool:
        return bool(np.linalg.norm(basis.T @ contact.up) < HELD)

    for rod, ends in zip(structure.rods, structure.rod_nodes, strict=True):
        support = rod.support
        if kept(support.translation_basis):
            found[ends] |= kept(support.rotation_basis) or np.abs(support.sigma - np.arange(2)) < HELD
    for point in structure.lone_masses:
        found[structure.node_index[point.node]] |= kept(point.translation_basis)
    return found


def _clearance(contact: Contact, centres: Array, radii: Array) -> Array:
    """Heights (P,) [m] of balls above the floor, along its normal."""
    assert contact.floor is not None
    if contact.terrain is None:
        return np.asarray(centres @ contact.up - contact.floor - radii)
    return contact.terrain.clearance(centres - contact.floor * contact.up, radii)


def rod_gaps(structure: Structure, nodes: Array) -> tuple[NDArray[np.int64], Array]:
    """Pairs of rods (P, 2) that may touch, and how far apart their surfaces are (P,) [m], negative where they overlap.

    The pairs are those whose boxes along the axes touch, all others being apart, and that share no node.
    """
    start, end = nodes[structure.rod_nodes[:, 0]], nodes[structure.rod_nodes[:, 1]]
    radii = np.array([rod.radius for rod in structure.rods], float)
    low, high = np.minimum(start, end) - radii[:, None], np.maximum(start, end) + radii[:, None]
    found: list[tuple[NDArray[np.int64], Array]] = []
    for first, second in touching_boxes(low, high):
        free = ~sharing(structure.rod_nodes[first], structure.rod_nodes[second])
        first, second = first[free], second[free]
        apart = segment_distances(start[first], end[first], start[second], end[second])
        found.append((np.stack([first, second], axis=1), apart - radii[first] - radii[second]))
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *(pairs for pairs, _ in found)])
    gaps = np.concatenate([np.zeros(0), *(gaps for _, gaps in found)])
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    return pairs[order], gaps[order]


def sharing(first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which pairs (P,) of elements share a node; the nodes of each are (P, 2)."""
    return np.asarray((first[:, :, None] == second[:, None, :]).any(axis=(1, 2)))


def touching_boxes(low: Array, high: Array) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Pairs of boxes from `low` to `high` (B, 3) that touch, each once with the lower number first, in pieces.

    Boxes are swept along the axis on which fewest overlap: boxes that lie side by side take time in proportion
    to their number, and pieces keep memory small however many overlap.
    """
    if len(low) < 2:
        return
    counts = []
    for axis in range(3):
        begins = np.sort(low[:, axis])
        counts.append(int(np.searchsorted(begins, high[:, axis], side="right").sum()))
    axis = int(np.argmin(counts))
    order = np.argsort(low[:, axis], kind="stable")
    low, high = low[order], high[order]
    # Those that begin before a box ends, and after it in the order, overlap it along this axis.
    ends = np.searchsorted(low[:, axis], high[:, axis], side="right")
    many = np.maximum(ends - np.arange(len(low)) - 1, 0)
    pieces = np.flatnonzero(np.diff(np.cumsum(many) // PIECE, prepend=-1)).tolist()
    for begin, stop in zip(pieces, [*pieces[1:], len(low)], strict=True):
        own = np.repeat(np.arange(begin, stop), many[begin:stop])
        along = np.arange(len(own)) - np.repeat(np.cumsum(many[begin:stop]) - many[begin:stop], many[begin:stop])
        other = own + 1 + along
        touch = np.all((low[other] <= high[own]) & (low[own] <= high[other]), axis=1)
        first, second = order[own[touch]], order[other[touch]]
        yield np.minimum(first, second), np.maximum(first, second)


def segment_distances(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distances (P,) between the segments from a to b and from c to d, (P, 3) each, of lengths above zero."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (np.sum(x * y, axis=-1) for x, y in ((u, u), (v, v), (u, v)))
    uw, vw = np.sum(u * w, axis=-1), np.sum(v * w, axis=-1)
    area = uu * vv - uv**2
    # The nearest point on the first line, kept on its segment (any of parallel ones); the point of the second segment
    # nearest to it; and the point of the first segment nearest to that.
    s = np.where(area > 1e-12 * uu * vv, (uv * vw - vv * uw) / np.where(area > 0, area, 1.0), 0.0)
    t = np.clip((np.clip(s, 0.0, 1.0) * uv + vw) / vv, 0.0, 1.0)
    s = np.clip((t * uv - uw) / uu, 0.0, 1.0)
    return np.asarray(np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=-1))


def overlaps(structure: Structure, contact: Contact, nodes: Array) -> list[str]:
    """Describe all that touches or overlaps at these node positions, and by how much; empty for none."""
    return [text for text, _, _ in _overlaps(structure, contact, nodes)]


def _overlaps(structure: Structure, contact: Contact, nodes: Array) -> list[tuple[str, float, float]]:
    """List overlaps: in words; by how much [m]; and the least mass [kg] that such a contact feels.

    A rod's end feels m/4 of a free rod (1/m + (ℓ/2)²/J = 4/m), which all that it hangs on increases; two rods feel half
    of the mean, by 1/m₁ + 1/m₂.
    """
    found = []
    owner = {name: (f"rod '{rod.name}' at node '{name}'", rod.mass / 4) for rod in structure.rods for name in rod.nodes}
    owner |= {one.node: (f"the point mass on node '{one.node}'", one.mass) for one in structure.lone_masses}
    for name, gap in zip(structure.node_names, floor_gaps(structure, contact, nodes), strict=True):
        if gap < 0:
            found.append((f"{owner[name][0]} is {-gap:.3g} m inside the floor", -float(gap), owner[name][1]))
    if contact.terrain is not None:
        for rod, (start, end) in zip(structure.rods, nodes[structure.rod_nodes], strict=True):
            # A ridge may be between the nodes: balls above the grid, no further apart than matters.
            start, end = contact.terrain.stretch_above(start, end, rod.radius)
            count = 2 + int(np.linalg.norm(end - start) / max(rod.radius, 0.1 * contact.terrain.spacing))
            gap = min(
                float(_clearance(contact, start + part[:, None] * (end - start), np.full(len(part), rod.radius)).min())
                for part in np.array_split(np.linspace(0.0, 1.0, count), 1 + count // MOST_BALLS)
            )
            if gap < 0 and not any(repr(rod.name) in text for text, _, _ in found):
                found.append(
                    (f"rod '{rod.name}' is {-gap:.3g} m inside the floor between its nodes", -gap, rod.mass / 4)
                )
    if contact.rods and len(structure.rods) > 1:
        pairs, gaps = rod_gaps(structure, nodes)
        apart = {frozenset(names) for names in contact.exclude}
        for (i, j), gap in zip(pairs[gaps < 0], gaps[gaps < 0], strict=True):
            one, other = structure.rods[i], structure.rods[j]
            if {one.name, other.name} in apart:
                continue
            felt = one.mass * other.mass / (one.mass + other.mass) / 4
            found.append((f"rods '{one.name}' and '{other.name}' overlap by {-gap:.3g} m", -float(gap), felt))
    return found


def impedance(contact: Contact, depth: Array) -> tuple[Array, Array]:
    """d and ∂d/∂r [1/m] at depths r >= 0 [m]."""
    d0, d1, width, middle, power = contact.spring.impedance
    x = np.clip(depth / width, 0.0, 1.0)
    low = x <= middle
    y = np.where(low, x / middle, (1 - x) / (1 - middle))  # from the nearer end to the middle, 0 to 1
    share = np.where(low, middle * y**power, 1 - (1 - middle) * y**power)
    slope = np.where(depth < width, power * y ** (power - 1), 0.0) / width
    return d0 + (d1 - d0) * share, (d1 - d0) * slope


def carrying_depth(contact: Contact, acceleration: float) -> float:
    """Depth [m] up to which a start may overlap: twice that at which a contact carries what presses on it, at rest.

    Where a force presses on the mass that a contact feels with an acceleration A, a = 0 and v = 0 give
    (1 - d) A = d k r, or r = (1 - d) d₁² A / (d² stiffness): its right side falls as d grows with r, so that there is
    one such r. A load that is put on a spring at once sinks in twice as deep as it rests, and dampers only lessen it.
    """

    def carried(depth: float) -> float:
        d = float(impedance(contact, np.array(depth))[0])
        return (1 - d) * contact.spring.impedance[1] ** 2 * acceleration / (d**2 * contact.stiffness)

    return 2 * bisect(lambda depth: depth < carried(depth), 0.0, carried(0.0))[1]


def check_contact(scene: Scene) -> None:
    """Raise SceneError unless a scene's contact fits its structure, and nothing overlaps at the start."""
    contact = scene.contact
    assert contact is not None
    if contact.floor is None and not contact.rods:
        raise refused(contact, "there is neither a floor nor contact between rods: give one, or leave contact out")
    if contact.rods and len(scene.structure.rods) < 2:
        raise refused(contact, "rods = True, but there are no two rods that could touch: leave it out")
    names = [rod.name for rod in scene.structure.rods]
    for name in (name for two in contact.exclude for name in two):
        if not contact.rods or name not in names:
            raise refused(
                contact, unknown(name, names, "rod to exclude") if contact.rods else "exclude needs rods = True"
            )
    for name, other in contact.exclude:
        if name == other:
            raise refused(contact, f"exclude: rod '{name}' with itself; name two rods that do not touch each other")
    if contact.terrain is not None and scene.structure.lone_masses:
        # A ball as small as a point may be between two of MuJoCo's cells, and falls through.
        raise refused(
            contact,
            f"terrain: the point mass on node '{scene.structure.lone_masses[0].node}' would touch it, which has no "
            "size; rods alone may: put it on a rod, or leave the terrain out",
        )
    overlapping = _overlaps(scene.structure, contact, scene.nodes0)
    weight = _weight(scene) if overlapping else 0.0
    allowed = [carrying_depth(contact, weight / mass) for _, _, mass in overlapping]
    found = [(text, most) for (text, depth, _), most in zip(overlapping, allowed, strict=True) if depth > most]
    if found:
        most = found[0][1]
        crossing = [text for text, _ in found if text.startswith("rods ")]
        shown = crossing[:MOST_CROSSING] if len(crossing) == len(found) else [found[0][0]]
        text = "; ".join(shown) + (f" (and {len(found) - len(shown)} more)" if len(found) > len(shown) else "")
        remedy = "start higher, lower the floor, or make rods thinner"
        if shown == crossing[: len(shown)]:
            remedy = "move them apart, make them thinner, name such pairs in `exclude`, or leave rods = False"
        raise refused(
            contact,
            f"at the start {text}: {remedy}; {most:.3g} m are allowed, twice the depth at which this contact "
            "alone would carry the weight and the loads of all",
        )


def _weight(scene: Scene) -> float:
    """Weight and loads [N] that may press on a contact at the start."""
    if callable(scene.loads):
        loads = float(np.linalg.norm(np.asarray(scene.loads(0.0), float), axis=1).sum())
    else:
        loads = float(sum(np.linalg.norm(load.force) for load in scene.loads))
    return total_mass(scene.structure) * float(np.linalg.norm(scene.gravity)) + loads
