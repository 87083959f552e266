"""The chart of linear models of any structure: those coordinates of it as one system that determine the others best."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.assembly import AssemblyRecords, needs_assembly, slopes_of
from tensegrity_mj.linearization.chart import Chart
from tensegrity_mj.model.structure import Structure


class AssembledChart(Chart):
    """Coordinates δ about a state, changes of some of q; all others follow from the constraints by Newton's method."""

    has_loops = True  # steps are those of structures with loops, where others follow as well

    def __init__(self, structure: Structure, nodes: Array) -> None:
        self.system = AssemblyRecords.of(structure, (), np.zeros((0, 3, 3)))
        self._start, _ = self.system.state(nodes, nodes)
        self._choose(self.system.coordinate_names)

    def state(self, delta: Array, rate: Array) -> tuple[Array, Array]:
        """Node positions and velocities (N, 3) of δ, δ̇ (n,)."""
        table, (q, rates) = self.system.table, self._completed(delta, rate)
        return (table["maps"] @ q).reshape(-1, 3) + table["bases"], (table["maps"] @ rates).reshape(-1, 3)

    def _gap(self, q: Array) -> Array:
        return self.system.deviations(q)

    def _slopes(self, q: Array) -> Array:
        return slopes_of(self.system.table, q)

    def coordinates(self, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """δ, δ̇ (n,) of node positions and velocities (N, 3)."""
        q, rates = self.system.state(nodes, velocities)
        return (q - self._start)[self._chosen], rates[self._chosen]

    def accelerations(self, delta: Array, rate: Array, nodes: Array) -> Array:
        """δ̈ (n,) of node accelerations (N, 3), in which q̈ is linear."""
        return self.system.state(nodes, nodes)[0][self._chosen]


def chart_of(structure: Structure, nodes: Array) -> Chart:
    """The chart of a structure's linear models about nodes (N, 3)."""
    return AssembledChart(structure, nodes) if needs_assembly(structure) else Chart(structure, nodes)
