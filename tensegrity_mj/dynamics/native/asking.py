"""The law's command at a state, for Python: one compiled function that measures the strings and calls the law."""

from __future__ import annotations

from tensegrity_mj.dynamics.native.actuation import ask_law
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.pointers import integers
from tensegrity_mj.dynamics.native.slots import TABLE_SIZE
from tensegrity_mj.dynamics.native.strings import measure_strings


@c_function("int64(int64, float64)", "what a law answers at a state")
def ask_at_nodes(table_at, t):  # type: ignore[no-untyped-def]
    """Measure the strings at the nodes of a plant's table, and write the law's command there; gives its answer."""
    table = integers(table_at, (TABLE_SIZE,))
    measure_strings(table)
    return ask_law(table, t)
