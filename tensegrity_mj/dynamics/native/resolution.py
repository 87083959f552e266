"""Error estimate of a run's fixed steps, summed in compiled code during the run from the velocities of nodes.

Each node has a sum of local errors [m], that of a step being what the method's own theory makes of differences:

    RK4        |z|⁵/120 of x' = λ x, z = λ h. Its stages' velocities v₁..v₄ give h|v₃ - v₂| = |z|³/4 and
               h|v₄ - 2 v₃ + v₁| = |z|⁴/4 of x; with e₃ and e₄ for these, |z|⁵/120 = e₄²/(30 e₃). Taken within a step,
               so that what jumps between steps (samples of a law, breaks) is none of it.
    Euler      semi-implicit: x is that of velocities half a step off, (h/2) max |v - v₀|, and its frequencies are off
               by (ω h)²/24, a local error of h |Δ²v| / 24. The ones implicit in velocity do as it does.
    discrete   damps with ζ = ω h / 2: a local error of h |Δv| / 2.

It is an estimate: errors neither grow nor cancel in it. A run whose estimate is a part of its motion is not resolved.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.lanes import any_of, select
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing, inlined
from tensegrity_mj.dynamics.native.vectors import minus, row_of

# Kinds: of no fixed step (or steps that are tried and not taken), and those above.
NONE, STAGES, SEMI_IMPLICIT, DISCRETE = range(4)
# Columns, a row a node: start x₀ and v₀; velocities of three stages, the first those of the last step of one-stage
# methods; the sum; the largest |x - x₀| and |v - v₀|; Δv of the last step; how many steps were begun.
X0, V0, FIRST, SECOND, THIRD, SUM, MOVED_BY, VARIED_BY, CHANGE, COUNT = 0, 3, 6, 9, 12, 15, 16, 17, 18, 21


@borrowing
def resolve_start(table: int, h: float) -> None:
    """Update the sums at the start of a step, or at the end of the last one; velocities are those of the state."""
    plant = PlantView(table)
    nodes, velocities, rows, kind = plant.nodes, plant.velocities, plant.resolution, plant.resolution_kind
    if kind == NONE:
        return
    for n in range(len(rows)):
        row, x, v = rows[n], row_of(nodes, n), row_of(velocities, n)
        if any_of(row[COUNT] == 0.0):
            _put(row, X0, x)
            _put(row, V0, v)
        else:
            row[MOVED_BY] = max(row[MOVED_BY], _length(minus(x, _at(row, X0))))
            row[VARIED_BY] = max(row[VARIED_BY], _length(minus(v, _at(row, V0))))
            if kind != STAGES:
                change = minus(v, _at(row, FIRST))
                if kind == DISCRETE:
                    row[SUM] += 0.5 * h * _length(change)
                elif any_of(row[COUNT] > 1.0):
                    row[SUM] += h / 24.0 * _length(minus(change, _at(row, CHANGE)))
                _put(row, CHANGE, change)
        _put(row, FIRST, v)
        row[COUNT] += 1.0


@borrowing
def resolve_stage(table: int, stage: int, h: float) -> None:
    """Record stage 1, 2 or 3 of an RK4 step that `resolve_start` has begun; the last adds the step's local error."""
    plant = PlantView(table)
    if plant.resolution_kind != STAGES:
        return
    velocities, rows = plant.velocities, plant.resolution
    for n in range(len(rows)):
        row, v = rows[n], row_of(velocities, n)
        if stage < 3:
            _put(row, SECOND if stage == 1 else THIRD, v)
            continue
        third = _at(row, THIRD)
        e3 = h * _length(minus(third, _at(row, SECOND)))
        e4 = h * _length(minus(minus(v, third), minus(third, _at(row, FIRST))))
        if any_of(e3 > 0.0):
            row[SUM] += select(e3 > 0.0, min(e4, e4 * e4 / e3) / 30.0, 0.0)


@inlined
def _at(row: Any, place: int) -> Any:
    return row[place], row[place + 1], row[place + 2]


@inlined
def _put(row: Any, place: int, v: Any) -> None:
    row[place], row[place + 1], row[place + 2] = v


@inlined
def _length(v: Any) -> float:
    return np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def unresolved(plant: Plant, h: float) -> tuple[float, float, int]:
    """The estimate of what a run's steps of h [s] left unresolved [m], its motion [m], and the row of the node.

    The motion is the largest distance of any node from its start.
    """
    rows, kind = plant["resolution"], plant["resolution_kind"]
    if kind == NONE or not len(rows):
        return 0.0, 0.0, 0
    errors = rows[:, SUM] + (0.5 * h * rows[:, VARIED_BY] if kind == SEMI_IMPLICIT else 0.0)
    node = int(np.argmax(errors))
    return float(errors[node]), float(rows[:, MOVED_BY].max()), node
