"""The one string law, used by every formulation and tested against each of them.

A string of stiffness k [N/m], damping c [N s/m] and rest length L0 [m], at length L [m] and rate
dL/dt [m/s], pulls with the tension [N]

    T = max(0, k (L - L0) + c dL/dt)   where L > L0,   else 0          (CLIPPED)
    T =        k (L - L0) + c dL/dt    where L > L0,   else 0          (UNCLIPPED)

A string that grows longer from L = L0, to round-off, is taut already, so that its damper acts from then on: else a
start there would have its damper missed for a stage, and steps of order 2. Where rest lengths follow a law at every
stage dL/dt is not the rate of L - L0, and L > L0 alone counts. Here k (L - L0) stands for the elastic tension f(L - L0)
of a string with a tension curve: functions take a structure's `curves` for its stiffness.

The clipped law is a string: it never pushes. The unclipped variant lets the damper push in a taut string
that shortens fast; it exists to compare with codes that compute so. The elastic part k (L - L0) over L is
the force density u [N/m] of the thesis, (2.58); its inverse is L0 = L (1 - u/k).

A string is straight between one node of its path and the next, its segments, and has one tension.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array, IntArray, dot, norm
from tensegrity_mj.model.members import String
from tensegrity_mj.model.members import StringLaw as StringLaw


@dataclass(frozen=True, eq=False)
class TensionCurves:
    """The elastic tension of M strings as a function of their stretch s = L - L0: a polygon through points, for each.

    A polygon's energy, its inverse and its slope are exact, piece by piece. A linear string has one piece, from the
    origin with the slope k, and a string of constant force T has one of no slope, T at any length, with L0 = 0.

    A string that `yields` keeps the permanent stretch p that is left when it lets go: with the largest stretch s* so
    far,

        T(s, p) = max(0, min(f(s), k (s - p))),      p = s* - f(s*)/k,

    since no piece of it rises faster than the first, k, with which it unloads and is loaded again. It stores T²/2k, and
    what it has lost is ∫ f ds up to s*, less f(s*)²/2k. There are at most P pieces; those that a string lacks begin
    at ∞.

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


EDGE = 1e-12  # of its length: within round-off of its rest length, a string is at the edge of slackness


def elastic_tension(stiffness: ArrayLike | TensionCurves, length: ArrayLike, rest_length: ArrayLike) -> Array:
    """Elastic part k max(0, L - L0) of the tension [N]; arguments broadcast."""
    if isinstance(stiffness, TensionCurves):
        return stiffness.tension(np.asarray(length) - np.asarray(rest_length))
    return np.asarray(stiffness) * np.maximum(0.0, np.asarray(length) - np.asarray(rest_length))


def tension(
    stiffness: ArrayLike | TensionCurves,
    damping: ArrayLike,
    length: ArrayLike,
    length_rate: ArrayLike,
    rest_length: ArrayLike,
    law: StringLaw | NDArray[np.bool_] = StringLaw.CLIPPED,
) -> Array:
    """Tension T [N] of the law above; arguments broadcast. `law`: or whether each string is clipped."""
    elastic = elastic_tension(stiffness, length, rest_length)
    stretch, rate = np.asarray(length) - np.asarray(rest_length), np.asarray(length_rate)
    total = elastic + np.asarray(damping) * rate
    clipped = law is StringLaw.CLIPPED if isinstance(law, StringLaw) else law
    taut = (elastic > 0.0) | ((np.abs(stretch) <= EDGE * np.asarray(length)) & (rate > 0.0))
    return np.where(taut, np.where(clipped, np.maximum(0.0, total), total), 0.0)


def energy(stiffness: ArrayLike | TensionCurves, length: ArrayLike, rest_length: ArrayLike) -> Array:
    """Elastic energy k max(0, L - L0)^2 / 2 [J]; arguments broadcast."""
    if isinstance(stiffness, TensionCurves):
        return stiffness.energy(np.asarray(length) - np.asarray(rest_length))
    stretch = np.maximum(0.0, np.asarray(length) - np.asarray(rest_length))
    return 0.5 * np.asarray(stiffness) * stretch**2


def force_density(stiffness: ArrayLike | TensionCurves, length: ArrayLike, rest_length: ArrayLike) -> Array:
    """Force density u = k (1 - L0/L)+ [N/m], thesis (2.58); arguments broadcast."""
    return elastic_tension(stiffness, length, rest_length) / np.asarray(length)


def rest_length(stiffness: ArrayLike | TensionCurves, length: ArrayLike, force_density: ArrayLike) -> Array:
    """Rest length L0 = L (1 - u/k) [m] that gives the force density u [N/m], below (2.58)."""
    if isinstance(stiffness, TensionCurves) and not stiffness.linear:
        found = np.asarray(length) - stiffness.stretch(np.asarray(force_density) * np.asarray(length))
        return np.asarray(np.where(stiffness.constant, 0.0, found))
    if isinstance(stiffness, TensionCurves):
        stiffness = stiffness.stiffness
    return np.asarray(length) * (1.0 - np.asarray(force_density) / np.asarray(stiffness))


