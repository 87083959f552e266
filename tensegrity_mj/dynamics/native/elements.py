"""Loads and moved supports as compiled code sees them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.law import FAILED
from tensegrity_mj.dynamics.native.motion import motion_at
from tensegrity_mj.dynamics.native.pointers import (
    borrowing,
    call_load,
    floats,
    records_reader,
)
from tensegrity_mj.dynamics.native.resistance import resist
from tensegrity_mj.dynamics.native.slots import (
    FORCES,
    LOAD_COUNT,
    LOAD_FUNCTION_SLOT,
    LOADED,
    LOADS,
    MOTION_COUNT,
    MOTIONS,
    MOVED,
    NODE_COUNT,
    NODES,
    RESISTANCE,
    STATUS,
    VELOCITIES,
    WATER,
)
from tensegrity_mj.dynamics.native.water import immerse

LOAD = np.dtype([("node", "i8"), ("force", "f8", (3,)), ("frequency", "f8"), ("phase", "f8")], align=True)


_read_loads = records_reader(LOAD)


@borrowing
def set_loads(table: Any, t: float) -> float:
    """Set the nodal forces to the external ones, those of the resistance and those of water at time t.

    Returns the power [W] of the external ones, of the wind, and of water. What answers the rods' accelerations is
    not among the forces: the engine adds it.
    """
    N = table[NODE_COUNT]
    forces, velocities = floats(table[FORCES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    for n in range(N):
        for x in range(3):
            forces[n, x] = 0.0
    if not table[LOADED]:
        return 0.0
    if table[LOAD_FUNCTION_SLOT]:
        if call_load(table[LOAD_FUNCTION_SLOT], t, table[FORCES]) != 0:
            table[STATUS] = FAILED
    else:
        loads = _read_loads(table[LOADS], table[LOAD_COUNT])
        for a in range(len(loads)):
            load = loads[a]
            scale = np.cos(load.frequency * t + load.phase)
            for x in range(3):
                forces[load.node, x] += scale * load.force[x]
    power = 0.0
    for n in range(N):
        for x in range(3):
            power += forces[n, x] * velocities[n, x]
    if table[RESISTANCE]:
        power += resist(table[RESISTANCE], floats(table[NODES], (N, 3)), velocities, forces)
    if table[WATER]:
        power += immerse(table[WATER], t, floats(table[NODES], (N, 3)), velocities, forces)
    return power


@borrowing
def set_motions(table: Any, t: float) -> None:
    """Where the moved supports are at time t, with their velocities and accelerations."""
    for number in range(table[MOTION_COUNT]):
        if motion_at(table[MOTIONS], number, t, table[MOVED] + 72 * number) != 0:
            table[STATUS] = FAILED
