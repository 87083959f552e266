"""The string law as array functions: T = max(0, k (L - L0) + c dL/dt) where L > L0, else 0; energies; pulls on nodes.

When a damped string comes taut its tension jumps from 0 to c dL/dt. A state x(t; p) that goes through a jump Δf of its
rate at the instant where s(x) = 0 keeps the derivative δx⁺ = δx⁻ + Δf δs/ṡ (the saltation of Aizerman and Gantmacher),
which differentiating the steps misses: each is on one side of the jump. Here the tension has the derivative
Δf δ_w(s) ds as well, with a kernel of integral one over a time w, so that the steps within sum up to the jump's term.
The value is that of the law, without any ramp.

Tension curves are functions of the stretch s = L - L0. A string of stiffness k has T = k Σ_p ρ_p b_p over the pieces p
of its polygon, ρ_p being the slope of one over k and b_p how far it is stretched within it; k scales the whole curve,
as `String.scaled_to` does. A constant force has none.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.jax.arrays import Arrays, incidence, lifted, norm, times
from tensegrity_mj.model.strings import EDGE
from tensegrity_mj.model.structure import Structure


class Curves:
    """Tension curves of a structure's M strings, none of which yields, with at most P pieces each.

    Functions take as parameters `stiffness` (M,) [N/m], zero of constant forces, and these as `constant_forces` (M,)
    [N], zero of the others, where `linear` is false.

    Attributes:
        linear: whether all strings have no more than their stiffness.
        starts, widths: (M, P) [m] of the pieces in s; the last is endless, and those that a string lacks have no width.
        heights, slopes: (M, P) of T/k [m] at the starts, and ρ; zero of a constant force.
    """

    def __init__(self, structure: Structure) -> None:
        strings = structure.strings
        self.linear = all(string.is_linear for string in strings)
        shape = (len(strings), max([1, *(len(string.curve) for string in strings)]))
        self.starts, self.widths, self.heights, self.slopes = (np.zeros(shape) for _ in range(4))
        for m, string in enumerate(strings):
            points = np.array([(0.0, 0.0), *(string.curve or [(1.0, string.stiffness)])])
            points[:, 1] /= string.stiffness or 1.0
            last = len(points) - 1
            self.starts[m, :last], self.heights[m, :last] = points[:-1].T
            self.widths[m, :last], rises = np.diff(points, axis=0).T
            self.slopes[m, :last] = rises / self.widths[m, :last]
            self.widths[m, last - 1] = np.inf

    def parameters(self, structure: Structure) -> dict[str, Array]:
        """Parameters `constant_forces`, where there are curves or such forces."""
        forces = np.array([one.tension if one.is_constant else 0.0 for one in structure.strings], float)
        return {} if self.linear else {"constant_forces": forces}

    def pull(self, p: Arrays, stretch: Any) -> tuple[Any, Any]:
        """Elastic tensions [N] and energies [J] (M, ...) at stretches (M, ...) [m]; zero of what is slack."""
        taut = stretch > 0.0
        k, s = lifted(p["stiffness"], stretch), jnp.where(taut, stretch, 0.0)
        if self.linear:
            return k * s, 0.5 * k * s * s
        constant, own = lifted(p["constant_forces"], stretch), s[:, None]
        starts, widths, heights, slopes = (
            lifted(one, own) for one in (self.starts, self.widths, self.heights, self.slopes)
        )
        b = jnp.where(own > starts, jnp.where(own > starts + widths, widths, own - starts), 0.0)
        tension = k * jnp.sum(slopes * b, axis=1) + jnp.where(taut, constant, 0.0)
        return tension, k * jnp.sum((heights + 0.5 * slopes * b) * b, axis=1) + constant * s

    def stretch(self, p: Arrays, tension: Any) -> Any:
        """Stretches (M, ...) [m] at which strings first have tensions (M, ...) [N], below zero by k.

        Of one that stays below, the start of its last piece; of a constant force 0; of ∞ as a tension ∞.
        """
        k = lifted(p["stiffness"], tension)
        if self.linear:
            return tension / k
        level = self.slopes == 0.0
        with np.errstate(invalid="ignore"):
            rises = np.where(level, 0.0, self.slopes * self.widths)
        over = np.where(level & np.isfinite(self.widths), self.widths, 0.0)
        floors = np.where(np.arange(self.slopes.shape[1]) == 0, -np.inf, self.heights)
        own = (tension / jnp.where(k > 0.0, k, 1.0))[:, None]
        level, rises, over, floors, heights, slopes = (
            lifted(one, own) for one in (level, rises, over, floors, self.heights, np.where(level, 1.0, self.slopes))
        )
        within = jnp.where(level, over, jnp.minimum(own - heights, rises) / slopes)
        found = jnp.sum(jnp.where(own > floors, within, 0.0), axis=1)
        return jnp.where(tension == jnp.inf, jnp.inf, found)


class Strings:
    """The strings of a structure.

    Attributes:
        window: [s] over which derivatives spread the jump of a damped string that comes taut.
    """

    def __init__(self, structure: Structure, window: float) -> None:
        paths = structure.paths
        self.window, self.clipped, self.curves = window, structure.clipped, Curves(structure)
        self.segments = incidence(paths.nodes, len(structure.nodes))
        self.total = np.zeros((len(paths.ranges), len(paths.nodes)))
        self.total[paths.strings, np.arange(len(paths.nodes))] = 1.0
        self.simple = len(paths.nodes) == len(paths.ranges)

    def parameters(self, structure: Structure) -> dict[str, Any]:
        """Rest lengths [m], stiffness [N/m] and damping [N s/m], (M,), and those of `Curves`."""
        own = {name: np.array(getattr(structure, name)) for name in ("rest_lengths", "stiffness", "damping")}
        return own | self.curves.parameters(structure)

    def measure(self, x: Any, v: Any) -> tuple[Any, Any, Any]:
        """Lengths [m] and rates [m/s] of strings (M, ...), and the unit vectors of segments (S, 3, ...)."""
        spans = times(self.segments, x)
        lengths = norm(spans)
        units = spans / jnp.where(lengths > 0, lengths, 1.0)[:, None]
        rates = jnp.sum(units * times(self.segments, v), axis=1)
        if self.simple:
            return lengths, rates, units
        return times(self.total, lengths), times(self.total, rates), units

    def tighten(
        self, p: Arrays, lengths: Any, rates: Any, rest: Any, whole: Any, moves: bool = False
    ) -> tuple[Any, Any]:
        """Elastic and total tensions (M, ...) [N]; `whole` (M,) is 0 for broken strings.

        A string that grows longer from zero is taut but where rest lengths follow a law: see `model.strings`.
        """
        stretch = lengths - rest
        whole, clipped = lifted(whole, stretch), lifted(self.clipped, stretch)
        elastic = jnp.where(whole > 0, self.curves.pull(p, stretch)[0], 0.0)
        taut, push = elastic > 0, lifted(p["damping"], stretch) * rates
        if not moves:
            taut = taut | ((whole > 0) & (jnp.abs(stretch) <= EDGE * lengths) & (rates > 0))
        both = elastic + push
        tension = jnp.where(taut, jnp.where(clipped, jnp.maximum(both, 0.0), both), 0.0)
        jump = whole * jnp.where(clipped, jnp.maximum(push, 0.0), push)
        return elastic, tension + _jump(stretch, jump, rates, self.window)

    def energy(self, p: Arrays, lengths: Any, rest: Any, whole: Any) -> Any:
        """Energy stored in the strings (M, ...) [J]."""
        return lifted(whole, lengths) * self.curves.pull(p, lengths - rest)[1]

    def rest_lengths(self, p: Arrays, lengths: Any, densities: Any) -> Any:
        """L0 (M, ...) at which strings have force densities u: T = u L."""
        return lengths - self.curves.stretch(p, densities * lengths)

    def densities(self, p: Arrays, lengths: Any, rest: Any) -> Any:
        """Force densities u (M, ...) at rest lengths, below zero where linear strings would push."""
        if self.curves.linear:
            return lifted(p["stiffness"], lengths) * (1.0 - rest / lengths)
        return self.curves.pull(p, lengths - rest)[0] / lengths

    def pull(self, units: Any, tensions: Any) -> Any:
        """Forces on the nodes (N, 3, ...) [N]: the two of each segment are pulled together."""
        along = tensions if self.simple else times(self.total.T, tensions)
        return -times(self.segments.T, along[:, None] * units)


@jax.custom_jvp
def _jump(stretch: Any, jump: Any, rates: Any, window: Any) -> Any:
    """Return zeros whose derivative is jump · δ_w(stretch)."""
    return _nothing(stretch)


@_jump.defjvp
def _jump_derivative(at: tuple[Any, ...], changes: tuple[Any, ...]) -> tuple[Any, Any]:
    stretch, jump, rates, window = at
    # A raised cosine over the time to the crossing: steps that divide half the window sum up to one exactly.
    width = jnp.abs(rates) * window
    inside = jnp.abs(stretch) < width
    width = jnp.where(inside, width, 1.0)
    kernel = jnp.where(inside, 0.5 * (1 + jnp.cos(jnp.pi * jnp.where(inside, stretch, 0.0) / width)) / width, 0.0)
    return _nothing(stretch), jump * kernel * changes[0]


def _nothing(like: Any) -> Any:
    """Zeros that `jax.vmap` takes for a batch where `like` is one: of others JAX finds no gradient within it."""
    return jnp.where(like > 0, 0.0, jnp.zeros_like(like))
