"""The resistance of a scene in compiled code: forces on nodes from their positions and velocities. See `resistance`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import ACT_SIGNATURE, Effect, Motion, NativeElement
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import ZERO, add, dot, minus, plus, row_of, times, vector
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.model.elements.resistance import (
    GAUSS_POINTS,
    GAUSS_WEIGHTS,
    BendingDamping,
    BendingStiffness,
    FluidResistance,
    NodalDamping,
    bending_joints,
    nodal_damping,
)
from tensegrity_mj.model.rods import diameters
from tensegrity_mj.model.scene import Scene

ROD = np.dtype(
    [
        ("nodes", "i8", (2,)),
        ("viscous", "f8"),  # c ℓ / 6
        ("normal", "f8"),  # ½ ρ C_n d ℓ
        ("tangential", "f8"),  # ½ ρ C_t π d ℓ
    ],
    align=True,
)
JOINT = np.dtype([("nodes", "i8", (3,)), ("inverse", "f8", (2,))], align=True)  # as `Joint`; 1/ℓ of its two rods
Fluid, pack_rods = view_of("Fluid", rods=(ROD, "count"), wind=("f8", 3))
Joints, pack_joints = view_of("Joints", joints=(JOINT, "count"), factor="real", damps="size")


def pack_fluid(element: FluidResistance, scene: Scene) -> NativeElement:
    """Viscous forces and drag of a scene."""
    structure, resistance = scene.structure, element.resistance
    lengths, drag = structure.rod_lengths, resistance.drag
    rods = np.zeros(len(structure.rods), ROD)
    rods["nodes"] = structure.rod_nodes
    rods["viscous"] = resistance.viscous * lengths / 6
    if drag is not None:
        surface = 0.5 * drag.density * diameters(structure, drag.diameter) * lengths
        rods["normal"], rods["tangential"] = drag.normal * surface, np.pi * drag.tangential * surface
    packed = pack_rods(rods=rods, wind=np.array(resistance.wind, float))
    return NativeElement(act_fluid.address, packed.address, (packed,))


def pack_nodal(element: NodalDamping, scene: Scene) -> NativeElement:
    """Damping of point masses: of a rod of no length, both ends of which are the node, in still air."""
    nodes, factors = nodal_damping(scene.structure)
    rods = np.zeros(len(nodes), ROD)
    rods["nodes"], rods["viscous"] = nodes[:, None], factors / 6
    packed = pack_rods(rods=rods, wind=np.zeros(3))
    return NativeElement(act_fluid.address, packed.address, (packed,))


def pack_bending(element: BendingStiffness | BendingDamping, scene: Scene) -> NativeElement:
    """Stiffness or damping of joints in bending."""
    bending, damps = element.bending, isinstance(element, BendingDamping)
    found, lengths = bending_joints(scene.structure, bending), scene.structure.rod_lengths
    joints = np.zeros(len(found), JOINT)
    for record, joint in zip(joints, found, strict=True):
        record["nodes"] = joint.nodes
        record["inverse"] = 1 / lengths[list(joint.rods)]
    packed = pack_joints(joints=joints, factor=bending.damping if damps else bending.stiffness, damps=damps)
    return NativeElement(act_bending.address, packed.address, (packed,))


@inlined
def _normal_drag(factor: float, p: Any, q: Any) -> Any:
    """Forces on the two ends of a rod across which the fluid passes with p + s q, s from 0 to 1."""
    square = dot(q, q)
    split = min(max(-dot(p, q) / square, 0.0), 1.0) if square > 0.0 else 0.0
    first, second = ZERO, ZERO
    for side in range(2):
        start, size = (0.0, split) if side == 0 else (split, 1.0 - split)
        if size > 0.0:
            for k in range(len(GAUSS_POINTS)):
                s = start + GAUSS_POINTS[k] * size
                u = plus(p, times(s, q))
                force = times(-factor * GAUSS_WEIGHTS[k] * size * math.sqrt(dot(u, u)), u)
                first, second = plus(first, times(1.0 - s, force)), plus(second, times(s, force))
    return first, second


@borrowing
def add_fluid(fluid: Any, motion: Any, forces: Any) -> float:
    """Add the forces of a fluid to nodal forces (N, 3); returns the power of the wind [W]."""
    wind, given, nodes, velocities = vector(fluid.wind), 0.0, motion.nodes, motion.velocities
    for r in range(fluid.count):
        rod = fluid.rods[r]
        i, j = rod.nodes[0], rod.nodes[1]
        u1, u2 = minus(row_of(velocities, i), wind), minus(row_of(velocities, j), wind)
        total = plus(u1, u2)
        first, second = times(-rod.viscous, plus(total, u1)), times(-rod.viscous, plus(total, u2))
        if rod.normal > 0.0 or rod.tangential > 0.0:
            span = minus(row_of(nodes, j), row_of(nodes, i))
            along = times(1.0 / math.sqrt(dot(span, span)), span)
            difference = minus(u2, u1)
            p = minus(u1, times(dot(u1, along), along))
            q = minus(difference, times(dot(difference, along), along))
            at_first, at_second = _normal_drag(rod.normal, p, q)
            slip = 0.5 * dot(total, along)
            tangential = times(-0.5 * rod.tangential * abs(slip) * slip, along)
            first, second = plus(first, plus(at_first, tangential)), plus(second, plus(at_second, tangential))
        given += dot(plus(first, second), wind)
        add(forces, i, first)
        add(forces, j, second)
    return given


@borrowing
def add_bending(bent: Any, values: Any, forces: Any) -> None:
    """Add a factor times e of node positions (N, 3), or ė of velocities, as forces on the nodes."""
    for k in range(bent.count):
        joint = bent.joints[k]
        a, n, b = joint.nodes[0], joint.nodes[1], joint.nodes[2]
        at_a, at_b = joint.inverse[0], joint.inverse[1]
        into, out = minus(row_of(values, n), row_of(values, a)), minus(row_of(values, b), row_of(values, n))
        moment = times(bent.factor, minus(times(at_a, into), times(at_b, out)))
        add(forces, a, times(at_a, moment))
        add(forces, b, times(at_b, moment))
        add(forces, n, times(-at_a - at_b, moment))


@c_function(ACT_SIGNATURE, "drag and wind")
def act_fluid(t: Any, motion_at: Any, context_at: Any, effect_at: Any) -> Any:
    """See `native.elements`."""
    effect = Effect(effect_at)
    effect.given += add_fluid(Fluid(context_at), Motion(motion_at), effect.forces)
    return SOLVED


@c_function(ACT_SIGNATURE, "joints against bending")
def act_bending(t: Any, motion_at: Any, context_at: Any, effect_at: Any) -> Any:
    """See `native.elements`."""
    bent, motion = Joints(context_at), Motion(motion_at)
    add_bending(bent, motion.velocities if bent.damps else motion.nodes, Effect(effect_at).forces)
    return SOLVED
