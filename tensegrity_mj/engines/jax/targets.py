"""Where a target is at a time, as an array function: waypoints joined by straight lines and great circles, or a curve.

All move by quintics in time, at rest at waypoints; before the first time and after the last they stand still. Rates and
accelerations are derivatives of these functions by time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.target import Target

# (p, t) -> points (P, 3, ...) [m] and behind them directions (R, 3, ...): p is the target's array.
Aim = Callable[[Any, Any], Any]
STRAIGHT = 1e-7  # sine of an angle below which its great circle is a straight line, to the square of it


def array_target(target: Target, places: Callable[[Any], Any], points: int) -> tuple[Array, Aim]:
    """What moves a target, and where it is.

    The array is nodes (W, N, 3) [m] at the target's times, or a curve's Chebyshev coefficients (P, N, 3).

    Args:
        places: of nodes (N, 3, ...), (P + R, 3, ...): points, which move along straight lines between waypoints, and
            behind them spans, whose directions turn on great circles.
        points: P.
    """
    moments = np.array(target.times)

    def of_nodes(nodes: Any) -> tuple[Any, Any]:
        found = places(nodes)
        spans = found[points:]
        return found[:points], spans / jnp.sqrt(jnp.sum(spans**2, axis=1, keepdims=True))

    if target.along is not None:
        first, last = target.along.interval
        quintics = jnp.asarray(target.along.quintics(target.times))
        count = len(target.along.parameters)

        def along(p: Any, t: Any) -> Any:
            k, since = _piece(t, moments)
            value = jnp.polyval(quintics[k][::-1], since) if len(quintics) else target.along.values[0]  # type: ignore[union-attr]
            x = (2.0 * value - first - last) / (last - first)
            # T_0, T_1, ... by T_{n+1} = 2 x T_n - T_{n-1}.
            start = (jnp.ones_like(x), x)
            _, T = jax.lax.scan(lambda c, _: ((c[1], 2.0 * x * c[1] - c[0]), c[0]), start, length=count)
            return jnp.concatenate(of_nodes(jnp.tensordot(T, p, 1)))

        return np.array(target.along.coefficients), along

    def between(p: Any, t: Any) -> Any:
        p = jnp.asarray(p)
        if len(moments) == 1:
            return jnp.concatenate(of_nodes(p[0]))
        k, since = _piece(t, moments)
        x = since / jnp.asarray(np.diff(moments))[k]
        s = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        (r0, b0), (r1, b1) = of_nodes(p[k]), of_nodes(p[k + 1])
        return jnp.concatenate([r0 + s * (r1 - r0), _turned(b0, b1, s)])

    return np.array(target.nodes), between


def _piece(t: Any, moments: Array) -> tuple[Any, Any]:
    """The interval that a time is in, and the time since its beginning, which stands still outside of all."""
    held = jnp.where(t < moments[0], moments[0], jnp.where(t < moments[-1], t, moments[-1]))
    k = jnp.clip(jnp.searchsorted(moments, held, side="right") - 1, 0, max(len(moments) - 2, 0))
    return k, held - jnp.asarray(moments)[k]


def _turned(start: Any, end: Any, s: Any) -> Any:
    """The part s of the way from unit vectors (R, 3, ...) to others on great circles."""
    cosine = jnp.sum(start * end, axis=1, keepdims=True)
    side = end - cosine * start
    square = jnp.sum(side**2, axis=1, keepdims=True)
    turns = square > STRAIGHT**2
    sine = jnp.sqrt(jnp.where(turns, square, 1.0))
    angle = jnp.where(turns, jnp.arctan2(sine, cosine), 0.0) * s
    line = start + s * (end - start)  # which has derivatives by both ends where these are one
    return jnp.where(turns, jnp.cos(angle) * start + jnp.sin(angle) * side / sine, line)
