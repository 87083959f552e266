"""The elastic tension of strings as a function of their stretch s = L - L0: a polygon through points, for each string.

A polygon's energy, its inverse and its slope are exact, piece by piece. A linear string has one piece, from the origin
with the slope k, and a string of constant force T has one of no slope, T at any length, with L0 = 0.

A string that `yields` keeps the permanent stretch p that is left when it lets go: with the largest stretch s* so far,

    T(s, p) = max(0, min(f(s), k (s - p))),      p = s* - f(s*)/k,

since no piece of it rises faster than the first, k, with which it unloads and is loaded again. It stores T²/2k, and
what it has lost is ∫ f ds up to s*, less f(s*)²/2k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.model.members import String


@dataclass(frozen=True, eq=False)
class TensionCurves:
    """The curves of M strings, of at most P pieces each; those that a string lacks begin at ∞.

    Attributes:
        starts: (M, P) [m] stretches where pieces begin, the first at 0.
        tensions: (M, P) [N] there.
        slopes: (M, P) [N/m] of the pieces.
        yields: (M,) bool.
    """

    starts: Array
    tensions: Array
    slopes: Array
    yields: NDArray[np.bool_]

    @classmethod
    def of(cls, strings: Sequence[String]) -> TensionCurves:
        """Make the curves of a structure's strings."""
        most = max([1, *(len(string.curve) for string in strings)])
        starts, tensions = np.full((len(strings), most), np.inf), np.zeros((len(strings), most))
        slopes = np.zeros((len(strings), most))
        for m, string in enumerate(strings):
            points = np.array([(0.0, 0.0), *string.curve])
            count = max(1, len(string.curve))
            rises = np.diff(points, axis=0)
            starts[m, :count], tensions[m, :count] = points[:count].T
            slopes[m, :count] = rises[:, 1] / rises[:, 0] if len(rises) else 0.0
            slopes[m, 0] = string.stiffness
            if string.is_constant:
                tensions[m, 0] = string.tension
        return cls(starts, tensions, slopes, np.array([string.yields for string in strings], bool))

    @property
    def stiffness(self) -> Array:
        """k (M,) [N/m]: the slopes at the origin."""
        return np.asarray(self.slopes[:, 0])

    @cached_property
    def linear(self) -> bool:
        """True where all strings have a stiffness and no curve beyond it."""
        return self.starts.shape[1] == 1 and not self.constant.any()

    @cached_property
    def constant(self) -> NDArray[np.bool_]:
        """(M,) whether a string is one of constant force."""
        return np.asarray((self.slopes[:, 0] == 0) & (self.tensions[:, 0] > 0))

    @cached_property
    def steepest(self) -> Array:
        """(M,) [N/m] the largest slope."""
        return np.asarray(self.slopes.max(axis=1))

    @cached_property
    def energies(self) -> Array:
        """(M, P) [J] ∫ T ds up to where the pieces begin."""
        steps = np.diff(np.where(np.isfinite(self.starts), self.starts, 0.0), axis=1).clip(min=0.0)
        gains = steps * (self.tensions[:, :-1] + 0.5 * steps * self.slopes[:, :-1])
        return np.concatenate([np.zeros((len(self.starts), 1)), np.cumsum(gains, axis=1)], axis=1)

    def only(self, kept: NDArray[np.bool_]) -> TensionCurves:
        """Return the curves with those of other strings than `kept` (M,) at zero: they are broken."""
        return replace(self, tensions=self.tensions * kept[:, None], slopes=self.slopes * kept[:, None])

    def pieces(self, stretch: Array) -> IntArray:
        """Return the number of the piece that holds each stretch (..., M); below zero the first."""
        return np.asarray(np.maximum(np.sum(stretch[..., None] > self.starts, axis=-1) - 1, 0))

    def _beyond(self, stretch: ArrayLike) -> tuple[tuple[IntArray, IntArray], Array]:
        """Strings and pieces of stretches (..., M), and how far these are into the pieces [m]."""
        s = np.maximum(0.0, np.asarray(stretch, float))
        at = (np.arange(len(self.starts)), self.pieces(s))
        return at, np.asarray(s - self.starts[at])

    def tension(self, stretch: ArrayLike, permanent: ArrayLike = 0.0) -> Array:
        """(..., M) [N] at stretches (..., M) [m]; `permanent` [m] is that of strings that have yielded."""
        if self.linear:
            return np.asarray(self.stiffness * np.maximum(0.0, np.asarray(stretch)))
        at, beyond = self._beyond(stretch)
        pull = self.tensions[at] + self.slopes[at] * beyond
        unloading = self.stiffness * np.maximum(0.0, np.asarray(stretch) - permanent)
        return np.asarray(np.where(self.yields, np.minimum(pull, unloading), pull))

    def slope(self, stretch: ArrayLike, loading: bool = False) -> Array:
        """(..., M) [N/m] dT/ds of taut strings, zero of others; k of those that yield, unless they are loaded on."""
        if self.linear:
            return np.asarray(np.where(np.asarray(stretch) > 0, self.stiffness, 0.0))
        slopes = np.where(self.yields & (not loading), self.stiffness, self.slopes[self._beyond(stretch)[0]])
        return np.asarray(np.where(np.asarray(stretch) > 0, slopes, 0.0))

    def energy(self, stretch: ArrayLike) -> Array:
        """(..., M) [J] ∫ T ds from 0; of strings that yield, with what they lose."""
        at, beyond = self._beyond(stretch)
        return np.asarray(self.energies[at] + self.tensions[at] * beyond + 0.5 * self.slopes[at] * beyond**2)

    def total_energy(self, stretch: Array) -> float:
        """[J] of all strings at stretches (M,)."""
        if self.linear:
            return 0.5 * float(self.stiffness @ np.maximum(0.0, stretch) ** 2)
        return float(self.energy(stretch).sum())

    def stored(self, stretch: ArrayLike, tension: Array) -> Array:
        """(..., M) [J] that strings give back when they let go, at stretches and their elastic tensions [N]."""
        hooke = tension**2 / (2 * np.where(self.stiffness > 0, self.stiffness, np.inf))
        if self.linear:
            return np.asarray(hooke)
        return np.asarray(np.where(self.yields, hooke, np.where(tension > 0, self.energy(stretch), 0.0)))

    def stretch(self, tension: ArrayLike) -> Array:
        """(..., M) [m] at which strings first have tensions (..., M) [N]; where a curve stays below, its last point.

        Of a constant force: 0.
        """
        wanted = np.asarray(tension, float)
        if self.linear:
            return np.asarray(wanted / self.stiffness)
        ends = np.concatenate([self.tensions[:, 1:], np.zeros((len(self.starts), 1))], axis=1)
        following = np.concatenate([np.isfinite(self.starts[:, 1:]), np.zeros((len(self.starts), 1), bool)], axis=1)
        at = (np.arange(len(self.starts)), np.sum(following & (wanted[..., None] > ends), axis=-1))
        slopes = self.slopes[at]
        beyond = (wanted - self.tensions[at]) / np.where(slopes > 0, slopes, np.inf)
        return np.asarray(self.starts[at] + beyond)

    def rest_lengths(self, strings: Sequence[String], lengths: Array) -> Array:
        """L0 (M,) [m] of the strings, by how they are taut at lengths (M,); 0 of a constant force."""
        values = []
        for row, (s, length) in enumerate(zip(strings, lengths, strict=True)):
            if s.rest_length is not None:
                values.append(s.rest_length)
            elif s.is_constant:
                values.append(0.0)
            elif not s.is_linear:
                pull = np.zeros(len(lengths))
                pull[row] = (s.force_density or 0.0) * length if s.tension is None else s.tension
                values.append(length - self.stretch(pull)[row])
            elif s.tension is not None:
                values.append(length - s.tension / s.stiffness)
            else:
                values.append(length * (1.0 - (s.force_density or 0.0) / s.stiffness))
        return np.array(values, float)
