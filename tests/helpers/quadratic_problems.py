"""Random quadratic programs of force densities, and the compiled search on them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.controllers.quadratic_program import Program, columns_of, maximize_dual

Array = NDArray[np.float64]


class Problem(NamedTuple):
    """minimise ½ Σ h u² subject to A u = d, S u >= s, lo <= u <= hi."""

    A: Array
    d: Array
    S: Array
    s: Array
    h: Array
    lo: Array
    hi: Array


def random_problem(rng: np.random.Generator, feasible: bool) -> Problem:
    """Sparse or dense, with rows that depend on each other, and often with the only solution at many bounds."""
    M = int(rng.integers(2, 30))
    n, L = int(rng.integers(0, M)), int(rng.integers(0, 4))
    A = rng.normal(size=(n, M)) * (rng.random((n, M)) < rng.choice([0.3, 1.0]))
    if n > 2 and rng.random() < 0.3:
        A[n - 1] = A[0] + A[1]
    S = (rng.random((L, M)) < 0.5).astype(float)
    lo = np.where(rng.random(M) < 0.5, 0.0, rng.random(M))
    hi = np.where(rng.random(M) < 0.5, np.inf, lo + 3 * rng.random(M))
    h = np.exp(rng.normal(size=M))
    if not feasible:
        return Problem(A, rng.normal(size=n), S, rng.normal(size=L), h, lo, hi)
    u = np.clip(np.where(rng.random(M) < 0.4, lo, rng.exponential(size=M)), lo, hi)
    return Problem(A, A @ u, S, S @ u - rng.exponential(size=L) * (rng.random(L) < 0.5), h, lo, hi)


def solve(p: Problem, start: Array | None = None) -> tuple[int, Array]:
    """Status and u of the compiled search."""
    b = np.concatenate([p.d, p.s])
    y = np.zeros(len(b)) if start is None else start.copy()
    u = np.empty(len(p.h))
    program = Program(columns_of(p.A, p.S), len(p.d), p.h, p.lo, p.hi, b)
    status, _ = maximize_dual(program, np.zeros_like(b), 0.0, y, u, 200)
    return status, u
