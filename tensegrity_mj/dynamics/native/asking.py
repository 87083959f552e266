"""The law's commands at states, for Python: one compiled function that measures the strings and calls the law."""

from __future__ import annotations

from tensegrity_mj.dynamics.native.actuation import ask_law
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.pointers import copy, floats, integers
from tensegrity_mj.dynamics.native.slots import COMMAND, NODE_COUNT, NODES, STRING_COUNT, TABLE_SIZE, VELOCITIES
from tensegrity_mj.dynamics.native.strings import measure_strings


@c_function("int64(int64, float64, int64, int64, int64)", "what a law answers at states")
def ask_at_states(table_at, t, count, states_at, commands_at):  # type: ignore[no-untyped-def]
    """Ask a plant's law at states (count, 2, N, 3), nodes and velocities, one after the other.

    Writes its commands (count, M); gives its first answer that is not SOLVED, where it ends, or SOLVED.
    """
    table = integers(table_at, (TABLE_SIZE,))
    n, M = 3 * table[NODE_COUNT], table[STRING_COUNT]
    for k in range(count):
        copy(floats(states_at + 16 * n * k, (n,)), floats(table[NODES], (n,)))
        copy(floats(states_at + 16 * n * k + 8 * n, (n,)), floats(table[VELOCITIES], (n,)))
        measure_strings(table)
        status = ask_law(table, t)
        if status != SOLVED:
            return status
        copy(floats(table[COMMAND], (M,)), floats(commands_at + 8 * M * k, (M,)))
    return SOLVED
