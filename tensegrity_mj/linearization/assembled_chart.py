"""The chart of linear models of any structure: those coordinates of it as one system that determine the others best."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.assembly import AssemblyRecords, needs_assembly, slopes_of
from tensegrity_mj.linearization.chart import Chart
from tensegrity_mj.model.structure import Structure

RANK = 1e-9  # of the largest: below it, a constraint says what others say already
NEWTON_STEPS = 30


class AssembledChart:
    """Coordinates δ about a state, changes of some of q; all others follow from the constraints by Newton's method.

    Attributes:
        size: n, the number of coordinates δ.
        names: (n,) of them.
        has_loops: steps are those of structures with loops, where others follow as well.
    """

    has_loops = True

    def __init__(self, structure: Structure, nodes: Array) -> None:
        from scipy.linalg import qr

        self.records = AssemblyRecords.of(structure, (), np.zeros((0, 3, 3)))
        self.q0, _ = self.records.state(nodes, nodes)
        _, R, order = qr(slopes_of(self.records.table, self.q0), mode="economic", pivoting=True)
        sizes = np.abs(np.diag(R))
        rank = int(np.sum(sizes > RANK * sizes.max(initial=0.0)))
        self._determined, self._chosen = np.sort(order[:rank]), np.sort(order[rank:])
        self.names = tuple(self.records.coordinate_names[k] for k in self._chosen)
        self.size = len(self.names)

    def state(self, delta: Array, rate: Array) -> tuple[Array, Array]:
        """Node positions and velocities (N, 3) of δ, δ̇ (n,)."""
        table, q, rates = self.records.table, self.q0.copy(), np.zeros_like(self.q0)
        q[self._chosen] += delta
        rates[self._chosen] = rate
        before = np.inf
        for _ in range(NEWTON_STEPS):
            slopes = slopes_of(table, q)
            gap = self.records.deviations(q)
            size = float(np.abs(gap).max(initial=0.0))
            if size == 0 or size > 0.5 * before:
                break
            before = size
            q[self._determined] -= np.linalg.lstsq(slopes[:, self._determined], gap, rcond=RANK)[0]
        pushed = slopes[:, self._chosen] @ rate
        rates[self._determined] = -np.linalg.lstsq(slopes[:, self._determined], pushed, rcond=RANK)[0]
        places = (table["maps"] @ q).reshape(-1, 3) + table["bases"]
        return places, (table["maps"] @ rates).reshape(-1, 3)

    def coordinates(self, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """δ, δ̇ (n,) of node positions and velocities (N, 3)."""
        q, rates = self.records.state(nodes, velocities)
        return (q - self.q0)[self._chosen], rates[self._chosen]

    def accelerations(self, delta: Array, rate: Array, nodes: Array) -> Array:
        """δ̈ (n,) of node accelerations (N, 3), in which q̈ is linear."""
        return self.records.state(nodes, nodes)[0][self._chosen]

    def lever(self, k: int) -> float:
        """[m] or 1: how far the farthest node moves for a unit of δ_k."""
        rates = self.state(np.zeros(self.size), np.eye(self.size)[k])[1]
        return float(np.linalg.norm(rates, axis=1).max())


AnyChart: TypeAlias = Chart | AssembledChart


def chart_of(structure: Structure, nodes: Array) -> AnyChart:
    """The chart of a structure's linear models about nodes (N, 3)."""
    return AssembledChart(structure, nodes) if needs_assembly(structure) else Chart(structure, nodes)
