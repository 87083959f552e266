"""Tension curves of strings, compiled: tension, energy and inverse, piece by piece, and the memory of those that yield.

Plants of linear strings alone call none of these.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.lanes import alone
from tensegrity_mj.dynamics.native.plant_view import CONTINUOUS, PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing

START, TENSION, SLOPE, ENERGY = range(4)  # of a piece
HALVINGS = 40  # for the root of a cubic


@borrowing
def _piece(plant: Any, m: int, stretch: float) -> int:
    """The row of the piece that holds a stretch."""
    pieces, limits = plant.pieces, plant.piece_ranges
    p = limits[m, 1] - 1
    while p > limits[m, 0] and stretch <= pieces[p, START]:
        p -= 1
    return p


@borrowing
def _polygon(plant: Any, m: int, stretch: float) -> float:
    """f(s) [N], s >= 0."""
    pieces, p = plant.pieces, _piece(plant, m, stretch)
    return pieces[p, TENSION] + pieces[p, SLOPE] * (stretch - pieces[p, START])


@borrowing
def _work(plant: Any, m: int, stretch: float) -> float:
    """∫ f ds [J] from 0 to s >= 0."""
    pieces, p = plant.pieces, _piece(plant, m, stretch)
    beyond = stretch - pieces[p, START]
    return pieces[p, ENERGY] + pieces[p, TENSION] * beyond + 0.5 * pieces[p, SLOPE] * beyond * beyond


@alone(0.0)
def curved_pull(plant: Any, m: int, stretch: float) -> float:
    """Elastic tension [N] of a string at a stretch; zero where it is slack."""
    if stretch <= 0.0:
        return 0.0
    pull = _polygon(plant, m, stretch)
    if plant.yields[m]:
        pull = max(0.0, min(pull, plant.stiffness[m] * (stretch - plant.permanent[m])))
    return pull


@alone(0.0)
def curved_energy(plant: Any, m: int, stretch: float) -> float:
    """Elastic energy [J] of a string at a stretch."""
    if stretch <= 0.0:
        return 0.0
    if plant.yields[m]:
        pull = curved_pull(plant, m, stretch)
        return 0.5 * pull * pull / plant.stiffness[m]
    return _work(plant, m, stretch)


@alone(0.0)
def stretch_of(plant: Any, m: int, pull: float) -> float:
    """The least stretch [m] with that tension [N]; the last point of a curve that stays below. Of ∞, ∞."""
    pieces, limits = plant.pieces, plant.piece_ranges
    p = limits[m, 0]
    while p + 1 < limits[m, 1] and pull > pieces[p + 1, TENSION]:
        p += 1
    found = pieces[p, START]
    if pull == np.inf:
        found = np.inf
    elif pieces[p, SLOPE] > 0.0:
        found += (pull - pieces[p, TENSION]) / pieces[p, SLOPE]
    if plant.yields[m]:
        found = max(found, plant.permanent[m] + pull / plant.stiffness[m])
    return found


@alone(None)
def yield_strings(table: int, t: float) -> None:
    """Keep how far strings that yield have been stretched, at a state that a run has come to; what they lose by it.

    A string that turned back within the step before was longest there, by the cubic of its stretch and rate at both
    ends. Where a winch works on it meanwhile, its longest at the ends counts.
    """
    plant = PlantView(table)
    yields, broken, permanent, last = plant.yields, plant.broken, plant.permanent, plant.last_stretch
    lengths, rates, rest, winch = plant.lengths, plant.rates, plant.rest, plant.winch
    held = plant.mode != CONTINUOUS and not plant.holds_force_density
    for m in range(len(yields)):
        if not yields[m]:
            continue
        s, v = lengths[m] - rest[m], rates[m]
        longest, h = s, t - plant.yielded_at
        if held and h > 0.0 and last[m, 1] > 0.0 > v:
            s0, d0 = last[m, 0], h * last[m, 1]
            longest = max(s, cubic(turn_of_cubic(s0, s, d0, h * v), s0, s, d0, h * v))
        last[m, 0], last[m, 1] = s, v
        if longest <= 0.0 or broken[m]:
            continue
        pull = _polygon(plant, m, longest)
        found = longest - pull / plant.stiffness[m]
        if found > permanent[m]:
            permanent[m] = found
            spent = _spent(plant, m, longest)
            winch[2] += spent - last[m, 3]
            if plant.holds_force_density:
                winch[0] += spent - last[m, 3]
            last[m, 2], last[m, 3] = longest, spent
    plant.yielded_at = t


@borrowing
def _spent(plant: Any, m: int, longest: float) -> float:
    """Return the energy [J] that a string that yields has lost, from its largest stretch."""
    pull = _polygon(plant, m, longest)
    return _work(plant, m, longest) - 0.5 * pull * pull / plant.stiffness[m]


@alone(0.0)
def spent_since(table: int) -> float:
    """Sum the energy [J] that yielding strings, now longer than ever, have lost since the last state that was kept."""
    plant = PlantView(table)
    yields, broken, last, total = plant.yields, plant.broken, plant.last_stretch, 0.0
    for m in range(len(yields)):
        s = plant.lengths[m] - plant.rest[m]
        if yields[m] and not broken[m] and s > last[m, 2]:
            total += _spent(plant, m, s) - last[m, 3]
    return total


@borrowing
def corner_between(plant: Any, m: int, before: float, after: float) -> float:
    """The first corner of a string's tension between two stretches, the first of them above zero; 0 for none."""
    pieces, limits, largest = plant.pieces, plant.piece_ranges, plant.last_stretch[m, 2]
    at = _piece(plant, m, before)
    if plant.yields[m] and before < largest:  # on the line from the largest stretch
        return largest if after > largest else 0.0
    if after > before:
        return pieces[at + 1, START] if at + 1 < limits[m, 1] and after > pieces[at + 1, START] else 0.0
    return pieces[at, START] if after <= pieces[at, START] and not plant.yields[m] else 0.0


