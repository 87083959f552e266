"""The states of elements, integrated behind a model's own: y = (the model's STATE_SIZE numbers, the states).

Only scenes that have such elements call these rates; what others call stays the model's own function.
"""

from __future__ import annotations

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.pointers import copy, floats, integers
from tensegrity_mj.dynamics.native.slots import ELEMENT_STATE_COUNT, ELEMENT_STATES, TABLE_SIZE
from tensegrity_mj.engines.reference.equations import MODEL_RATES, RATES_SIGNATURE, STATE_SIZE, call_rates


@c_function(RATES_SIGNATURE, "equations of motion with states of elements")
def rates_with_states(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """Elements see their states, act, and leave their rates."""
    table = integers(table_at, (TABLE_SIZE,))
    S, behind = table[ELEMENT_STATE_COUNT], 8 * table[STATE_SIZE]
    states = floats(table[ELEMENT_STATES], (2, S))
    copy(floats(y_at + behind, (S,)), states[0])
    status = call_rates(table[MODEL_RATES], t, y_at, dy_at, table_at)
    copy(states[1], floats(dy_at + behind, (S,)))
    return status
