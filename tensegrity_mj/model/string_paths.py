"""Paths of strings: a string is straight between one node of its path and the next, its segments, and has one tension.

A node between the ends of a path is a pulley without friction and of no size, so that the tension is the same on both
of its sides: L is the sum of the segments' lengths, and each segment pulls its two nodes together with T.
With friction the tension would change from segment to segment: then tensions would be (S,), and not (M,).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array, IntArray, dot, norm


@dataclass(frozen=True, eq=False)
class Paths:
    """The segments of M strings, those of a string in a row along its path: S of them, S = M where all have two nodes.

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
