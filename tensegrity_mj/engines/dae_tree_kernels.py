"""The thesis' own forms of the equations, as the integrators call them; see `dynamics.tree_equations`."""

from __future__ import annotations

from tensegrity_mj.dynamics.tree_equations import dense_accelerations, full_accelerations
from tensegrity_mj.engines.dae_linked_kernels import after, before, given
from tensegrity_mj.engines.integration_kernels import RATES_SIGNATURE, STATE_SIZE
from tensegrity_mj.native.compiling import c_function
from tensegrity_mj.native.plant import TABLE_SIZE
from tensegrity_mj.native.pointers import floats, integers


@c_function(RATES_SIGNATURE)
def dense_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By (3.19)-(3.22)."""
    table = integers(table_at, (TABLE_SIZE,))
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = before(t, y, dy, table)
    dy[len(dy) - 1] += dense_accelerations(*given(y, dy, table))
    after(table)
    return status


@c_function(RATES_SIGNATURE)
def full_rates(t, y_at, dy_at, table_at):  # type: ignore[no-untyped-def]
    """By (3.17)."""
    table = integers(table_at, (TABLE_SIZE,))
    y, dy = floats(y_at, (table[STATE_SIZE],)), floats(dy_at, (table[STATE_SIZE],))
    status = before(t, y, dy, table)
    dy[len(dy) - 1] += full_accelerations(*given(y, dy, table))
    after(table)
    return status
