"""Resistance to motion: the fluid around rods, stiffness and damping of joints in bending, damping of point masses.

With u = v - w the velocity of a point of a rod [m/s] in a fluid that moves with the wind w, a rod feels per length

    viscous      -c u                                                      [N/m]
    drag         -½ ρ C_n d |u⊥| u⊥ - ½ ρ C_t π d |u∥| u∥                  the cross-flow principle

u⊥ being the part of u across the rod and u∥ that along it. Where two rods a, b meet, with unit vectors d_a into the
joint and d_b out of it, so that e = d_a - d_b is zero where they are in a line,

    bending      energy ½ κ ‖e‖² = κ (1 - cos φ), power taken γ ‖ė‖²        φ the angle between them

as forces on their nodes, -(κ e + γ ė) · ∂e/∂nodes, which are couples on the rods.

Forces along a rod act on its nodes so that every velocity field that is linear along it gets the same power: for a
rigid rod that is exact, and not lumping. Viscous forces are integrated in closed form. Drag is integrated by Gauss'
rule of five points on each side of the point where |u⊥| is smallest: exact where u⊥ keeps its line, as in all plane
motion; otherwise the error is at most 5e-5 of the largest component of the two forces.

Arrays of nodes and velocities are (..., N, 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import many, not_negative, pair, part, positive, vector
from tensegrity_mj.model.elements.element import Element, Work, energy_of, forces_of
from tensegrity_mj.model.members import Vector
from tensegrity_mj.model.rods import diameters, ends
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.structure_checks import names_of

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene


def gauss_rule(count: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Points and weights of Gauss' rule on [0, 1]."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return tuple(float(x) for x in 0.5 * (1 + points)), tuple(float(x) for x in 0.5 * weights)


GAUSS_POINTS, GAUSS_WEIGHTS = gauss_rule(5)


@value("resistance: bending", whole=True)
class Bending:
    """Stiffness and damping of joints in bending.

    Attributes:
        stiffness: κ [N m], >= 0: moment by angle.
        damping: γ [N m s], >= 0: moment by rate.
        pairs: names of the two rods of each joint that has them; None for every joint of exactly two rods. A joint is
            at rest where its rods are in a line.
    """

    stiffness: float = field(not_negative("N m"), default=0.0)
    damping: float = field(not_negative("N m s"), default=0.0)
    pairs: tuple[tuple[str, str], ...] | None = field(
        many(pair("rod"), 'a list of pairs of rods, as [["rod1", "rod2"]]'),
        default=None,
        none="None for every joint of two rods",
    )


@value("resistance: drag", whole=True)
class Drag:
    """Quadratic drag; the defaults are a cylinder's in air, below the drag crisis.

    Attributes:
        normal: C_n >= 0, on the diameter.
        tangential: C_t >= 0, on the circumference.
        density: ρ of the fluid [kg/m³], > 0.
        diameter: d [m] of every rod, > 0; None for twice each rod's own radius.
    """

    normal: float = field(not_negative(), default=1.2)
    tangential: float = field(not_negative(), default=0.0)
    density: float = field(positive("kg/m³"), default=1.225)
    diameter: float | None = field(positive("m"), default=None, none="None for twice each rod's radius")


@value("resistance")
class Resistance:
    """Resistance to motion in a scene; by default there is none.

    Attributes:
        viscous: c [N s/m²], >= 0: force per length and velocity.
        bending: of joints, or None.
        drag: of all rods, or None.
        wind: velocity w of the fluid [m/s], for viscous forces and drag.
    """

    viscous: float = field(not_negative("N s/m²"), default=0.0)
    bending: Bending | None = field(part(Bending), default=None, none="None")
    drag: Drag | None = field(part(Drag), default=None, none="None")
    wind: Vector = field(vector("m/s"), default=(0.0, 0.0, 0.0))

    @property
    def elements(self) -> tuple[Element, ...]:
        """Elements that act: a fluid around the rods, stiffness and damping of joints."""
        found: list[Element] = []
        if self.viscous or self.drag is not None:
            found.append(FluidResistance(self))
        if self.bending is not None and self.bending.stiffness:
            found.append(BendingStiffness(self.bending))
        if self.bending is not None and self.bending.damping:
            found.append(BendingDamping(self.bending))
        return tuple(found)


@dataclass(frozen=True)
class Joint:
    """A joint that resists bending: rows of its rods (a, b), and of the nodes along them (outer of a, joint, of b)."""

    rods: tuple[int, int]
    nodes: tuple[int, int, int]


def shared_node(structure: Structure, a: int, b: int) -> int | None:
    """The node row where two rods meet, or None unless they meet at exactly one."""
    common = set(structure.rod_nodes[a].tolist()) & set(structure.rod_nodes[b].tolist())
    return common.pop() if len(common) == 1 else None


def bending_joints(structure: Structure, bending: Bending | None) -> list[Joint]:
    """The joints that resist bending."""
    if bending is None:
        return []
    if bending.pairs is None:
        pairs = [(rows[0], rows[1]) for rows in structure.rods_at.values() if len(rows) == 2]
    else:
        rods = {rod.name: row for row, rod in enumerate(structure.rods)}
        pairs = [(rods[a], rods[b]) for a, b in bending.pairs]
    found = []
    for a, b in pairs:
        node = shared_node(structure, a, b)
        if node is not None:
            outer = [int(sum(structure.rod_nodes[row])) - node for row in (a, b)]
            found.append(Joint((int(a), int(b)), (outer[0], node, outer[1])))
    return found


@dataclass(frozen=True)
class FluidResistance(Element):
    """Viscous forces and drag of all rods, in wind."""

    resistance: Resistance
    work = Work.LOST
    vectorized = True
    compiled = "tensegrity_mj.dynamics.native.resistance:pack_fluid"
    arrays = "tensegrity_mj.engines.jax.effects:fluid_resistance"
    label = "resistance"

    @property
    def smooth(self) -> bool:  # type: ignore[override]
        """Drag has a kink where a part of a rod stands still in the fluid."""
        return self.resistance.drag is None

    def act(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
        out, structure, drag = np.zeros_like(nodes), scene.structure, self.resistance.drag
        pairs, lengths = structure.rod_nodes, structure.rod_lengths[:, None]
        (x1, x2), (u1, u2) = (ends(structure, v) for v in (nodes, velocities - np.array(self.resistance.wind)))
        first = -self.resistance.viscous * lengths * (2 * u1 + u2) / 6
        second = -self.resistance.viscous * lengths * (u1 + 2 * u2) / 6
        if drag is not None:
            for total, part in zip((first, second), _drag(structure, drag, x1, x2, u1, u2), strict=True):
                total += part
        for row, (i, j) in enumerate(pairs):
            out[..., i, :] += first[..., row, :]
            out[..., j, :] += second[..., row, :]
        return out

    def given(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> float:
        """Power [W] that the wind gives."""
        return float(np.sum(self.act(scene, time, nodes, velocities) @ np.array(self.resistance.wind)))


@dataclass(frozen=True)
class BendingStiffness(Element):
    """-κ e · ∂e/∂nodes of the joints that resist bending."""

    bending: Bending
    work = Work.STORED
    smooth = True
    vectorized = True
    compiled = "tensegrity_mj.dynamics.native.resistance:pack_bending"
    arrays = "tensegrity_mj.engines.jax.effects:bending_stiffness"
    label = "resistance"

    def act(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
        return _bending(scene.structure, self.bending, self.bending.stiffness, nodes)

    def energy(self, scene: Scene, nodes: Array) -> Any:
        """Σ ½ κ ‖e‖² [J]."""
        total = np.zeros(nodes.shape[:-2])
        for joint in bending_joints(scene.structure, self.bending):
            total += 0.5 * self.bending.stiffness * np.sum(_bend(scene.structure, joint, nodes) ** 2, axis=-1)
        return total


@dataclass(frozen=True)
class BendingDamping(Element):
    """-γ ė · ∂e/∂nodes of the joints that resist bending."""

    bending: Bending
    work = Work.LOST
    smooth = True
    vectorized = True
    compiled = "tensegrity_mj.dynamics.native.resistance:pack_bending"
    arrays = "tensegrity_mj.engines.jax.effects:bending_damping"
    label = "resistance"

    def act(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
        return _bending(scene.structure, self.bending, self.bending.damping, velocities)


def nodal_damping(structure: Structure) -> tuple[IntArray, Array]:
    """Rows of the nodes whose point masses have a damping, and c [N s/m] of each."""
    damped = [point for point in structure.point_masses if point.damping]
    rows = np.array([structure.node_index[point.node] for point in damped], np.int64)
    return rows, np.array([point.damping for point in damped], float)


@dataclass(frozen=True)
class NodalDamping(Element):
    """-c v on the nodes of point masses that have a damping c."""

    work = Work.LOST
    smooth = True
    vectorized = True
    compiled = "tensegrity_mj.dynamics.native.resistance:pack_nodal"
    arrays = "tensegrity_mj.engines.jax.effects:nodal_damping_of"
    label = "damping of point masses"

    def act(self, scene: Scene, time: Array | float, nodes: Array, velocities: Array) -> Array:
        out = np.zeros_like(velocities)
        rows, factors = nodal_damping(scene.structure)
        out[..., rows, :] = -factors[:, None] * velocities[..., rows, :]
        return out


def _bending(structure: Structure, bending: Bending, factor: float, values: Array) -> Array:
    """Forces (..., N, 3) of a factor times e of node positions, or ė of velocities."""
    out = np.zeros_like(values)
    for joint in bending_joints(structure, bending):
        moment = factor * _bend(structure, joint, values)
        outer, node, other = joint.nodes
        for end, row in zip((outer, other), joint.rods, strict=True):
            pull = moment / structure.rod_lengths[row]
            out[..., end, :] += pull
            out[..., node, :] -= pull
    return out


def resisting_forces(scene: Scene, nodes: Array, velocities: Array) -> Array:
    """Forces (..., N, 3) [N] of a scene's resistance on the nodes; zero where it has none."""
    parts = () if scene.resistance is None else scene.resistance.elements
    return forces_of(parts, scene, 0.0, nodes, velocities)


