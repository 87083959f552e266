"""The smallest u with vᵀu = α between thresholds and ceilings, as array functions: Lemma 5.1 with bounds.

With α' = α - vᵀū left to do above the thresholds ū, and w = v sign(α'), only strings with w > 0 help. The optimum of
norms 2 and ∞ is u = min(max(ū, μ g), c) with g = w or g = 1: what it gives grows with μ by pieces, so that between
which of their ends μ lies also says which strings have reached their bounds, and μ follows from the others. Derivatives
are those of that solution: right but where a string reaches its bound, or another becomes the best of norm 1.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp


def least_squares(v: Any, alpha: Any) -> tuple[Any, Any]:
    """u (M, ...) of least norm 2 without bounds, and the margin max(v/α) (...); zero where that is not positive."""
    w = jnp.where(alpha > 0.0, v, -v)
    need, best = jnp.abs(alpha), jnp.max(w, axis=0)
    solved = (best > 0.0) & (need > 0.0)
    helpful = jnp.where(w > 0.0, w, 0.0)
    u = jnp.where(solved, need * helpful / jnp.where(solved, jnp.sum(helpful**2, axis=0), 1.0), 0.0)
    return u, jnp.where(need > 0.0, best / jnp.where(need > 0.0, need, 1.0), jnp.inf)


def least_norm(v: Any, alpha: Any, floor: Any, ceiling: Any, capped: Any, norm: float) -> tuple[Any, Any]:
    """u (M, ...) of least norm 1, 2 or ∞, and the feasibility margin (...); u = ū where that is not positive.

    Args:
        v: (M, ...).
        alpha: (...).
        floor, ceiling: (M, ...), ū and c; ceilings count where `capped` (M,), and shall be finite everywhere.
        capped: (M,), which strings have a ceiling.
        norm: 1, 2 or math.inf.
    """
    capped = capped.reshape(capped.shape + (1,) * (v.ndim - 1))
    rest = alpha - jnp.sum(v * floor, axis=0)
    w, need = jnp.where(rest > 0.0, v, -v), jnp.abs(rest)
    helps = w > 0.0
    room = jnp.where(capped, ceiling - floor, 0.0)
    capacity = jnp.sum(jnp.where(helps, w, 0.0) * room, axis=0)
    endless = jnp.any(helps & ~capped, axis=0)
    some = jnp.where(need > 0.0, need, 1.0)
    best = jnp.max(w, axis=0) / some
    scarce = (best > 0.0) & ~endless & (capacity < 2.0 * need)
    margin = jnp.where(need > 0.0, jnp.where(scarce, best * (capacity / some - 1.0), best), jnp.inf)
    margin = jnp.where(jnp.any(room < 0.0, axis=0), -jnp.inf, margin)
    if norm == 1.0:
        u = _least_sum(w, need, floor, room, capped)
    elif norm == 2.0:
        u = _fill(w, w, need, floor, ceiling, capped)
    else:
        highest = jnp.max(floor, axis=0)
        level = jnp.where(capped, jnp.minimum(highest, ceiling), highest)
        slack = jnp.sum(jnp.where(helps, w * (level - floor), 0.0), axis=0)
        # Below the highest threshold the level is not unique: the part of the way there that suffices.
        part = need / jnp.where(slack > 0.0, slack, 1.0)
        low = jnp.where(helps, floor + (level - floor) * part, floor)
        u = jnp.where(need <= slack, low, _fill(w, jnp.ones_like(w), need, floor, ceiling, capped))
    return jnp.where((margin > 0.0) & (need > 0.0), u, floor), margin


def _fill(w: Any, g: Any, need: Any, floor: Any, ceiling: Any, capped: Any) -> Any:
    """u = min(max(ū, μ g), c) of the strings with w > 0, with wᵀ(u - ū) = need."""
    helps = w > 0.0
    g = jnp.where(helps, g, 1.0)
    rises, stops = floor / g, jnp.where(capped, ceiling / g, jnp.inf)
    ends = jnp.concatenate([rises, jnp.where(capped, stops, 0.0)])  # (2M, ...)
    lift = jnp.clip(ends[:, None], rises, stops) - rises  # (2M, M, ...): of string i where μ is at end k
    given = jnp.sum(jnp.where(helps, w * g * lift, 0.0), axis=1)
    mu = jax.lax.stop_gradient(jnp.max(jnp.where((given < need) & (ends > 0.0), ends, 0.0), axis=0))
    full = helps & (stops <= mu)
    moving = helps & (rises <= mu) & ~full
    slope = jnp.sum(jnp.where(moving, w * g, 0.0), axis=0)
    left = need + jnp.sum(jnp.where(moving, w * floor, 0.0) - jnp.where(full, w * (ceiling - floor), 0.0), axis=0)
    mu = jnp.where(slope > 0.0, left / jnp.where(slope > 0.0, slope, 1.0), mu)
    return jnp.where(moving, mu * g, jnp.where(full, ceiling, floor))


def _least_sum(w: Any, need: Any, floor: Any, room: Any, capped: Any) -> Any:
    """The most effective strings first, each up to its ceiling; of equal ones the first."""
    helps = w > 0.0
    order = jnp.arange(len(w)).reshape((-1,) + (1,) * (w.ndim - 1))
    ahead = helps & ((w > w[:, None]) | ((w == w[:, None]) & (order < order[:, None])))  # (M, M, ...)
    before = jnp.sum(jnp.where(ahead, w * room, 0.0), axis=1)
    left = jnp.where(jnp.any(ahead & ~capped, axis=1), 0.0, need - before)
    lift = jnp.maximum(left, 0.0) / jnp.where(helps, w, 1.0)
    return jnp.where(helps, floor + jnp.where(capped, jnp.minimum(lift, room), lift), floor)
