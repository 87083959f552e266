"""The resistance of a scene in compiled code: forces on nodes from their positions and velocities. See `resistance`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.pointers import address_of, borrowing, floats, inlined, integers, records_reader
from tensegrity_mj.dynamics.native.vectors import ZERO, dot, minus, plus, row_of, times, vector
from tensegrity_mj.model.elements.resistance import GAUSS_POINTS, GAUSS_WEIGHTS, bending_joints, diameters
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
_read_rods, _read_joints = records_reader(ROD), records_reader(JOINT)

# The table; NUMBERS are the wind (3,), κ and γ, PULLS (2, N, 3) the dissipating and the elastic forces as last found,
# POWERS what they dissipated and what the wind gave. Threads of a law without a run share PULLS and POWERS, and none of
# them reads these.
_ROD_COUNT, _RODS, _JOINT_COUNT, _JOINTS, _NODE_COUNT, _NUMBERS, _PULLS, _POWERS = range(8)


class PackedResistance:
    """The arrays of a scene's resistance and a table of their addresses, to be kept alive while it is read.

    Attributes:
        table: (8,) int64.
    """

    def __init__(self, scene: Scene) -> None:
        structure, resistance = scene.structure, scene.resistance
        assert resistance is not None
        lengths, drag, bending = structure.rod_lengths, resistance.drag, resistance.bending
        rods = np.zeros(len(structure.rods), ROD)
        rods["nodes"] = structure.rod_nodes
        rods["viscous"] = resistance.viscous * lengths / 6
        if drag is not None:
            surface = 0.5 * drag.density * diameters(structure, drag) * lengths
            rods["normal"], rods["tangential"] = drag.normal * surface, np.pi * drag.tangential * surface
        found = bending_joints(structure, bending)
        joints = np.zeros(len(found), JOINT)
        for record, joint in zip(joints, found, strict=True):
            record["nodes"] = joint.nodes
            record["inverse"] = 1 / lengths[list(joint.rods)]
        constants = (0.0, 0.0) if bending is None else (bending.stiffness, bending.damping)
        numbers = np.array([*resistance.wind, *constants], float)
        pulls, powers = np.zeros((2, len(structure.nodes), 3)), np.zeros(2)
        self._arrays = (rods, joints, numbers, pulls, powers)
        at = [address_of(array) for array in self._arrays]
        self.table = np.array([len(rods), at[0], len(joints), at[1], len(structure.nodes), *at[2:]], np.int64)

    @property
    def address(self) -> int:
        """Of the table."""
        return address_of(self.table)


@inlined
def _add(n: int, force: Any, forces: Any, pull: Any) -> None:
    for x in range(3):
        forces[n, x] += force[x]
        pull[n, x] += force[x]


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
def resist(packed: int, nodes: Any, velocities: Any, forces: Any) -> float:
    """Add the forces of the resistance to nodal forces (N, 3); returns the power of the wind [W].

    Their whole power is that, minus `dissipated`, minus the rate of the energy of bending.
    """
    table = integers(packed, (8,))
    N, numbers = table[_NODE_COUNT], floats(table[_NUMBERS], (5,))
    pull, elastic = floats(table[_PULLS], (N, 3)), floats(table[_PULLS] + 24 * N, (N, 3))
    for n in range(N):
        pull[n, 0], pull[n, 1], pull[n, 2] = ZERO
        elastic[n, 0], elastic[n, 1], elastic[n, 2] = ZERO
    wind, lost, given = vector(numbers), 0.0, 0.0
    rods = _read_rods(table[_RODS], table[_ROD_COUNT])
    for r in range(len(rods)):
        rod = rods[r]
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
        lost -= dot(first, u1) + dot(second, u2)
        given += dot(plus(first, second), wind)
        _add(i, first, forces, pull)
        _add(j, second, forces, pull)
    joints = _read_joints(table[_JOINTS], table[_JOINT_COUNT])
    for k in range(len(joints)):
        joint = joints[k]
        a, n, b = joint.nodes[0], joint.nodes[1], joint.nodes[2]
        at_a, at_b = joint.inverse[0], joint.inverse[1]
        into, out = minus(row_of(nodes, n), row_of(nodes, a)), minus(row_of(nodes, b), row_of(nodes, n))
        bend = minus(times(at_a, into), times(at_b, out))
        into, out = (
            minus(row_of(velocities, n), row_of(velocities, a)),
            minus(row_of(velocities, b), row_of(velocities, n)),
        )
        rate = minus(times(at_a, into), times(at_b, out))
        for part in range(2):
            moment, kept = (times(numbers[3], bend), elastic) if part == 0 else (times(numbers[4], rate), pull)
            _add(a, times(at_a, moment), forces, kept)
            _add(b, times(at_b, moment), forces, kept)
            _add(n, times(-at_a - at_b, moment), forces, kept)
        lost += numbers[4] * dot(rate, rate)
    powers = floats(table[_POWERS], (2,))
    powers[0], powers[1] = lost, given
    return given


@borrowing
def dissipated(packed: int) -> float:
    """Power [W] that the forces last found take: the fluid's at rest in it, and that of the joints' dampers."""
    return floats(integers(packed, (8,))[_POWERS], (2,))[0]


@borrowing
def held_powers(packed: int, velocities: Any) -> tuple[float, float]:
    """Of the forces last found, held, at velocities (3N,): the power [W] that they take as in `dissipated`, and all of
    theirs but what the wind gives.
    """
    table = integers(packed, (8,))
    size = 3 * table[_NODE_COUNT]
    pulls, lost, stored = floats(table[_PULLS], (2, size)), floats(table[_POWERS], (2,))[1], 0.0
    for x in range(size):
        lost -= pulls[0, x] * velocities[x]
        stored -= pulls[1, x] * velocities[x]
    return lost, -lost - stored
