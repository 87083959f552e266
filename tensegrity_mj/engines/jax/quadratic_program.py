"""Quadratic programs of force densities as array functions, (4.10)-(4.13) of the thesis.

    minimise ½ uᵀHu   subject to   A u = d,   S u >= s,   lo <= u <= hi,   H diagonal

A primal-dual interior-point method finds which strings lie between their bounds and which sums are at theirs. With G
and b the equations and these sums, and the others' u at their bounds, the strings F between them are
u_F = H_F⁻¹ G_Fᵀ y with G_F H_F⁻¹ G_Fᵀ y = b - G_N u_N: that is the answer, and it alone is differentiated. So
derivatives are exact but where a string meets or leaves a bound, or a sum its least value.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

STEPS = 60  # at most; each makes the gap a tenth of what it was, where bounds leave it the way
GAP = 1e-13  # of the products of multipliers and distances from bounds, relative to the first
SHIFT = 1e-13  # of the diagonal of what is solved, since rows may depend on each other; refined away
ACCURACY = 1e-8  # relative to the terms of a row: what misses more has no solution


def least_cost(h: Any, A: Any, d: Any, S: Any, s: Any, lo: Any, hi: Any) -> tuple[Any, Any]:
    """u (M,), not a number where there is none, and the largest violation of a row.

    Args:
        h: (M,) > 0, the diagonal of H.
        A, d, S, s: (n, M), (n,), (L, M), (L,).
        lo, hi: (M,), finite, and finite or infinite.
    """
    n, L = len(d), len(s)
    G, b = jnp.concatenate([A, S]), jnp.concatenate([d, s])
    # Sums have slacks without a cost: S u - t = s, t >= 0.
    wide = jnp.concatenate([G, jnp.concatenate([jnp.zeros((n, L)), -jnp.eye(L)])], axis=1)
    none = jnp.zeros(L)
    bounds = jnp.concatenate([lo, none]), jnp.concatenate([hi, none + jnp.inf])
    low, high = _sides(*jax.lax.stop_gradient((jnp.concatenate([h, none]), wide, b, *bounds)))
    low, high, active = low[: len(h)], high[: len(h)], jnp.concatenate([jnp.ones(n, bool), low[len(h) :]])
    at = jnp.where(low, lo, jnp.where(high, hi, 0.0))
    y, first = _between(h, G, b, at, ~low & ~high, active)
    # Newton's step from there: the better one, where its own multipliers prove it.
    v = jax.lax.stop_gradient(G.T @ y / h)
    y, second = _between(h, G, b, jnp.clip(v, lo, hi), (v > lo) & (v < hi), active)
    proven = jnp.max(jnp.abs(jnp.clip(G.T @ y / h, lo, hi) - second)) <= ACCURACY * jnp.max(jnp.abs(second))
    proven &= jnp.all(y[n:] >= -ACCURACY * jnp.max(jnp.abs(y), initial=0.0))
    better = proven & _meets(G, b, lo, hi, n, second)[0]
    u = jnp.where(better, second, first)
    good, violation = _meets(G, b, lo, hi, n, u)
    return jnp.where(good, u, jnp.nan), violation


def _meets(G: Any, b: Any, lo: Any, hi: Any, n: int, u: Any) -> tuple[Any, Any]:
    """Whether u meets n equations, sums and bounds, and its largest violation of the first two."""
    missed = G @ u - b
    missed = missed.at[n:].set(jnp.minimum(missed[n:], 0.0))
    within = jnp.all(jnp.maximum(lo - u, u - hi) <= ACCURACY * jnp.max(jnp.abs(u)))
    met = jnp.all(jnp.abs(missed) <= ACCURACY * (jnp.abs(G) @ jnp.abs(u) + jnp.abs(b)))
    return within & met, jnp.max(jnp.abs(missed), initial=0.0)


def _between(h: Any, G: Any, b: Any, u: Any, free: Any, active: Any) -> tuple[Any, Any]:
    """y and u, of which those not free are given, for the rows that are active."""
    columns = jnp.where(free & active[:, None], G, 0.0)
    K = (columns / h) @ columns.T
    y, left = jnp.zeros_like(b), jnp.where(active, b - G @ jnp.where(free, 0.0, u), 0.0)
    for _ in range(3):
        y = y + _solved(K, left - K @ y)
    return y, jnp.where(free, columns.T @ y / h, u)


def _solved(K: Any, right: Any) -> Any:
    """K x = right for a positive semidefinite K; rows of zeros have x = 0."""
    diagonal = jnp.diagonal(K)
    scale = jnp.where(diagonal > 0.0, 1.0 / jnp.sqrt(jnp.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    scaled = scale[:, None] * K * scale + jnp.diag(jnp.where(diagonal > 0.0, SHIFT, 1.0))
    return scale * jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(scaled), scale * right)


def _sides(h: Any, G: Any, b: Any, lo: Any, hi: Any) -> tuple[Any, Any]:
    """Which of w (K,) are at their lower and at their upper bounds at the least ½ wᵀHw, h >= 0, with G w = b."""
    capped, fixed = jnp.isfinite(hi), hi <= lo
    width = jnp.where(capped, hi - lo, jnp.inf)
    rest = jnp.abs(b - G @ lo) / jnp.sqrt(jnp.maximum(jnp.sum(G * G, axis=1), jnp.finfo(float).tiny))
    far = jnp.where(jnp.max(rest) > 0.0, jnp.max(rest), 1.0)
    least = jnp.min(jnp.where(h > 0.0, h, jnp.inf))
    near = 1e-3 * GAP * (far + jnp.abs(lo))  # the least distance from a bound, against round-off

    def distances(w: Any) -> tuple[Any, Any]:
        return jnp.where(fixed, 1.0, jnp.maximum(w - lo, near)), jnp.where(
            capped & ~fixed, jnp.maximum(hi - w, near), 1.0
        )

    def gap(w: Any, down: Any, up: Any) -> Any:
        below, above = distances(w)
        return jnp.mean(below * down + above * up)

    def reach(x: Any, change: Any) -> Any:
        falls = change < 0.0
        return jnp.min(jnp.where(falls, -x / jnp.where(falls, change, 1.0), jnp.inf))

    def step(state: tuple[Any, ...]) -> tuple[Any, ...]:
        w, y, down, up, count = state
        below, above = distances(w)
        mu = 0.1 * gap(w, down, up)
        D = jnp.where(fixed, 0.0, 1.0 / (h + down / below + up / above))
        # Multipliers for the next gap, and what the bounds then push.
        to_down, to_up = mu / below - down, jnp.where(capped, mu / above - up, 0.0)
        push = to_down - to_up - (h * w - G.T @ y - down + up)
        dy = _solved((G * D) @ G.T, b - G @ w - G @ (D * push))
        dw = D * (G.T @ dy + push)
        d_down, d_up = to_down - down / below * dw, to_up + up / above * dw
        ways = ((below, dw), (above, jnp.where(capped, -dw, 0.0)), (down, d_down), (up, d_up))
        part = jnp.minimum(1.0, 0.99 * jnp.min(jnp.stack([reach(x, change) for x, change in ways])))
        return w + part * dw, y + part * dy, down + part * d_down, up + part * d_up, count + 1

    start = jnp.where(fixed, 0.0, least * far) * jnp.ones_like(h)
    first = (lo + jnp.minimum(far, 0.5 * width), jnp.zeros_like(b), start, jnp.where(capped, start, 0.0), 0)
    end = GAP * gap(first[0], first[2], first[3])
    w, _, down, up, _ = jax.lax.while_loop(lambda x: (x[4] < STEPS) & (gap(x[0], x[2], x[3]) > end), step, first)
    below, above = distances(w)
    weight = jnp.where(h > 0.0, h, least)
    return fixed | (weight * below < down), ~fixed & capped & (weight * above < up)
