"""Model that a law has of its plant, as array functions: places of rods and masses, their targets, answer to forces.

A law demands something of g·a, a being the nodes' accelerations, which is linear in the force densities. With h = Aᵀ g
for a = A F + (what velocities alone do), the forces F of strings and all else do the work h·F, so that one system of
equations, of the rods' constraints under g in place of forces, gives all that a law needs of its model.

A target is of waypoints, joined by straight lines and great circles, or of curves. All move by quintics in time, at
rest at waypoints; before the first time and after the last they stand still. Rates and accelerations are derivatives of
these functions by time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.jax.arrays import Arrays, incidence, lifted, times
from tensegrity_mj.engines.jax.effects import array_effects
from tensegrity_mj.engines.jax.model import Model, Prepared
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.model.target import Target


class NominalModel:
    """A model of the engine's own, of the scene that a law of chapters 4 to 6 accounts for, and where it is to go.

    Attributes:
        parameters: `gravity` (3,), `effects` and `target`, see `array_target`.
        sizes: (P,) in how many directions the points of the rods, and behind them the point masses, are free to move.
        aim: (p, t) -> the `places` (P + R, 3, ...) that are aimed at, for the parameter `target`.
    """

    def __init__(self, law: Any) -> None:
        self._model = Model(law.model, array_effects(law.model), None, Actuation.continuous(), 0.0)
        self._at = self._model.prepare(self._model.parameters)
        structure = law.structure
        spans, one = incidence(structure.rod_nodes, len(structure.nodes)), np.eye(len(structure.nodes))
        sigma = np.array([rod.support.sigma for rod in structure.rods]).reshape(-1, 1)
        points = list(one[structure.rod_nodes[:, 0]] + sigma * spans)
        bases = [rod.support.translation_basis for rod in structure.rods]
        for point in structure.lone_masses:
            points.append(one[structure.node_index[point.node]])
            bases.append(point.translation_basis)
        self.sizes = np.array([E.shape[1] for E in bases])
        rows = [np.kron(row, np.pad(E, ((0, 0), (0, 3 - E.shape[1]))).T) for row, E in zip(points, bases, strict=True)]
        self._rows = np.concatenate([*rows, np.kron(spans / structure.rod_lengths[:, None], np.eye(3))])
        target, self.aim = array_target(law.target, self.places, len(bases))
        self.parameters = {"target": target, **{name: self._model.parameters[name] for name in ("gravity", "effects")}}

    def places(self, nodes: Any) -> Any:
        """Places (P + R, 3, ...) of nodes (N, 3, ...): z of points, along the directions that they are free in, behind
        them zeros; and the unit vectors b of the rods."""
        flat = times(self._rows, nodes.reshape(-1, *nodes.shape[2:]))
        return flat.reshape(-1, 3, *nodes.shape[2:])

    def motion(self, p: Arrays, t: Any, x: Any, v: Any) -> tuple[Any, Callable[[Any], tuple[Any, Any]]]:
        """The strings' lengths (M, ...), and a function of weights g (P + R, 3, ...) of the places' accelerations a.

        It gives g·a (...) without strings, and what force densities of one add to that, (M, ...).
        """
        own = {name: p[name] for name in ("gravity", "effects")}
        at = Prepared({**self._at.parameters, **own}, self._at.mobility)
        system, strings = self._model.system, self._model.strings
        y, rates = times(system.fit, x), times(system.fit, v)
        mobility = self._model.mobility(at, t, x)
        weight = lifted(mobility.mass @ system.shifted, x[:, 0])[:, None] * lifted(p["gravity"], x[0])
        forces = times(system.maps.T, self._model.acting(at, t, x, v)[0]) + weight
        turning = system.inner(*[times(system.spans, rates)] * 2)
        lengths, _, units = strings.measure(x, v)
        backwards, still = mobility.transposed, system.prescribed(t)[2]
        of_vectors = self._rows @ np.kron(system.maps, np.eye(3))

        def along(g: Any) -> tuple[Any, Any]:
            pull = times(of_vectors.T, g.reshape(-1, *g.shape[2:])).reshape(y.shape)
            h, mu, _ = system.accelerate(backwards, y, jnp.zeros_like(y), pull, still)
            (work,) = jax.linear_transpose(lambda T: strings.pull(units, T), lengths)(times(system.maps, h))
            return jnp.sum(h * forces, axis=(0, 1)) - jnp.sum(mu * turning, axis=0), lengths * work

        return lengths, along


def ceilings(limits: Any, lengths: Any) -> Any:
    """The largest force densities (M, ...), min(u_max, max(k (1 - L0_min/L), 0)), of a law's `StringLimits`."""
    highest, shortest, k = (
        lifted(one, lengths) for one in (limits.max_force_density, limits.min_rest_length, limits.structure.stiffness)
    )
    of_state = jnp.isfinite(shortest)
    by_length = jnp.maximum(k * (1.0 - jnp.where(of_state, shortest, 0.0) / lengths), 0.0)
    return jnp.minimum(highest, jnp.where(of_state, by_length, jnp.inf))


# (p, t) -> points (P, 3, ...) [m] and behind them directions (R, 3, ...): p is the target's array.
Aim = Callable[[Any, Any], Any]
STRAIGHT = 1e-7  # sine of an angle below which its great circle is a straight line, to the square of it


def array_target(target: Target, places: Callable[[Any], Any], points: int) -> tuple[Array, Aim]:
    """Make the array that a target depends on, and the function of time that gives its place.

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
