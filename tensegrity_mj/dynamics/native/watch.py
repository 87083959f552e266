"""Counts of impossible commands at every step: rest lengths below zero, and force densities that push.

A rest length L0 <= 0 is exact in the string law, which then pulls as if there were line to spare, and impossible: no
winch hauls in more line than there is. A force density u >= k is the same by L0 = L (1 - u/k). A negative force density
is a push: the string is slack instead. Recorded samples may miss both, so this looks at each step that was taken.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.lanes import any_of, select
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing

# Columns of `watched`, a row a string: of rest lengths and of commands, at how many steps, when first [s], the least.
STEPS, FIRST, LEAST = range(3)
PUSH = 3  # first column of commands
# Round-off of a law's solution, which may be 0 - 1e-17: parts of the largest u, and of the stiffness.
PUSH_ROUND_OFF, STRAIN_ROUND_OFF = 1e-9, 1e-15


@borrowing
def watch_strings(table: int, t: float, answered: bool) -> None:
    """Count what is impossible at a state whose rest lengths are set; `answered`: the command is the law's for it."""
    plant = PlantView(table)
    rest, broken, seen, k = plant.rest, plant.broken, plant.watched, plant.stiffness
    M = len(rest)
    for m in range(M):
        if any_of(rest[m] <= 0.0) and not broken[m]:
            _count(seen[m], (rest[m] <= 0.0) & (k[m] > 0.0), rest[m], t, 0)
    if not answered or plant.returns_lengths:
        return
    command, stiffness, lengths, least = plant.command, plant.stiffness, plant.lengths, plant.min_rest_length
    largest = 0.0
    for m in range(M):
        largest = max(largest, abs(command[m]))
    for m in range(M):
        push = -command[m] > PUSH_ROUND_OFF * largest + STRAIN_ROUND_OFF * stiffness[m]
        if any_of(push) and not broken[m]:
            if plant.limited:
                # Where `min_rest_length` leaves less than zero, the limit is what made it negative.
                push = push & (command[m] < stiffness[m] * (1.0 - least[m] / lengths[m]))
            _count(seen[m], push, command[m], t, PUSH)


@borrowing
def _count(seen: Any, hit: bool, value: float, t: float, at: int) -> None:
    first = hit & (seen[at + STEPS] == 0.0)
    seen[at + FIRST] = select(first, t, seen[at + FIRST])
    least = select(first, value, seen[at + LEAST])
    seen[at + LEAST] = select(hit, min(least, value), seen[at + LEAST])
    seen[at + STEPS] += select(hit, 1.0, 0.0)


def impossible(plant: Plant) -> tuple[dict[str, Any], dict[str, Any]]:
    """Report the rest lengths <= 0 and the commanded force densities < 0 of a plant's run so far.

    Each has "steps", the most steps of one string; "strings", their names, the first one first; "first_time" [s];
    "least", the least value [m] or [N/m] of any. See `NONE`.
    """
    names = [string.name for string in plant.scene.structure.strings]
    seen = plant["watched"]
    return _found(names, seen[:, :PUSH]), _found(names, seen[:, PUSH:])


NONE: dict[str, Any] = {"steps": 0, "strings": [], "first_time": None, "least": None}


def _found(names: list[str], seen: Array) -> dict[str, Any]:
    rows = np.flatnonzero(seen[:, STEPS])
    if not len(rows):
        return NONE
    rows = rows[np.argsort(seen[rows, FIRST], kind="stable")]
    return {
        "steps": int(seen[rows, STEPS].max()),
        "strings": [names[row] for row in rows],
        "first_time": float(seen[rows[0], FIRST]),
        "least": float(seen[rows, LEAST].min()),
    }
