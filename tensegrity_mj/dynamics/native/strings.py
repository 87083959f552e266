"""The one string law, compiled: lengths and rates, tensions, energies, forces on nodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing


@borrowing
def measure_strings(table: int) -> None:
    """Lengths and rates of the strings from the node positions and velocities."""
    plant = PlantView(table)
    nodes, velocities, pairs = plant.nodes, plant.velocities, plant.string_nodes
    lengths, rates = plant.lengths, plant.rates
    for m in range(len(pairs)):
        i, j = pairs[m, 0], pairs[m, 1]
        square, dot = 0.0, 0.0
        for x in range(3):
            s = nodes[j, x] - nodes[i, x]
            square += s * s
            dot += s * (velocities[j, x] - velocities[i, x])
        lengths[m] = np.sqrt(square)
        rates[m] = dot / lengths[m] if square > 0.0 else 0.0


@borrowing
def tighten_strings(table: int) -> tuple[float, float]:
    """Tension and its elastic part from lengths, rates and rest lengths: the law of `strings`.

    Returns the powers Σ T_elastic dL/dt and Σ (T - T_elastic) dL/dt [W] of the elastic parts and of the dampers.
    """
    plant = PlantView(table)
    stiffness, damping, clipped, broken = plant.stiffness, plant.damping, plant.clipped, plant.broken
    lengths, rates, rest = plant.lengths, plant.rates, plant.rest
    tension, elastic = plant.tensions, plant.elastic
    stored, lost = 0.0, 0.0
    for m in range(len(rest)):
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
def string_energy(table: int) -> float:
    """Elastic energy of all strings at the current lengths and rest lengths."""
    plant = PlantView(table)
    stiffness, lengths, rest, broken = plant.stiffness, plant.lengths, plant.rest, plant.broken
    total = 0.0
    for m in range(len(rest)):
        stretch = lengths[m] - rest[m]
        if stretch > 0.0 and not broken[m]:
            total += 0.5 * stiffness[m] * stretch * stretch
    return total


@borrowing
def add_string_forces(table: int, forces: Any) -> None:
    """Add the strings' pull to forces on the nodes (N, 3)."""
    plant = PlantView(table)
    nodes, pairs, lengths, tension = plant.nodes, plant.string_nodes, plant.lengths, plant.tensions
    for m in range(len(pairs)):
        if tension[m] != 0.0 and lengths[m] > 0.0:
            i, j = pairs[m, 0], pairs[m, 1]
            density = tension[m] / lengths[m]
            for x in range(3):
                pull = density * (nodes[j, x] - nodes[i, x])
                forces[i, x] += pull
                forces[j, x] -= pull