def on_taut_side(
    lengths: Array, rest_lengths: Array, nodes: Array, broken: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks (M,) of the strings that are taut in a linear model, and of those at the edge of slackness.

    At the edge, where a string is as long as at rest to round-off, the model is that of the taut side. What is broken,
    or has no length and so no direction, is not taut. Nodes (N, 3) far from the origin have fewer digits for lengths:
    each of the two ends is rounded by half an ulp in three components, which is below 2 ε of the largest.
    """
    stretch = lengths - rest_lengths
    far = 2 * np.finfo(float).eps * float(np.abs(nodes).max(initial=0.0))
    edge = EDGE * np.maximum(lengths, np.abs(rest_lengths)) + far
    taut = (stretch >= -edge) & (lengths > 0)
    if broken is not None:
        taut &= ~broken
    return taut, taut & (np.abs(stretch) <= edge)


@dataclass(frozen=True, eq=False)
class Paths:
    """The segments of M strings, those of a string in a row along its path: S of them, S = M where all have two nodes.

    A node between the ends of a path is a pulley without friction and of no size, so that the tension is the same on
    both of its sides: L is the sum of the segments' lengths, and each segment pulls its two nodes together with T.
    With friction the tension would change from segment to segment: then tensions would be (S,), and not (M,).

    Attributes:
        nodes: (S, 2) rows of the two nodes of each segment.
        ranges: (M, 2) rows of each string's first segment, and of the one behind its last.
    """

    nodes: IntArray
    ranges: IntArray

    @classmethod
    def of(cls, rows: Iterable[Sequence[int]]) -> Paths:
        """Make the paths of strings through nodes of these rows, two or more each."""
        pairs: list[tuple[int, int]] = []
        ranges: list[tuple[int, int]] = []
        for path in rows:
            ranges.append((len(pairs), len(pairs) + len(path) - 1))
            pairs += itertools.pairwise(path)
        nodes, limits = (np.array(found, np.int64).reshape(-1, 2) for found in (pairs, ranges))
        nodes.flags.writeable = limits.flags.writeable = False
        return cls(nodes, limits)

    @cached_property
    def counts(self) -> IntArray:
        """(M,) how many segments each string has."""
        return self.ranges[:, 1] - self.ranges[:, 0]

    @cached_property
    def strings(self) -> IntArray:
        """(S,) the row of each segment's string."""
        return np.repeat(np.arange(len(self.ranges)), self.counts)

    @cached_property
    def couples(self) -> IntArray:
        """(P, 2) rows of any two segments of one string, each with itself too: what a string's stiffness couples."""
        partners = self.counts[self.strings]
        first = np.repeat(np.arange(len(self.nodes)), partners)
        place = np.arange(len(first)) - np.repeat(np.cumsum(partners) - partners, partners)
        return np.stack([first, self.ranges[self.strings[first], 0] + place], axis=1).astype(np.int64)

    def total(self, values: Array, axis: int = -1) -> Any:
        """The sum over each string's segments, (..., S) -> (..., M) along an axis."""
        if len(self.nodes) == len(self.ranges):
            return values
        return np.add.reduceat(values, self.ranges[:, 0], axis=axis)

    def spans(self, nodes: Array) -> Array:
        """(..., S, 3) [m] from the first to the second node of each segment, for nodes (..., N, 3)."""
        return np.asarray(nodes[..., self.nodes[:, 1], :] - nodes[..., self.nodes[:, 0], :])

    def lengths(self, nodes: Array) -> Array:
        """L [m] of every string, (..., M)."""
        return np.asarray(self.total(norm(self.spans(nodes))))

    def rates(self, nodes: Array, velocities: Array) -> Array:
        """dL/dt [m/s] of every string, (..., M)."""
        spans = self.spans(nodes)
        return np.asarray(self.total(dot(spans, self.spans(velocities)) / norm(spans)))

    def shares(self, lengths: Array) -> Array:
        """(..., S) L/l of segments of lengths l (..., S): a force density u = T/L is u L/l along a segment.

        One where l = 0, and there is no direction to pull in.
        """
        whole = self.total(lengths)[..., self.strings]
        return np.asarray(np.divide(whole, lengths, out=np.ones_like(lengths), where=lengths > 0))

    def followed_by(self, pairs: IntArray) -> Paths:
        """These, and behind them members (R, 2) of one segment each."""
        S = len(self.nodes) + np.arange(len(pairs))
        more = np.stack([S, S + 1], axis=1).astype(np.int64)
        return Paths(np.concatenate([self.nodes, pairs]), np.concatenate([self.ranges, more]))
