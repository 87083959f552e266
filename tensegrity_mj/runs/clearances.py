"""Clearance: how near rods and strings come to each other, which, when and where. Thesis §2.5 and §8.2.

An element is the straight line between its two nodes, a rod a capsule of its radius about that line, as in `contact`; a
string has a radius of zero unless told otherwise, and slack ones are as straight as taut ones. Distances are those of
the surfaces, negative where elements overlap: by what must be given way to, or by all of both radii where the centre
lines cross.

Elements that share a node are joined and not looked at: their distance is zero at the joint, by construction. So
nothing is said of two joined rods that fold onto each other.

Between its samples a trajectory is the cubics of its node positions and velocities (Hermite). Over these the search
leaves nothing out, see `clearance_kernels`: a thin rod that passes another between two samples is found. What the
cubics differ from the true motion is estimated by how well those over every second sample meet the samples between.
"""

from __future__ import annotations

import enum
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import finite, positive, real_array
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.moving_segments import paths
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.statics.state import StaticState


FLAT = 1e-9  # of the size: nodes that leave their plane by less are in it
NOISE = 1e-10  # of the size [m]: heights that have no side; and of the tolerance:
NOISE_OF_TOLERANCE = 1e-3
GLANCES = 8  # samples at which all pairs are looked at first, so that the nearest come first
PIECE = 512  # pairs between two updates of the progress bar


class Pairs(enum.Enum):
    """Kinds of pairs of elements."""

    ROD_ROD = "rod-rod"
    ROD_STRING = "rod-string"
    STRING_STRING = "string-string"


