"""The one string law, compiled: lengths and rates, tensions, energies, forces on nodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.pointers import (
    borrowing,
    floats,
    integers,
)
from tensegrity_mj.dynamics.native.slots import (
    BROKEN,
    CLIPPED,
    DAMPING,
    ELASTIC,
    FORCES,
    LENGTH,
    NODE_COUNT,
    NODES,
    RATE,
    REST,
    STIFFNESS,
    STRING_COUNT,
    STRING_NODES,
    TENSION,
    VELOCITIES,
)


@borrowing
def measure_strings(table: Any) -> None:
    """Lengths and rates of the strings from the node positions and velocities."""
    N, M = table[NODE_COUNT], table[STRING_COUNT]
    nodes, velocities = floats(table[NODES], (N, 3)), floats(table[VELOCITIES], (N, 3))
    pairs = integers(table[STRING_NODES], (M, 2))
    lengths, rates = floats(table[LENGTH], (M,)), floats(table[RATE], (M,))
    for m in range(M):
        i, j = pairs[m, 0], pairs[m, 1]
        square, dot = 0.0, 0.0
        for x in range(3):
            s = nodes[j, x] - nodes[i, x]
            square += s * s
            dot += s * (velocities[j, x] - velocities[i, x])
        lengths[m] = np.sqrt(square)
        rates[m] = dot / lengths[m] if square > 0.0 else 0.0


@borrowing
def tighten_strings(table: Any) -> tuple[float, float]:
    """Tension and its elastic part from lengths, rates and rest lengths: the law of `strings`.

    Returns the powers Σ T_elastic dL/dt and Σ (T - T_elastic) dL/dt [W] of the elastic parts and of the dampers.
    """
    M, clipped = table[STRING_COUNT], table[CLIPPED]
    stiffness, damping = floats(table[STIFFNESS], (M,)), floats(table[DAMPING], (M,))
    lengths, rates = floats(table[LENGTH], (M,)), floats(table[RATE], (M,))
    rest, broken = floats(table[REST], (M,)), integers(table[BROKEN], (M,))
    tension, elastic = floats(table[TENSION], (M,)), floats(table[ELASTIC], (M,))
    stored, lost = 0.0, 0.0
    for m in range(M):
        stretch, pull, total = lengths[m] - rest[m], 0.0, 0.0
        if stretch > 0.0 and not broken[m]:
            pull = stiffness[m] * stretch
            total = pull + damping[m] * rates[m]
            if clipped:
                total = max(0.0, total)
        elastic[m], tension[m] = pull, total
        stored += pull * rates[m]
        lost += (total - pull) * rates[m]
    return stored, lost


@borrowing
def string_energy(table: Any) -> float:
    """Elastic energy of all strings at the current lengths and rest lengths."""
    M = table[STRING_COUNT]
    stiffness = floats(table[STIFFNESS], (M,))
    lengths, rest = floats(table[LENGTH], (M,)), floats(table[REST], (M,))
    broken = integers(table[BROKEN], (M,))
    total = 0.0
    for m in range(M):
        stretch = lengths[m] - rest[m]
        if stretch > 0.0 and not broken[m]:
            total += 0.5 * stiffness[m] * stretch * stretch
    return total


@borrowing
def add_string_forces(table: Any) -> None:
    """Add the strings' pull to the nodal forces."""
    N, M = table[NODE_COUNT], table[STRING_COUNT]
    nodes, forces = floats(table[NODES], (N, 3)), floats(table[FORCES], (N, 3))
    pairs = integers(table[STRING_NODES], (M, 2))
    lengths, tension = floats(table[LENGTH], (M,)), floats(table[TENSION], (M,))
    for m in range(M):
        if tension[m] != 0.0 and lengths[m] > 0.0:
            i, j = pairs[m, 0], pairs[m, 1]
            density = tension[m] / lengths[m]
            for x in range(3):
                pull = density * (nodes[j, x] - nodes[i, x])
                forces[i, x] += pull
                forces[j, x] -= pull
