"""How chains and nets of rods hang: the nodes at which their weight is lowest, to round-off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import positive, real_array
from tensegrity_mj.errors import InfeasibleError, OptionError

STIFFNESSES = (1e2, 1e4)  # of the springs that stand in for rods at first, in units of weight a length
ITERATIONS = 60
RESIDUAL = 1e-13  # of forces and lengths, in units of the weight and of the longest rod: near round-off
ACCEPTED = 1e-9  # beyond it, nothing was found
GIVE = 1e-13  # what decides between force densities of rods that hold each other more than once


@dataclass(frozen=True, eq=False)
class Hanging:
    """An equilibrium under gravity.

    Attributes:
        nodes: (N, 3) [m].
        force_densities: (R,) of the rods [N/m], positive in tension, as if the weight of each was on its ends.
        residual: largest force [N] left on a node that may move.
    """

    nodes: Array
    force_densities: Array
    residual: float


def hang(
    nodes: ArrayLike,
    rods: Sequence[tuple[int, int]],
    lengths: ArrayLike,
    masses: ArrayLike,
    held: Sequence[int],
    gravity: float = 9.81,
) -> Hanging:
    """The equilibrium of rigid rods that hang from held nodes, near a first guess.

    Newton's method solves the conditions of the least potential energy: forces in balance at every node, and lengths as
    they are. Where it finds none from the guess, or one in which rods are compressed, it starts again from the least
    energy with stiff springs in place of the rods.

    Args:
        nodes: (N, 3) [m] the guess; held nodes are where they are given.
        rods: pairs of node rows.
        lengths: (R,) [m].
        masses: (R,) [kg].
        held: node rows that are fixed.
        gravity: [m/s²], along -z.

    Raises:
        OptionError: for arrays of other shapes, rows that are none, or lengths and masses that are not > 0.
        InfeasibleError: where no equilibrium is found: held nodes too far from each other, for one.
    """
    count = len(nodes if isinstance(nodes, Sequence) else np.atleast_1d(nodes))
    guess = np.array(real_array("nodes", nodes, (max(1, count), 3), "m", scalar=False))
    pairs = _rows("rods", rods, 2, len(guess))
    fixed = _rows("held", held, 1, len(guess))
    if not len(pairs) or not len(fixed):
        raise OptionError(f"hang: {len(pairs)} rods and {len(fixed)} held nodes; give at least one of each")
    if np.any(pairs[:, 0] == pairs[:, 1]):
        row = int(np.argmax(pairs[:, 0] == pairs[:, 1]))
        raise OptionError(f"rods: row {row} joins node {pairs[row, 0]} to itself; a rod has two different nodes")
    ell = real_array("lengths", lengths, (len(pairs),), "m")
    mass = real_array("masses", masses, (len(pairs),), "kg")
    for what, column, measure in (("lengths", ell, "m"), ("masses", mass, "kg")):
        if not np.all(column > 0):
            raise OptionError(f"{what}: the smallest is {column.min():g} {measure}; all must be > 0 {measure}")
    # Lengths in the longest rod, forces in the whole weight.
    unit, total = float(ell.max()), float(mass.sum()) * positive("gravity", gravity, "m/s²")
    weight = np.zeros(len(guess))
    np.add.at(weight, pairs.ravel(), np.repeat(mass / 2, 2))
    web = _Web(guess / unit, pairs, ell / unit, weight / weight.sum(), np.setdiff1d(np.arange(len(guess)), fixed))
    # Where every rod pulls, the equilibrium is a stable one, however it was found.
    flat, density, residual = web.balanced(web.start[web.free].ravel(), np.ones(len(pairs)))
    if not (residual <= ACCEPTED and np.all(density > 0)):
        flat, density, residual = web.balanced(*web.sprung())
    if not residual <= ACCEPTED:
        raise InfeasibleError(
            f"the rods hang in no equilibrium that could be found (off by {residual:.2g} of their weight or length): "
            "held nodes may be too far from each other, or the first guess too far from where it hangs"
        )
    return Hanging(web.place(flat) * unit, density * total / unit, residual * total)


def _rows(what: str, values: Sequence[object], width: int, count: int) -> IntArray:
    """Node rows (n, width), checked to be some of `count`."""
    try:
        array = np.array(values)
        found = array.astype(np.int64).reshape(-1, width)
        valid = not array.size or (array.dtype.kind in "iu" and found.min() >= 0 and found.max() < count)
    except (TypeError, ValueError, OverflowError):
        valid = False
    if not valid:
        raise OptionError(f"{what} = {values!r}; they must be node rows, integers from 0 to {count - 1}")
    return found


@dataclass(frozen=True, eq=False)
class _Web:
    """Rods between nodes in units of their own: start (N, 3), pairs and lengths (R,), weights (N,), rows that move."""

    start: Array
    pairs: IntArray
    lengths: Array
    weight: Array
    free: IntArray

    def place(self, flat: Array) -> Array:
        """All nodes (N, 3) of the coordinates of those that move."""
        full = np.array(self.start)
        full[self.free] = flat.reshape(-1, 3)
        return full

    def stretched(self, flat: Array) -> tuple[Array, Array]:
        """From end to end (R, 3), and how much their squares exceed those of the lengths (R,)."""
        x = self.place(flat)
        b = x[self.pairs[:, 1]] - x[self.pairs[:, 0]]
        return b, np.sum(b * b, axis=1) - self.lengths**2

    def slope(self, density: Array, b: Array) -> Array:
        """Of the energy: weights, and rods of these force densities, along each coordinate that moves."""
        total = np.zeros_like(self.start)
        np.add.at(total, self.pairs[:, 1], density[:, None] * b)
        np.add.at(total, self.pairs[:, 0], -density[:, None] * b)
        total[:, 2] += self.weight
        return np.asarray(total[self.free].ravel())

    def sprung(self) -> tuple[Array, Array]:
        """Coordinates of least energy with springs for rods, and their force densities."""
        from scipy.optimize import minimize

        flat, density = self.start[self.free].ravel(), np.zeros(len(self.pairs))
        for stiffness in STIFFNESSES:

            def energy(flat: Array, stiffness: float = stiffness) -> tuple[float, Array]:
                b, excess = self.stretched(flat)
                height = float(self.weight @ self.place(flat)[:, 2])
                return height + 0.25 * stiffness * float(excess @ excess), self.slope(stiffness * excess, b)

            flat = minimize(energy, flat, jac=True, method="L-BFGS-B", options={"maxiter": 5000, "maxfun": 20000}).x
            density = stiffness * self.stretched(flat)[1]
        return flat, density

    def balanced(self, flat: Array, density: Array) -> tuple[Array, Array, float]:
        """Newton's method: the best coordinates and force densities once round-off is reached, and what is left."""
        from scipy.sparse.linalg import spsolve

        best, n = (flat, density, np.inf), len(flat)
        for _ in range(ITERATIONS):
            b, excess = self.stretched(flat)
            right = np.concatenate([self.slope(density, b), 0.5 * excess])
            residual = float(np.abs(right).max())
            if not np.isfinite(residual):
                break
            halved = residual < 0.5 * best[2]
            if residual < best[2]:
                best = (flat, density, residual)
            if residual <= RESIDUAL and not halved:
                break
            step = spsolve(self.matrix(density, b), -right)
            # No node moves farther than half a rod at once.
            part = min(1.0, 0.5 / max(float(np.abs(step[:n]).max(initial=0.0)), 1e-300))
            flat, density = flat + part * step[:n], density + part * step[n:]
        return best

    def matrix(self, density: Array, b: Array) -> object:
        """Derivative of slope and half the excess by coordinates and force densities, sparse."""
        from scipy.sparse import coo_matrix

        n, R = 3 * len(self.free), len(self.pairs)
        column = np.full(len(self.weight), -1)
        column[self.free] = 3 * np.arange(len(self.free))
        rows, columns, values = [np.arange(n, n + R)], [np.arange(n, n + R)], [np.full(R, -GIVE)]
        for one, sign in ((0, -1.0), (1, 1.0)):
            mine = column[self.pairs[:, one]]
            for other in (0, 1):
                theirs = column[self.pairs[:, other]]
                both = (mine >= 0) & (theirs >= 0)
                rows.append((mine[both, None] + np.arange(3)).ravel())
                columns.append((theirs[both, None] + np.arange(3)).ravel())
                values.append(np.repeat((1.0 if one == other else -1.0) * density[both], 3))
            there = mine >= 0
            at, line = (mine[there, None] + np.arange(3)).ravel(), np.repeat(n + np.flatnonzero(there), 3)
            rows += [at, line]
            columns += [line, at]
            values += [(sign * b[there]).ravel()] * 2
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return coo_matrix(entries, shape=(n + R, n + R)).tocsc()
