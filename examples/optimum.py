"""The least of an array function within equations and limits: SciPy's SLSQP on derivatives of JAX.

    best = least(functions, start, bounds)      # functions(y) -> cost (), equal (e,) = 0, inside (i,) >= 0
    best.y, best.cost, best.residual, best.active

SLSQP finds one least value near its start, of several perhaps; `residual` says whether it is one, by the equations of
Karush, Kuhn and Tucker. Variables, cost and limits should have units in which they are about one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import lsq_linear, minimize

from tensegrity_mj.basics.arrays import Array, IntArray

TIGHT = 1e-6  # a limit or bound that is nearer is active
GAIN = 1e-13  # of the cost: SLSQP stops at steps that gain less
MOST = 1000  # iterations


@dataclass(frozen=True, eq=False)
class Optimum:
    """A least value.

    Attributes:
        y: (y,) where it is.
        cost: its value.
        residual: |∇cost - Σ multipliers ∇(active limits)| over |∇cost|, on what was free; 0 at an optimum.
        active: rows of `inside` that are at their limits.
        violation: the most that an equation or limit is missed by.
        iterations: how many it took.
        converged: whether SLSQP says so, or residual and violation are small: round-off may leave it no better step.
    """

    y: Array
    cost: float
    residual: float
    active: IntArray
    violation: float
    iterations: int
    converged: bool


def least(
    functions: Callable[..., tuple[Any, Any, Any]],
    start: ArrayLike,
    bounds: ArrayLike,
    *,
    arguments: Sequence[Any] = (),
    kept: int = 0,
) -> Optimum:
    """The least cost from a start.

    Args:
        functions: (y, *arguments) -> cost (), equal (e,) that are to be 0, inside (i,) that are to be >= 0. It is
            compiled once for all calls with the same function.
        start: (y,); it may violate equations and limits.
        bounds: (y, 2), least and largest.
        arguments: further arguments of the functions, floats or arrays.
        kept: how many of the first entries of y stay as they are at the start.
    """
    whole, limits = np.array(start, float), np.asarray(bounds, float)[kept:]

    @lru_cache(maxsize=2)
    def evaluated(kind: int, free: bytes) -> list[Array]:
        """Values (0) or slopes (1), which SLSQP wants one by one."""
        y = np.concatenate([whole[:kept], np.frombuffer(free)])
        return [np.asarray(one) for one in _compiled(functions)[kind](y, *arguments)]

    def part(row: int) -> dict[str, Any]:
        return {
            "fun": lambda free: evaluated(0, free.tobytes())[row],
            "jac": lambda free: evaluated(1, free.tobytes())[row][..., kept:],
        }

    found = minimize(
        **part(0),
        x0=whole[kept:],
        method="SLSQP",
        bounds=limits,
        constraints=[{"type": "eq"} | part(1), {"type": "ineq"} | part(2)],
        options={"ftol": GAIN, "maxiter": MOST},
    )
    cost, equal, inside = evaluated(0, found.x.tobytes())
    down, across, inward = (one[..., kept:] for one in evaluated(1, found.x.tobytes()))
    active, edges = np.flatnonzero(inside < TIGHT), np.eye(len(found.x))
    low, high = found.x - limits[:, 0] < TIGHT, limits[:, 1] - found.x < TIGHT
    normals = np.vstack([across, inward[active], edges[low], -edges[high]])
    signs = np.where(np.arange(len(normals)) < len(equal), -np.inf, 0.0)
    left = lsq_linear(normals.T, down, bounds=(signs, np.inf), tol=1e-14).fun if len(normals) else down
    residual = float(np.linalg.norm(left) / np.linalg.norm(down))
    violation = float(max(np.abs(equal).max(initial=0.0), -inside.min(initial=0.0)))
    return Optimum(
        y=np.concatenate([whole[:kept], found.x]),
        cost=float(cost),
        residual=residual,
        active=active,
        violation=violation,
        iterations=int(found.nit),
        converged=bool(found.success) or max(residual, violation) < TIGHT,
    )


@lru_cache(maxsize=32)
def _compiled(functions: Callable[..., tuple[Any, Any, Any]]) -> tuple[Any, Any]:
    """The functions, and their derivatives by y."""
    return jax.jit(functions), jax.jit(jax.jacfwd(functions))
