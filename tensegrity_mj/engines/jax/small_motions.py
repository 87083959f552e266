"""Natural frequencies as an array function: ω² of K φ = ω² M φ, and their derivatives φᵀ (dK - ω² dM) φ.

φ has unit modal mass. Jacobi's derivative needs none of φ, which equal ω² would make infinite. Where some are equal,
it is right for changes that keep them equal, as those do that keep a structure's symmetry. Changes that split them have
derivatives along single directions only: those of a group of equal ω² then belong to one choice of φ among many.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular


@jax.custom_jvp
def frequency_squares(K: Any, M: Any) -> Any:
    """ω² (t,) [1/s²], ascending, for symmetric K [N/m] and symmetric M [kg] > 0, both (t, t)."""
    return _pairs(K, M)[0]


@frequency_squares.defjvp
def _change(at: tuple[Any, Any], by: tuple[Any, Any]) -> tuple[Any, Any]:
    squares, shapes = _pairs(*at)
    dK, dM = by
    return squares, jnp.sum(shapes * (dK @ shapes), axis=0) - squares * jnp.sum(shapes * (dM @ shapes), axis=0)


def _pairs(K: Any, M: Any) -> tuple[Any, Any]:
    """ω² (t,) and shapes (t, t) of unit modal mass, a column each."""
    root = jnp.linalg.cholesky(M)
    half = solve_triangular(root, K, lower=True)
    squares, turned = jnp.linalg.eigh(solve_triangular(root, half.T, lower=True))
    return squares, solve_triangular(root, turned, lower=True, trans=1)
