"""The law's commands at states, for Python: one compiled function that measures the strings and calls the law."""

from __future__ import annotations

from tensegrity_mj.dynamics.native.actuation import evaluate_law
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import address, copy, floats
from tensegrity_mj.dynamics.native.strings import measure_strings


@c_function("int64(int64, float64, int64, int64, int64)", "what a law answers at states")
def evaluate_at_states(table, t, count, states_at, commands_at):  # type: ignore[no-untyped-def]
    """Evaluate a plant's law at states (count, 2, N, 3), nodes and velocities, one after the other.

    Writes its commands (count, M); gives its first answer that is not SOLVED, where it ends, or SOLVED.
    """
    plant = PlantView(table)
    n, M = 3 * plant.node_count, plant.string_count
    nodes, velocities = floats(address(plant.nodes), n), floats(address(plant.velocities), n)
    for k in range(count):
        copy(floats(states_at + 16 * n * k, n), nodes)
        copy(floats(states_at + 16 * n * k + 8 * n, n), velocities)
        measure_strings(table)
        status = evaluate_law(table, t)
        if status != SOLVED:
            return status
        copy(plant.command, floats(commands_at + 8 * M * k, M))
    return SOLVED
