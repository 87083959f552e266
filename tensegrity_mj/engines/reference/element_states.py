"""The states of elements, integrated behind a model's own: y = (the model's `state_size` numbers, the states).

Only scenes that have such elements call these rates; what others call stays the model's own function.
"""

from __future__ import annotations

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.pointers import copy, floats
from tensegrity_mj.engines.reference.equations import RATES_SIGNATURE, ModelView, call_rates


@c_function(RATES_SIGNATURE, "equations of motion with states of elements")
def rates_with_states(t, y_at, dy_at, table):  # type: ignore[no-untyped-def]
    """Elements see their states, act, and leave their rates."""
    model = ModelView(table)
    S, behind, states = model.element_state_count, 8 * model.state_size, model.element_states
    copy(floats(y_at + behind, (S,)), states[0])
    status = call_rates(model.model_rates, t, y_at, dy_at, table)
    copy(states[1], floats(dy_at + behind, (S,)))
    return status