@dataclass(frozen=True)
class Approach:
    """Where two elements are nearest to each other.

    Attributes:
        kind: of the two elements; a rod comes before a string.
        first, second: their names.
        distance: of the surfaces [m], negative where they overlap.
        axis_distance: of the centre lines [m].
        time: [s]; 0 of what does not move.
        at: parts of the two lengths, from the first node of each, at which they are nearest.
        points: the two points on the centre lines, world frame [m].
    """

    kind: Pairs
    first: str
    second: str
    distance: float
    axis_distance: float
    time: float
    at: tuple[float, float]
    points: tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class Event:
    """A stretch of time in which two elements are at most the asked distance apart.

    Attributes:
        closest: the nearest that they come in it.
        start, end: [s].
        crossings: times [s] at which the centre line of one passes through that of the other.
    """

    closest: Approach
    start: float
    end: float
    crossings: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Clearance:
    """The smallest distances between elements of a structure, over a time or of one shape.

    Attributes:
        name: of the scene or structure.
        start, end, samples: times [s], and how many recorded ones.
        tolerance: [m]: no distance of the cubics is below one of `smallest` by more.
        interpolation_error: [m], an estimate: how much the distances of the cubics differ from those of the motion
            between samples; NaN below three samples, 0 of one.
        planar: whether all nodes are in one plane at all times. Then elements cross by construction, with a distance
            of zero: real ones lie in layers, and only distances of elements that do not cross mean anything.
        smallest: of each kind of pairs, None where there is no such pair.
        below: [m], what `events` are of.
        events: all stretches of time in which two elements are at most so far apart, by time.
        pairs: the nearest of every pair, the nearest first; None unless asked for.
        time, over_time: at the samples (T,) [s] the smallest distance (T,) [m] of each kind; None unless asked for.
    """

    name: str
    start: float
    end: float
    samples: int
    tolerance: float
    interpolation_error: float
    planar: bool
    smallest: Mapping[Pairs, Approach | None]
    below: float
    events: tuple[Event, ...]
    pairs: tuple[Approach, ...] | None = None
    time: Array = field(default_factory=lambda: np.zeros(0))
    over_time: Mapping[Pairs, Array] | None = None

    @property
    def closest(self) -> Approach | None:
        """The nearest of all kinds; None where there is no pair."""
        found = [approach for approach in self.smallest.values() if approach is not None]
        return min(found, key=lambda approach: approach.distance, default=None)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, without `over_time`."""
        return {
            "name": self.name,
            "start": self.start,
            "end": self.end,
            "samples": self.samples,
            "tolerance": self.tolerance,
            "interpolation_error": self.interpolation_error,
            "planar": self.planar,
            "smallest": {kind.value: None if a is None else asdict(a) for kind, a in self.smallest.items()},
            "below": self.below,
            "events": [asdict(event) for event in self.events],
            "pairs": None if self.pairs is None else [asdict(a) for a in self.pairs],
        }


def clearance(
    what: Trajectory | Scene | Structure | StaticState,
    nodes: ArrayLike | None = None,
    *,
    time: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    pairs: Collection[Pairs] = tuple(Pairs),
    below: float = 0.0,
    string_radius: float = 0.0,
    tolerance: float = 1e-6,
    every_pair: bool = False,
    over_time: bool = False,
    progress: bool = False,
) -> Clearance:
    """The smallest distances between rods, between rods and strings, and between strings.

    Args:
        what: a run; or a scene (at its start), a structure (at its reference) or a state of equilibrium.
        nodes: of a structure elsewhere: (N, 3) [m], or (T, N, 3) with `time` (T,) [s] and `velocities` [m/s].
        pairs: kinds of pairs to look at.
        below: [m]: `events` has all approaches to at most this; 0 for touches and passages.
        string_radius: [m] of every string.
        tolerance: [m], see `Clearance`; events of down to this much above `below` may be among those told.
        every_pair: find the nearest of every pair too.
        over_time: find the smallest distances at all samples too.
        progress: show a bar on stderr.

    Raises:
        OptionError: an argument out of its range, or a run without samples.
    """
    path = _path_of(what, nodes, time, velocities)
    kinds = _kinds(pairs)
    margin = positive("tolerance", tolerance, "m")
    level = finite("below", below, " [m]")
    radius = finite("string_radius", string_radius, " >= 0 m")
    if radius < 0:
        raise OptionError(f"string_radius = {string_radius!r}; it must be a finite number >= 0 m")
    return _Search(path, kinds, level, radius, margin).result(every_pair, over_time, progress)


@dataclass(frozen=True)
class _Path:
    """Nodes over time: time (T,), nodes and velocities (T, N, 3); until (M,): when each string breaks."""

    name: str
    structure: Structure
    time: Array
    nodes: Array
    velocities: Array
    until: Array


def _path_of(what: Any, nodes: ArrayLike | None, time: ArrayLike | None, velocities: ArrayLike | None) -> _Path:
    if isinstance(what, Trajectory):
        _refuse_given("a run has its own", nodes=nodes, time=time, velocities=velocities)
        structure = what.scene.structure
        good = np.isfinite(what.nodes).all(axis=(1, 2)) & np.isfinite(what.velocities).all(axis=(1, 2))
        count = int(np.argmin(good)) if not good.all() else len(what.time)
        if count == 0:
            raise OptionError(f"the run of scene '{what.scene.name}' ({what.engine}) has no samples to look at")
        until = np.full(len(structure.strings), np.inf)
        rows = {string.name: row for row, string in enumerate(structure.strings)}
        for event in what.scene.breaks:
            until[rows[event.string]] = min(until[rows[event.string]], event.time)
        return _Path(what.scene.name, structure, what.time[:count], what.nodes[:count], what.velocities[:count], until)
    if isinstance(what, Scene):
        _refuse_given("a scene has its own start", nodes=nodes, time=time, velocities=velocities)
        return _still(what.name, what.structure, what.nodes0)
    if not isinstance(what, Structure):
        if not (hasattr(what, "model") and hasattr(what, "nodes")):
            raise OptionError(f"clearance of {what!r}; it must be a Trajectory, Scene, Structure or StaticState")
        _refuse_given("a state has its own", nodes=nodes, time=time, velocities=velocities)
        return _still(what.model.scene.name, what.model.structure, what.nodes)
    count = len(what.nodes)
    if nodes is None:
        _refuse_given("they are of nodes (T, N, 3), which are missing", time=time, velocities=velocities)
        return _still(what.name, what, what.positions)
    if time is None:
        _refuse_given("they are of nodes (T, N, 3), whose time is missing", velocities=velocities)
        return _still(what.name, what, real_array("nodes", nodes, (count, 3), "m", scalar=False))
    if velocities is None:
        raise OptionError("velocities are missing: between samples the motion follows from them; give (T, N, 3) [m/s]")
    times = real_array("time", time, np.shape(time), "s", scalar=False)
    if times.ndim != 1 or not len(times) or np.any(np.diff(times) <= 0):
        raise OptionError("time must be an array (T,) of increasing times [s]")
    shape = (len(times), count, 3)
    moved, rates = (
        real_array("nodes", nodes, shape, "m", scalar=False),
        real_array("velocities", velocities, shape, "m/s", scalar=False),
    )
    return _Path(what.name, what, times, moved, rates, np.full(len(what.strings), np.inf))


def _still(name: str, structure: Structure, nodes: Array) -> _Path:
    until = np.full(len(structure.strings), np.inf)
    return _Path(name, structure, np.zeros(1), nodes[None], np.zeros((1, *nodes.shape)), until)


def _refuse_given(why: str, **values: Any) -> None:
    for name, value in values.items():
        if value is not None:
            raise OptionError(f"{name} given: {why}; leave it out")


def _kinds(pairs: Collection[Pairs]) -> tuple[Pairs, ...]:
    wanted = (pairs,) if isinstance(pairs, Pairs) else tuple(pairs)
    for kind in wanted:
        if not isinstance(kind, Pairs):
            raise OptionError(f"pairs: {kind!r}; allowed: {', '.join(str(kind) for kind in Pairs)}")
    if not wanted:
        raise OptionError("pairs is empty; give at least one kind of pairs")
    return tuple(kind for kind in Pairs if kind in wanted)


class _Search:
    """The elements of a path as the compiled searches want them; elements are the rods, then the strings."""

    def __init__(self, path: _Path, kinds: Sequence[Pairs], level: float, string_radius: float, margin: float) -> None:

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
        self._sort()

    def _sort(self) -> None:
        """Pairs in the order of how near they are at some samples; these give first limits of what is looked for."""
        from tensegrity_mj.runs.segments import closest_points

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
        """All that was asked for."""
        from tensegrity_mj.runs import clearance_kernels as kernels

        arrays = (self.nodes, self.until, self.radii)
        found = np.zeros((len(self.pairs), 4))
        events: list[Event] = []
        curves = np.full((len(Pairs), len(self.time)), np.inf)
        for first, last in _pieces(len(self.pairs), progress):
            pairs, kinds = self.pairs[first:last], self.pair_kinds[first:last]
            moving = (self.P, self.V, self.time, self.way)
            piece = found[first:last]
            kernels.search(*moving, *arrays, pairs, kinds, self.limits, bool(every_pair), self.margin, piece)
            if over_time:
                kernels.history(self.P, self.time, self.way, *arrays, pairs, kinds, curves)
            events += self._events(pairs, kinds)
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

    def _ends(self, i: int, j: int) -> tuple[int, int, int, int]:
        (a, b), (c, d) = self.nodes[i], self.nodes[j]
        return int(a), int(b), int(c), int(d)

    def _approach(self, row: int, found: Array) -> Approach:
        """The nearest of one pair, from what the search has found of it."""
        i, j = (int(e) for e in self.pairs[row])
        until = float(min(self.until[i], self.until[j], self.time[-1]))
        return self._sharpened(i, j, int(found[1]), float(found[2]), float(found[3]), float(self.time[0]), until)

    def _sharpened(self, i: int, j: int, k: int, part: float, width: float, start: float, end: float) -> Approach:
        from tensegrity_mj.runs import clearance_kernels as kernels

        ends = self._ends(i, j)
        apart, when, s, t = kernels.sharpened(self.P, self.V, self.time, ends, k, part, width, start, end)
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

    def _events(self, pairs: IntArray, kinds: IntArray) -> list[Event]:
        """All stretches of time in which one of these pairs is at most the asked distance apart."""
        from tensegrity_mj.runs import clearance_kernels as kernels

        arrays = (self.nodes, self.until, self.radii)
        moving = (self.P, self.V, self.time, self.way)
        room = 4 * len(pairs) + 16
        while True:
            out, owner = np.empty((room, 2)), np.empty(room, np.int64)
            count = kernels.all_stretches(*moving, *arrays, pairs, self.level + self.margin, self.margin, out, owner)
            if count <= room:
                break
            room = count
        events = []
        noise = max(NOISE * self.size, NOISE_OF_TOLERANCE * self.margin)
        for (start, end), number in zip(out[:count].tolist(), owner[:count], strict=True):
            i, j = (int(e) for e in pairs[number])
            ends = self._ends(i, j)
            _, k, part, width = kernels.least(*moving, i, j, ends, start, end, np.inf, self.margin)
            closest = self._sharpened(i, j, k, part, width, start, end)
            passed = np.empty(0)
            size = 8
            while len(self.time) > 1:
                passed = np.empty(size)
                times = kernels.crossings(self.P, self.V, self.time, ends, start, end, noise, passed)
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
    """(first, last) of pieces of the pairs, under a bar if asked for."""
    from tqdm import tqdm

    with tqdm(total=count, desc="clearance", unit="pair", disable=None if progress else True) as bar:
        for first in range(0, count, PIECE):
            last = min(first + PIECE, count)
            yield first, last
            bar.update(last - first)
