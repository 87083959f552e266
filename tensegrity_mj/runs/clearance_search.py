"""The search for the clearance of a motion: which pairs of elements there are, and what is found of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs import clearance_kernels as kernels
from tensegrity_mj.runs.approaches import Approach, Clearance, Event, Pairs
from tensegrity_mj.runs.clearance_kernels import Couples, Elements
from tensegrity_mj.runs.least_distance import least, sharpened
from tensegrity_mj.runs.moving_segments import Ends, Motion, paths
from tensegrity_mj.runs.near_stretches import crossings
from tensegrity_mj.runs.segments import closest_points

FLAT = 1e-9  # of the size: nodes that leave their plane by less are in it
NOISE = 1e-10  # of the size [m]: heights that have no side; and of the tolerance:
NOISE_OF_TOLERANCE = 1e-3
GLANCES = 8  # samples at which all pairs are looked at first, so that the nearest come first
PIECE = 512  # pairs between two updates of the progress bar


@dataclass(frozen=True)
class Path:
    """Nodes over time: time (T,), nodes and velocities (T, N, 3); until (M,): when each string breaks."""

    name: str
    structure: Structure
    time: Array
    nodes: Array
    velocities: Array
    until: Array


class ClearanceSearch:
    """The elements of a path as the compiled searches want them; elements are the rods, then the strings."""

    def __init__(self, path: Path, kinds: Sequence[Pairs], level: float, string_radius: float, margin: float) -> None:
        structure = path.structure
        self.path, self.kinds, self.level, self.margin = path, kinds, level, margin
        increasing = np.concatenate([[True], np.diff(path.time) > 0])
        self.time = np.ascontiguousarray(path.time[increasing])
        # Of each node over time, and seen from the mean of all nodes: what all do together brings nothing nearer.
        positions, velocities = path.nodes[increasing], path.velocities[increasing]
        self.positions, self.velocities = positions, velocities
        self.P = np.ascontiguousarray((positions - positions.mean(axis=1, keepdims=True)).transpose(1, 0, 2))
        self.V = np.ascontiguousarray((velocities - velocities.mean(axis=1, keepdims=True)).transpose(1, 0, 2))
        self.size = float(np.ptp(self.P.reshape(-1, 3), axis=0).max(initial=0.0))
        self.nodes = np.concatenate([structure.rod_nodes, structure.string_nodes])
        self.names = [rod.name for rod in structure.rods] + [string.name for string in structure.strings]
        rods = len(structure.rods)
        self.radii = np.array([rod.radius for rod in structure.rods] + [string_radius] * len(structure.strings))
        self.until = np.concatenate([np.full(rods, np.inf), path.until])
        self.pairs, self.pair_kinds = _pairs(self.nodes, rods, kinds, self.until > self.time[0])
        self.way = np.zeros((len(self.nodes), len(self.time)))
        paths(self.P, self.V, self.time, self.nodes, self.way)
        self.motion = Motion(self.P, self.V, self.time, self.way)
        self.elements = Elements(self.nodes, self.until, self.radii)
        self._sort()

    def _sort(self) -> None:
        """Pairs in the order of how near they are at some samples; these give first limits of what is looked for."""
        near = np.full(len(self.pairs), np.inf)
        i, j = self.pairs[:, 0], self.pairs[:, 1]
        for k in np.unique(np.linspace(0, len(self.time) - 1, GLANCES).astype(int)):
            whole = np.flatnonzero((self.until[i] >= self.time[k]) & (self.until[j] >= self.time[k]))
            at = self.P[:, k]
            ends = (self.nodes[i[whole], 0], self.nodes[i[whole], 1], self.nodes[j[whole], 0], self.nodes[j[whole], 1])
            apart = closest_points(*(at[rows] for rows in ends))[0] - self.radii[i[whole]] - self.radii[j[whole]]
            near[whole] = np.minimum(near[whole], apart)
        # Wide enough that the pair itself is found again.
        self.limits = np.array([near[self.pair_kinds == n].min(initial=np.inf) for n in range(len(Pairs))])
        self.limits += 10 * self.margin
        order = np.argsort(near, kind="stable")
        self.pairs, self.pair_kinds = self.pairs[order], self.pair_kinds[order]

    def result(self, every_pair: bool, over_time: bool, progress: bool) -> Clearance:
        """All that is wanted."""
        found = np.zeros((len(self.pairs), 4))
        events: list[Event] = []
        curves = np.full((len(Pairs), len(self.time)), np.inf)
        for first, last in _pieces(len(self.pairs), progress):
            couples, piece = Couples(self.pairs[first:last], self.pair_kinds[first:last]), found[first:last]
            kernels.search(self.motion, self.elements, couples, self.limits, bool(every_pair), self.margin, piece)
            if over_time:
                kernels.history(self.motion, self.elements, couples, curves)
            events += self._events(couples.pairs)
        smallest: dict[Pairs, Approach | None] = {}
        for kind in self.kinds:
            rows = np.flatnonzero((self.pair_kinds == _number(kind)) & (found[:, 3] >= 0))
            # A pair that was found first may have been undercut by no more than round-off: the sharpened ones decide.
            near = rows[found[rows, 0] <= found[rows, 0].min(initial=np.inf) + self.margin]
            closest = [self._approach(int(row), found[row]) for row in near[:GLANCES]]
            smallest[kind] = min(closest, key=lambda approach: approach.distance, default=None)
        each = None
        if every_pair:
            each = tuple(sorted((self._approach(row, found[row]) for row in range(len(found))), key=_by_distance))
        return Clearance(
            name=self.path.name,
            start=float(self.time[0]),
            end=float(self.time[-1]),
            samples=len(self.time),
            tolerance=self.margin,
            interpolation_error=self._interpolation_error(),
            planar=self._planar(),
            smallest=smallest,
            below=self.level,
            events=tuple(sorted(events, key=lambda event: (event.start, event.closest.distance))),
            pairs=each,
            time=self.time if over_time else np.zeros(0),
            over_time={kind: curves[_number(kind)] for kind in self.kinds} if over_time else None,
        )

    def _ends(self, i: int, j: int) -> Ends:
        (a, b), (c, d) = self.nodes[i], self.nodes[j]
        return int(a), int(b), int(c), int(d)

    def _approach(self, row: int, found: Array) -> Approach:
        """The nearest of one pair, from what the search has found of it."""
        i, j = (int(e) for e in self.pairs[row])
        until = float(min(self.until[i], self.until[j], self.time[-1]))
        place = (int(found[1]), float(found[2]), float(found[3]))
        return self._sharpened((i, j), place, (float(self.time[0]), until))

    def _sharpened(self, pair: tuple[int, int], place: tuple[int, float, float], span: tuple[float, float]) -> Approach:
        """The nearest of a pair about a place (interval, part, width) within a span of time."""
        i, j = pair
        ends = self._ends(i, j)
        apart, when, s, t = sharpened(self.motion, ends, *place, span)
        a, b, c, d = self._world(when)[list(ends)]
        rods = len(self.path.structure.rods)
        kind = Pairs.ROD_ROD if j < rods else Pairs.ROD_STRING if i < rods else Pairs.STRING_STRING
        spots = tuple(tuple((p + x * (q - p)).tolist()) for p, q, x in ((a, b, s), (c, d, t)))
        return Approach(
            kind,
            self.names[i],
            self.names[j],
            float(apart - self.radii[i] - self.radii[j]),
            float(apart),
            float(when),
            (float(s), float(t)),
            cast("Any", spots),
        )

    def _world(self, when: float) -> Array:
        """Node positions (N, 3) [m] at a time."""
        k = min(max(int(np.searchsorted(self.time, when, side="right")) - 1, 0), max(len(self.time) - 2, 0))
        if len(self.time) == 1:
            return self.positions[0]
        rows = slice(k, k + 2)
        return _cubic(self.time[rows], self.positions[rows], self.velocities[rows], when)

    def _events(self, pairs: IntArray) -> list[Event]:
        """All stretches of time in which one of these pairs is at most the level apart."""
        room = 4 * len(pairs) + 16
        while True:
            out, owner = np.empty((room, 2)), np.empty(room, np.int64)
            level = self.level + self.margin
            count = kernels.all_stretches(self.motion, self.elements, pairs, level, self.margin, out, owner)
            if count <= room:
                break
            room = count
        events = []
        noise = max(NOISE * self.size, NOISE_OF_TOLERANCE * self.margin)
        for (start, end), number in zip(out[:count].tolist(), owner[:count], strict=True):
            pair = (int(pairs[number, 0]), int(pairs[number, 1]))
            ends, span = self._ends(*pair), (start, end)
            _, *place = least(self.motion, pair, ends, span, np.inf, self.margin)
            closest = self._sharpened(pair, (place[0], place[1], place[2]), span)
            passed = np.empty(0)
            size = 8
            while len(self.time) > 1:
                passed = np.empty(size)
                times = crossings(self.motion, ends, span, noise, passed)
                if times <= size:
                    passed = passed[:times]
                    break
                size = times
            events.append(Event(closest, start, end, tuple(passed.tolist())))
        return events

    def _interpolation_error(self) -> float:
        """Of distances [m]: twice that of a node, whose cubics over h err by h⁴/384 times its fourth derivative.

        Over two intervals h₀ and h₁ the error at the sample between is h₀² h₁² / 24 times that derivative.
        """
        time, nodes, velocities = self.time, self.positions, self.velocities
        if len(time) == 1:
            return 0.0
        if len(time) == 2:
            return float("nan")
        h0, h1 = (np.diff(time)[:-1, None, None], np.diff(time)[1:, None, None])
        x, h = h0 / (h0 + h1), h0 + h1
        between = _hermite(x, h, nodes[:-2], nodes[2:], velocities[:-2], velocities[2:])
        derivative = 24 * np.linalg.norm(between - nodes[1:-1], axis=-1) / (h0**2 * h1**2)[..., 0]
        errors = derivative * (np.maximum(h0, h1) ** 4)[..., 0] / 384
        return float(2 * errors.max(initial=0.0))

    def _planar(self) -> bool:
        """Whether one plane holds all nodes at all times."""
        points = self.positions.reshape(-1, 3)
        if len(points) < 4:
            return True
        spread = points - points.mean(axis=0)
        _, vectors = np.linalg.eigh(spread.T @ spread)
        size = float(np.ptp(points, axis=0).max())
        return float(np.abs(spread @ vectors[:, 0]).max()) <= FLAT * size


def _hermite(x: Any, h: Any, p: Array, q: Array, v: Array, w: Array) -> Array:
    """The cubic from p to q with the velocities v and w, at the part x of its length h [s]."""
    y = 1 - x
    return np.asarray(y * y * (1 + 2 * x) * p + x * x * (3 - 2 * x) * q + h * x * y * (y * v - x * w))


def _cubic(time: Array, nodes: Array, velocities: Array, when: float) -> Array:
    h = float(time[1] - time[0])
    return _hermite((when - time[0]) / h, h, nodes[0], nodes[1], velocities[0], velocities[1])


def _pairs(nodes: IntArray, rods: int, kinds: Sequence[Pairs], whole: NDArray[np.bool_]) -> tuple[IntArray, IntArray]:
    """Rows of the elements of all pairs (P, 2) that share no node, and their kinds (P,)."""
    i, j = np.triu_indices(len(nodes), 1)
    number = (i >= rods).astype(np.int64) + (j >= rods)  # as in `Pairs`
    joined = (nodes[i, :, None] == nodes[j, None, :]).any(axis=(1, 2)) if len(i) else np.zeros(0, bool)
    wanted = ~joined & np.isin(number, [_number(kind) for kind in kinds]) & whole[i] & whole[j]
    return np.stack([i, j], axis=1).astype(np.int64)[wanted], number[wanted]


def _number(kind: Pairs) -> int:
    return list(Pairs).index(kind)


def _by_distance(approach: Approach) -> float:
    return approach.distance


def _pieces(count: int, progress: bool) -> Iterator[tuple[int, int]]:
    """(first, last) of pieces of the pairs, under a bar if there is one."""
    with bar(progress, "clearance", total=count, unit="pair") as shown:
        for first in range(0, count, PIECE):
            last = min(first + PIECE, count)
            yield first, last
            shown.update(last - first)
