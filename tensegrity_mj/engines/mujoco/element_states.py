"""The states of elements, integrated with the weights of MuJoCo's integrator: at every stage of RK4, or once a step.

They become those of a whole step with its last stage alone. Where trial steps are taken back (`located`), so are they.
"""

from __future__ import annotations

from typing import Any

from tensegrity_mj.dynamics.native.elements import let_act
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing

SEEN, RATES, WHOLE, SUM = range(4)  # rows of the states: see `plant_view`


@borrowing
def act_at_stage(table: int, t: float, stage: int, stages: int, h: float) -> Any:
    """`let_act` at a stage of a step of h [s], the elements' states being those of the stage."""
    plant = PlantView(table)
    S, states = plant.element_state_count, plant.element_states
    if S == 0:
        return let_act(table, t)
    ahead = 0.0 if stage == 0 else h if stage == 3 else 0.5 * h
    for k in range(S):
        states[SEEN, k] = states[WHOLE, k] + ahead * states[RATES, k]
    powers = let_act(table, t)
    weight = 1.0 if stage == 0 or stage == 3 else 2.0
    for k in range(S):
        states[SUM, k] = weight * states[RATES, k] + (0.0 if stage == 0 else states[SUM, k])
        if stage == stages - 1:
            states[WHOLE, k] += h * states[SUM, k] / (1.0 if stages == 1 else 6.0)
    return powers