@borrowing
def cubic(x: float, s0: float, s1: float, d0: float, d1: float) -> float:
    """Evaluate at 0 <= x <= 1 the cubic with values s0 and s1 and derivatives d0 and d1 at 0 and 1."""
    r = 1.0 - x
    return r * r * ((1.0 + 2.0 * x) * s0 + x * d0) + x * x * ((3.0 - 2.0 * x) * s1 - r * d1)


@borrowing
def turn_of_cubic(s0: float, s1: float, d0: float, d1: float) -> float:
    """Find the x where the cubic's derivative a x² + b x + d0 changes its sign, which it does once between 0 and 1."""
    a, b = 6.0 * (s0 - s1) + 3.0 * (d0 + d1), -6.0 * (s0 - s1) - 4.0 * d0 - 2.0 * d1
    root = np.sqrt(max(b * b - 4.0 * a * d0, 0.0))
    q = -0.5 * (b + root if b > 0.0 else b - root)
    return d0 / q if q != 0.0 and 0.0 < d0 / q < 1.0 else q / a


@borrowing
def cubic_root(s0: float, s1: float, d0: float, d1: float) -> float:
    """Find the x between 0 and 1 where a cubic changes its sign, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        x = 0.5 * (low + high)
        if (cubic(x, s0, s1, d0, d1) > 0.0) == (s1 > 0.0):
            high = x
        else:
            low = x
    return 0.5 * (low + high)


@borrowing
def dip(s0: float, s1: float, d0: float, d1: float) -> float:
    """Find the turning point of a cubic that changes its sign twice between 0 and 1; 1 where there is none."""
    found = 1.0
    if d0 * d1 < 0.0 and (s0 > 0.0) == (s1 > 0.0) and (s0 > 0.0) != (d0 > 0.0):
        x = turn_of_cubic(s0, s1, d0, d1)
        if 0.0 < x < 1.0 and (cubic(x, s0, s1, d0, d1) > 0.0) != (s0 > 0.0):
            found = x
    return found