def bending_energy(scene: Scene, nodes: Array) -> Array:
    """Σ ½ κ ‖e‖² [J], (...): energy stored in bent joints."""
    parts = () if scene.resistance is None else scene.resistance.elements
    return energy_of(parts, scene, nodes)


def _bend(structure: Structure, joint: Joint, values: Array) -> Array:
    """e (..., 3) of node positions, or ė of velocities."""
    outer, node, other = (values[..., row, :] for row in joint.nodes)
    a, b = (structure.rod_lengths[row] for row in joint.rods)
    return np.asarray((node - outer) / a - (other - node) / b)


def _drag(structure: Structure, drag: Drag, x1: Array, x2: Array, u1: Array, u2: Array) -> tuple[Array, Array]:
    """Forces (..., R, 3) on the first and the second ends."""
    span = x2 - x1
    along = span / np.linalg.norm(span, axis=-1, keepdims=True)
    first, second = np.zeros_like(span), np.zeros_like(span)
    surface = (0.5 * drag.density * structure.rod_lengths * diameters(structure, drag.diameter))[:, None]
    # A rigid rod has one velocity along itself.
    slip = 0.5 * np.sum((u1 + u2) * along, axis=-1, keepdims=True)
    tangential = -0.5 * np.pi * surface * drag.tangential * np.abs(slip) * slip * along
    p, q = (u - np.sum(u * along, axis=-1, keepdims=True) * along for u in (u1, u2 - u1))
    square = np.sum(q * q, axis=-1, keepdims=True)
    split = np.clip(-np.sum(p * q, axis=-1, keepdims=True) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    for start, size in ((np.zeros_like(split), split), (split, 1 - split)):
        for point, weight in zip(GAUSS_POINTS, GAUSS_WEIGHTS, strict=True):
            s = start + point * size
            u = p + s * q
            force = -surface * drag.normal * weight * size * np.linalg.norm(u, axis=-1, keepdims=True) * u
            first += (1 - s) * force
            second += s * force
    return first + tangential, second + tangential


def check_resistance(structure: Structure, resistance: Resistance) -> None:
    """Raise SceneError unless a resistance fits a structure."""
    if resistance.bending is not None:
        _check_bending(structure, resistance.bending)
    if resistance.viscous == 0 and resistance.bending is None and resistance.drag is None:
        raise refused(
            resistance, "it has neither viscous forces nor bending nor drag: give one, or leave resistance out"
        )
    if any(resistance.wind) and resistance.viscous == 0 and resistance.drag is None:
        raise refused(
            resistance,
            "there is wind, but neither viscous forces nor drag that could feel it: give one, or leave wind out",
        )


def _check_bending(structure: Structure, bending: Bending) -> None:
    rods = {rod.name: row for row, rod in enumerate(structure.rods)}
    seen: set[frozenset[str]] = set()
    for number, names in enumerate(bending.pairs or ()):
        what, both = f"pairs[{number}]", f"rods '{names[0]}' and '{names[1]}'"
        for name in names:
            if name not in rods:
                raise refused(bending, f"{what}: unknown rod '{name}'; the rods are {names_of(rods)}")
        if names[0] == names[1] or shared_node(structure, rods[names[0]], rods[names[1]]) is None:
            raise refused(bending, f"{what}: {both} must be two that share exactly one node")
        if frozenset(names) in seen:
            raise refused(bending, f"{what}: {both} are named twice; name each pair once")
        seen.add(frozenset(names))
    if not bending_joints(structure, bending):
        raise refused(
            bending,
            f"structure '{structure.name}' has no joint of exactly two rods, and no pairs are named: name the two rods "
            "of each joint that resists, or leave bending out",
        )
