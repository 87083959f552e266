"""What two runs may differ in: one table for comparisons, and for commands, plots and pages that show them."""

from __future__ import annotations

from typing import NamedTuple


class Difference(NamedTuple):
    """A quantity that two runs may differ in: what its error is called, what it is of, and the unit of both."""

    words: str
    of: str
    unit: str


# By their names in `runs.comparison.Comparison`.
DIFFERENCES = {
    "node_error": Difference("node error", "node positions", "m"),
    "velocity_error": Difference("velocity error", "node velocities", "m/s"),
    "tension_error": Difference("tension error", "string tensions", "N"),
    "rod_force_error": Difference("rod force error", "rod forces", "N"),
    "force_density_error": Difference("force density (u) error", "controls u", "N/m"),
    "rest_length_error": Difference("rest length error", "rest lengths", "m"),
    "energy_error": Difference("energy error", "total energy", "J"),
}
UNITS = tuple(dict.fromkeys(difference.unit for difference in DIFFERENCES.values()))
