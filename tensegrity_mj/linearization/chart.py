"""The chart of linear models: coordinates δ about a state that are built from that state alone.

For each rod the translations z - z₀ along its support's `translation_basis`, then the central projection of b onto the
tangent plane at b₀, or b - b₀ of an elastic rod; for each point mass its translations. See the text of `linearization`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.assembly import AssemblyRecords, needs_assembly, slopes_of
from tensegrity_mj.dynamics.linked import LinkedRecords, loop_matrix
from tensegrity_mj.model.members import null_space_basis
from tensegrity_mj.model.structure import Structure

RANK = 1e-9  # of the largest: below it, a constraint says what others say already
NEWTON_STEPS = 30


class Chart:
    """Coordinates δ about a state, and the state of (δ, δ̇).

    Rods that hang on others have no translations of their own. Where joints close loops, as many δ as the loops
    determine are left out, and are found from the others by Newton's method; which ones is chosen by pivoting, so that
    the others determine them best.

    Attributes:
        size: n, the number of coordinates δ.
        names: (n,) of them.
    """

    def __init__(self, structure: Structure, nodes: Array) -> None:
        self.records = records = LinkedRecords.of(structure)
        self.q0, self._elastic = records.coordinates(nodes), structure.elastic
        names: list[str] = []
        roots, count = records.forest.parent < 0, len(records.rods)
        self._b0, self._T = np.zeros((count, 3)), np.zeros((count, 3, 2))
        straight, turned, parts = [], [], []  # (in q, in δ) of z; (rod, component, in δ) of δ_b; (rod, component, in q)
        for number, rod in enumerate(records.rods):
            at, nz, nb = int(rod["q"]), int(rod["nz"]) if roots[number] else 0, int(rod["nb"])
            label = f"rod {structure.rods[number].name}"
            if structure.elastic[number]:
                straight += [(at + k, len(names) + k) for k in range(nz + nb)]
                names += [f"{label}: z{k + 1}" for k in range(nz)] + [f"{label}: b{k + 1}" for k in range(nb)]
                continue
            b0 = self.q0[at + nz : at + nz + nb]
            b0 = b0 / np.linalg.norm(b0)
            self._b0[number, :nb] = b0
            self._T[number, :nb, : nb - 1] = null_space_basis(b0[None]) if nb == 3 else [[-b0[1]], [b0[0]]]
            straight += [(at + k, len(names) + k) for k in range(nz)]
            turned += [(number, k, len(names) + nz + k) for k in range(nb - 1)]
            parts += [(number, k, at + nz + k) for k in range(nb)]
            names += [f"{label}: z{k + 1}" for k in range(nz)] + [f"{label}: b{k + 1}" for k in range(nb - 1)]
        for number, point in enumerate(records.points):
            at, nz = int(point["q"]), int(point["nz"])
            straight += [(at + k, len(names) + k) for k in range(nz)]
            names += [f"point mass {structure.lone_masses[number].node}: z{k + 1}" for k in range(nz)]
        self._straight = np.array(straight, np.int64).reshape(-1, 2).T
        self._turned = np.array(turned, np.int64).reshape(-1, 3).T
        self._parts = np.array(parts, np.int64).reshape(-1, 3).T
        self._all = len(names)
        self._loops, self._start = loop_matrix(records), np.zeros(self._all)
        self._choose(names)

    def state(self, delta: Array, rate: Array) -> tuple[Array, Array]:
        """Node positions and velocities (N, 3) of δ, δ̇ (n,)."""
        return self.records.place(*self._q(*self._completed(delta, rate)))

    def _choose(self, names: Sequence[str]) -> None:
        """Choose the coordinates that the constraints determine, and those that are left."""
        self._chosen, self._determined = np.arange(len(names)), np.arange(0)
        slopes = self._slopes(self._start)
        if len(slopes):
            from scipy.linalg import qr

            _, R, order = qr(slopes, mode="economic", pivoting=True)
            sizes = np.abs(np.diag(R))
            rank = int(np.sum(sizes > RANK * sizes.max(initial=0.0)))
            self._determined, self._chosen = np.sort(order[:rank]), np.sort(order[rank:])
        self.names = tuple(names[k] for k in self._chosen.tolist())
        self.size = len(self.names)

    @property
    def has_loops(self) -> bool:
        """True where some δ follow from others."""
        return len(self._determined) > 0

    def coordinates(self, nodes: Array, velocities: Array) -> tuple[Array, Array]:
        """Coordinates δ, δ̇ (n,) of node positions and velocities (N, 3); every b within a right angle of b₀."""
        q, q_rate = self.records.coordinates(nodes), self.records.coordinates(velocities)
        delta, rate = np.zeros(self._all), np.zeros(self._all)
        in_q, in_delta = self._straight
        delta[in_delta], rate[in_delta] = q[in_q] - self.q0[in_q], q_rate[in_q]
        (b, along), (b_rate, along_rate) = self._directions(q), self._directions(q_rate)
        along = np.where(self._elastic[:, None], 1.0, along)
        x = self._across(b) / along
        rods, columns, places = self._turned
        delta[places] = x[rods, columns]
        rate[places] = ((self._across(b_rate) - x * along_rate) / along)[rods, columns]
        return delta[self._chosen], rate[self._chosen]

    def accelerations(self, delta: Array, rate: Array, nodes: Array) -> Array:
        """Accelerations δ̈ (n,) of those of nodes (N, 3) at δ, δ̇: of δ_b = Tᵀ b / (b₀ᵀ b), differentiated twice."""
        delta, rate = self._completed(delta, rate)
        q_acc = self.records.coordinates(nodes)
        out = np.zeros(self._all)
        in_q, in_delta = self._straight
        out[in_delta] = q_acc[in_q]
        x, v = self._turns(delta), self._turns(rate)
        norm = np.sqrt(1 + np.sum(x * x, axis=1, keepdims=True))
        s = 1 / norm  # b₀ᵀ b
        s_rate = -np.sum(x * v, axis=1, keepdims=True) / norm**3
        b_acc, along_acc = self._directions(q_acc)
        rods, columns, places = self._turned
        out[places] = ((self._across(b_acc) - x * along_acc - 2 * v * s_rate) / s)[rods, columns]
        return out[self._chosen]

    def _directions(self, q: Array) -> tuple[Array, Array]:
        """Directions b (R, 3) of q, zero where a planar rod has no third component, and b₀ᵀ b (R, 1)."""
        rods, columns, places = self._parts
        b = np.zeros_like(self._b0)
        b[rods, columns] = q[places]
        return b, np.sum(self._b0 * b, axis=1, keepdims=True)

    def _across(self, b: Array) -> Array:
        """Components Tᵀ b (R, 2) across b₀."""
        return np.einsum("rki,rk->ri", self._T, b)

    def _turns(self, delta: Array) -> Array:
        """δ_b (R, 2) of all δ, the second of a planar rod zero."""
        rods, columns, places = self._turned
        x = np.zeros((len(self._b0), 2))
        x[rods, columns] = delta[places]
        return x

    def _q(self, delta: Array, rate: Array) -> tuple[Array, Array]:
        """Return q and q̇ of all δ, δ̇."""
        q, q_rate = self.q0.copy(), np.zeros_like(self.q0)
        in_q, in_delta = self._straight
        q[in_q] += delta[in_delta]
        q_rate[in_q] = rate[in_delta]
        x, v = self._turns(delta), self._turns(rate)
        norm = np.sqrt(1 + np.sum(x * x, axis=1, keepdims=True))
        b = (self._b0 + np.einsum("rki,ri->rk", self._T, x)) / norm
        b_rate = (np.einsum("rki,ri->rk", self._T, v) - b * (np.sum(x * v, axis=1, keepdims=True) / norm)) / norm
        rods, columns, places = self._parts
        q[places], q_rate[places] = b[rods, columns], b_rate[rods, columns]
        return q, q_rate

    def _slopes(self, delta: Array) -> Array:
        """Derivatives of the loops' gaps (3C, all δ)."""
        out = np.zeros((len(self._loops), self._all))
        in_q, in_delta = (part[self._straight[0] < self._loops.shape[1]] for part in self._straight)
        out[:, in_delta] = self._loops[:, in_q]
        x = self._turns(delta)
        norm = np.sqrt(1 + np.sum(x * x, axis=1))[:, None, None]
        b = (self._b0 + np.einsum("rki,ri->rk", self._T, x))[:, :, None] / norm
        turned = (self._T - b * x[:, None, :] / norm) / norm
        loops = np.zeros((len(self._loops), *self._b0.shape))
        rods, columns, places = self._parts
        loops[:, rods, columns] = self._loops[:, places]
        rods, columns, places = self._turned
        out[:, places] = np.einsum("crk,rki->cri", loops, turned)[:, rods, columns]
        return out

    def _completed(self, delta: Array, rate: Array) -> tuple[Array, Array]:
        """All δ, δ̇ of those chosen, with every constraint met."""
        full, full_rate = self._start.copy(), np.zeros_like(self._start)
        full[self._chosen] += delta
        full_rate[self._chosen] = rate
        if not len(self._determined):
            return full, full_rate
        before = np.inf
        for _ in range(NEWTON_STEPS):
            gap = self._gap(full)
            size = float(np.abs(gap).max(initial=0.0))
            if size == 0 or size > 0.5 * before:
                break
            before = size
            slopes = self._slopes(full)[:, self._determined]
            full[self._determined] -= np.linalg.lstsq(slopes, gap, rcond=RANK)[0]
        slopes = self._slopes(full)
        pushed = slopes[:, self._chosen] @ rate
        full_rate[self._determined] = -np.linalg.lstsq(slopes[:, self._determined], pushed, rcond=RANK)[0]
        return full, full_rate

    def _gap(self, delta: Array) -> Array:
        """Gaps (3C,) of the loops."""
        return np.asarray(self._loops @ (self._q(delta, 0 * delta)[0] - self.q0)[: self._loops.shape[1]])

    def lever(self, k: int) -> float:
        """Distance [m] or 1 that the farthest node moves for a unit of δ_k."""
        unit = np.zeros(self.size)
        unit[k] = 1.0
        return float(np.linalg.norm(self.state(np.zeros(self.size), unit)[1], axis=1).max())


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
        """Coordinates δ, δ̇ (n,) of node positions and velocities (N, 3)."""
        q, rates = self.system.state(nodes, velocities)
        return (q - self._start)[self._chosen], rates[self._chosen]

    def accelerations(self, delta: Array, rate: Array, nodes: Array) -> Array:
        """Accelerations δ̈ (n,) of those of nodes (N, 3), in which q̈ is linear."""
        return self.system.state(nodes, nodes)[0][self._chosen]


def chart_of(structure: Structure, nodes: Array) -> Chart:
    """The chart of a structure's linear models about nodes (N, 3)."""
    return AssembledChart(structure, nodes) if needs_assembly(structure) else Chart(structure, nodes)
