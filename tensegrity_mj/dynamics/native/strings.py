"""The one string law, compiled: lengths and rates, tensions, energies, forces on nodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.curves import curved_energy, curved_pull
from tensegrity_mj.dynamics.native.lanes import all_of, any_of, select
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS, PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import dot, minus, row_of
from tensegrity_mj.model.strings import EDGE

# More values of BROKEN than 0 (whole) and 1: within a step, a string stays slack or taut as it was at its start.
KEPT_SLACK, KEPT_TAUT = 2, -1


@inlined
def rest_moves(plant: Any) -> bool:
    """Return whether rest lengths follow a law at every stage, or lengths: then dL/dt is not the rate of a stretch."""
    return bool((plant.mode == CONTINUOUS and not plant.suspended) or plant.holds_force_density)


@inlined
def over_rest(plant: Any, m: int, moves: bool) -> float:
    """Stretch of a string [m] over its permanent one; where it is positive the string is taut.

    A string that grows longer from zero, to round-off, is taut already: its damper acts from then on. `moves`: see
    `rest_moves`.
    """
    length = plant.lengths[m]
    over = length - plant.rest[m] - plant.permanent[m]
    if not moves and any_of(over <= 0.0):
        begins = (over <= 0.0) & (over >= -EDGE * length) & (plant.rates[m] > 0.0)
        over = select(begins, EDGE * length, over)
    return over


@inlined
def is_slack(plant: Any, m: int, moves: bool) -> bool:
    """Return whether a string is slack, broken, or kept slack."""
    state = plant.broken[m]
    return (state != KEPT_TAUT) & ((state != 0) | (over_rest(plant, m, moves) <= 0.0))


@borrowing
def measure_strings(table: int) -> None:
    """Lengths and rates of the strings from the node positions and velocities."""
    plant = PlantView(table)
    nodes, velocities, pairs, ranges = plant.nodes, plant.velocities, plant.segments, plant.ranges
    lengths, rates, parts = plant.lengths, plant.rates, plant.segment_lengths
    for m in range(len(ranges)):
        length, rate = 0.0, 0.0
        for p in range(ranges[m, 0], ranges[m, 1]):
            i, j = pairs[p, 0], pairs[p, 1]
            square, moves = 0.0, 0.0
            for x in range(3):
                s = nodes[j, x] - nodes[i, x]
                square += s * s
                moves += s * (velocities[j, x] - velocities[i, x])
            parts[p] = np.sqrt(square)
            length += parts[p]
            if any_of(square > 0.0):
                rate += select(square > 0.0, moves / parts[p], 0.0)
        lengths[m], rates[m] = length, rate


@borrowing
def measure_segments(table: int) -> None:
    """Lengths of the segments alone, where an engine has the strings' lengths from elsewhere."""
    plant = PlantView(table)
    nodes, pairs, parts = plant.nodes, plant.segments, plant.segment_lengths
    for p in range(len(pairs)):
        span = minus(row_of(nodes, pairs[p, 1]), row_of(nodes, pairs[p, 0]))
        parts[p] = np.sqrt(dot(span, span))


@borrowing
def tighten_strings(table: int) -> tuple[float, float]:
    """Tension and its elastic part from lengths, rates and rest lengths: the law of `strings`.

    Returns the powers Σ T_elastic dL/dt and Σ (T - T_elastic) dL/dt [W] of the elastic parts and of the dampers.
    """
    plant = PlantView(table)
    stiffness, damping, clipped, kept = plant.stiffness, plant.damping, plant.clipped, plant.broken
    lengths, rates, rest = plant.lengths, plant.rates, plant.rest
    tension, elastic = plant.tensions, plant.elastic
    stored, lost, curved, moves = 0.0, 0.0, plant.curved, rest_moves(plant)
    for m in range(len(rest)):
        stretch, slack = lengths[m] - rest[m], is_slack(plant, m, moves)
        if all_of(slack):
            elastic[m], tension[m] = 0.0, 0.0
            continue
        pull = stiffness[m] * (stretch - plant.permanent[m])
        if any_of(stretch <= 0.0) and not kept[m]:
            pull = select(stretch <= 0.0, 0.0, pull)
        if curved:
            pull = select(stretch > plant.permanent[m], curved_pull(plant, m, stretch), pull)
        pull = select(slack, 0.0, pull)
        total = pull + damping[m] * rates[m]
        if clipped[m]:
            total = max(0.0, total)
        total = select(slack, 0.0, total)
        elastic[m], tension[m] = pull, total
        stored += pull * rates[m]
        lost += (total - pull) * rates[m]
    return stored, lost


@borrowing
def string_energy(table: int) -> float:
    """Elastic energy of all strings at the current lengths and rest lengths."""
    plant = PlantView(table)
    stiffness, lengths, rest, broken = plant.stiffness, plant.lengths, plant.rest, plant.broken
    total, curved = 0.0, plant.curved
    for m in range(len(rest)):
        stretch = lengths[m] - rest[m]
        if curved and broken[m] <= 0:
            total += curved_energy(plant, m, stretch)
        else:
            total += select((stretch > 0.0) & (broken[m] <= 0), 0.5 * stiffness[m] * stretch * stretch, 0.0)
    return total


@borrowing
def add_string_forces(table: int, forces: Any) -> None:
    """Add the strings' pull to forces on the nodes (N, 3): the tension along each segment, by its measured length."""
    plant = PlantView(table)
    nodes, pairs, ranges = plant.nodes, plant.segments, plant.ranges
    lengths, tension = plant.segment_lengths, plant.tensions
    for m in range(len(ranges)):
        if not any_of(tension[m] != 0.0):
            continue
        for p in range(ranges[m, 0], ranges[m, 1]):
            if any_of(lengths[p] > 0.0):
                i, j = pairs[p, 0], pairs[p, 1]
                density = select(lengths[p] > 0.0, tension[m] / lengths[p], 0.0)
                for x in range(3):
                    pull = density * (nodes[j, x] - nodes[i, x])
                    forces[i, x] += pull
                    forces[j, x] -= pull


@inlined
def string_length(nodes: Any, segments: Any, limits: Any) -> float:
    """L of the string whose segments (S, 2) are those between two rows (2,), at nodes (N, 3)."""
    total = 0.0
    for p in range(limits[0], limits[1]):
        span = minus(row_of(nodes, segments[p, 1]), row_of(nodes, segments[p, 0]))
        total += np.sqrt(dot(span, span))
    return total


@inlined
def share(length: float, span: Any) -> float:
    """L/l of a segment along `span`: a force density u = T/L of its string pulls it with u L/l times its span."""
    square = dot(span, span)
    return select(square > 0.0, length / np.sqrt(square), 1.0)
