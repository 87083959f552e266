"""Tension curves of strings as array functions of the stretch s = L - L0: tension, energy, and the inverse.

A string of stiffness k has T = k Σ_p ρ_p b_p over the pieces p of its polygon, ρ_p being the slope of one over k and
b_p how far it is stretched within it; k scales the whole curve, as `String.scaled_to` does. A constant force has none.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.jax.arrays import Arrays, lifted
from tensegrity_mj.model.structure import Structure


class Curves:
    """Those of a structure's M strings, none of which yields, with at most P pieces each.

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
        """`constant_forces`, where there are curves or such forces."""
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
        """(M, ...) [m] at which strings first have tensions (M, ...) [N], below zero by k.

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
