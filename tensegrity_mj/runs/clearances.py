"""Clearance: how near rods and strings come to each other, which, when and where. Thesis §2.5 and §8.2.

An element is the straight line between its two nodes, a rod a capsule of its radius about that line, as in `contact`; a
string has a radius of zero unless given, and slack ones are as straight as taut ones. Distances are those of
the surfaces, negative where elements overlap: by what must be given way to, or by all of both radii where the centre
lines cross.

Elements that share a node are joined and left out: their distance is zero at the joint, by construction. So two joined
rods that fold onto each other are not reported.

Between its samples a trajectory is the cubics of its node positions and velocities (Hermite). Over these the search
leaves nothing out, see `least_distance`: a thin rod that passes another between two samples is found. The difference
between the cubics and the true motion is estimated by how well those over every second sample meet the samples between.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import real_array
from tensegrity_mj.basics.fields import field, function_of, value
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.elements.contact import sharing
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs import least_distance as kernels
from tensegrity_mj.runs import segments as moving
from tensegrity_mj.runs.approaches import Approach, Clearance, Event, Pairs
from tensegrity_mj.runs.segments import closest_points
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.statics.state import StaticState

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
    """The elements of a path as the compiled searches want them: the rods, then the strings' straight segments."""

    def __init__(self, path: Path, kinds: Sequence[Pairs], level: float, string_radius: float, margin: float) -> None:
        structure = path.structure
        self.path, self.kinds, self.level, self.margin = path, kinds, level, margin
        increasing = np.concatenate([[True], np.diff(path.time) > 0])
        time, positions, velocities = path.time[increasing], path.nodes[increasing], path.velocities[increasing]
        self.samples, self.end = len(time), float(time[-1])
        if self.samples == 1:  # it stands still
            time = np.array([self.end, self.end + 1.0])
            positions, velocities = positions[[0, 0]], np.zeros((2, *positions.shape[1:]))
        self.time, self.positions, self.velocities = np.ascontiguousarray(time), positions, velocities
        # Of each node over time, and seen from the mean of all nodes: what all do together brings nothing nearer.
        self.P = np.ascontiguousarray((positions - positions.mean(axis=1, keepdims=True)).transpose(1, 0, 2))
        self.V = np.ascontiguousarray((velocities - velocities.mean(axis=1, keepdims=True)).transpose(1, 0, 2))
        self.size = float(np.ptp(self.P.reshape(-1, 3), axis=0).max(initial=0.0))
        segments, strings = structure.paths.nodes, structure.paths.strings
        self.nodes = np.concatenate([structure.rod_nodes, segments])
        self.names = [rod.name for rod in structure.rods] + [structure.strings[row].name for row in strings]
        rods = len(structure.rods)
        self.radii = np.array([rod.radius for rod in structure.rods] + [string_radius] * len(segments))
        self.until = np.concatenate([np.full(rods, np.inf), path.until[strings]])
        self.pairs, self.pair_kinds = _pairs(self.nodes, rods, kinds, self.until > self.time[0])
        self.way = np.zeros((len(self.nodes), len(self.time)))
        moving.paths(self.P, self.V, self.time, self.nodes, self.way)
        self.motion = moving.Motion(self.P, self.V, self.time, self.way)
        self.elements = kernels.Elements(self.nodes, self.until, self.radii)
        self._sort()

    def _sort(self) -> None:
        """Pairs in the order of how near they are at some samples; these give first limits of what is looked for."""
        near = np.full(len(self.pairs), np.inf)
        i, j = self.pairs[:, 0], self.pairs[:, 1]
        for k in np.unique(np.linspace(0, self.samples - 1, GLANCES).astype(int)):
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
        """Search for all that is requested."""
        found = np.zeros((len(self.pairs), 4))
        events: list[Event] = []
        curves = np.full((len(Pairs), len(self.time)), np.inf)
        with bar(progress, "clearance", total=len(self.pairs), unit="pair") as shown:
            for first in range(0, len(self.pairs), PIECE):
                rows = slice(first, first + PIECE)
                couples = kernels.Couples(self.pairs[rows], self.pair_kinds[rows])
                kernels.search(
                    self.motion, self.elements, couples, self.limits, bool(every_pair), self.margin, found[rows]
                )
                if over_time:
                    kernels.history(self.motion, self.elements, couples, curves)
                events += self._events(couples.pairs)
                shown.update(len(couples.pairs))
        smallest: dict[Pairs, Approach | None] = {}
        for kind in self.kinds:
            mine = np.flatnonzero((self.pair_kinds == _number(kind)) & (found[:, 3] >= 0))
            # A pair that was found first may have been undercut by no more than round-off: the sharpened ones decide.
            near = mine[found[mine, 0] <= found[mine, 0].min(initial=np.inf) + self.margin]
            closest = [self._approach(row, found[row]) for row in near[:GLANCES]]
            smallest[kind] = min(closest, key=lambda approach: approach.distance, default=None)
        each = (self._approach(row, found[row]) for row in range(len(found)) if every_pair)
        return Clearance(
            name=self.path.name,
            start=float(self.time[0]),
            end=self.end,
            samples=self.samples,
            tolerance=self.margin,
            interpolation_error=self._interpolation_error(),
            planar=self._planar(),
            smallest=smallest,
            below=self.level,
            events=tuple(sorted(events, key=lambda event: (event.start, event.closest.distance))),
            pairs=tuple(sorted(each, key=lambda approach: approach.distance)) if every_pair else None,
            time=self.time[: self.samples] if over_time else np.zeros(0),
            over_time={k: curves[_number(k), : self.samples] for k in self.kinds} if over_time else None,
        )

    def _approach(self, row: int, found: Array) -> Approach:
        """The nearest of one pair, from what the search has found of it."""
        i, j = (int(e) for e in self.pairs[row])
        until = float(min(self.until[i], self.until[j], self.end))
        place = (int(found[1]), float(found[2]), float(found[3]))
        return self._sharpened((i, j), place, (float(self.time[0]), until))

    def _sharpened(self, pair: tuple[int, int], place: tuple[int, float, float], span: tuple[float, float]) -> Approach:
        """The nearest of a pair about a place (interval, part, width) within a span of time."""
        i, j = pair
        ends, thick, _ = kernels.couple(self.elements, i, j)
        apart, when, s, t = kernels.sharpened(self.motion, ends, *place, span)
        a, b, c, d = self._world(when)[list(ends)]
        rods = len(self.path.structure.rods)
        kind = Pairs.ROD_ROD if j < rods else Pairs.ROD_STRING if i < rods else Pairs.STRING_STRING
        spots = tuple(tuple((p + x * (q - p)).tolist()) for p, q, x in ((a, b, s), (c, d, t)))
        return Approach(
            kind,
            self.names[i],
            self.names[j],
            float(apart - thick),
            float(apart),
            float(when),
            (float(s), float(t)),
            cast("Any", spots),
        )

    def _world(self, when: float) -> Array:
        """Node positions (N, 3) [m] at a time."""
        k = moving.interval_of(self.time, when)
        h = self.time[k + 1] - self.time[k]
        return _hermite((when - self.time[k]) / h, h, *self.positions[k : k + 2], *self.velocities[k : k + 2])

    def _events(self, pairs: IntArray) -> Iterator[Event]:
        """All stretches of time in which one of these pairs is at most the level apart."""
        level, noise = self.level + self.margin, max(NOISE * self.size, NOISE_OF_TOLERANCE * self.margin)
        for row, start, end in kernels.all_stretches(self.motion, self.elements, pairs, level, self.margin):
            pair, span = (int(pairs[row, 0]), int(pairs[row, 1])), (start, min(end, self.end))
            ends = kernels.couple(self.elements, *pair)[0]
            _, *place = kernels.least(self.motion, pair, ends, span, np.inf, self.margin)
            times = kernels.crossings(self.motion, ends, span, noise)
            yield Event(self._sharpened(pair, tuple(place), span), *span, tuple(times))

    def _interpolation_error(self) -> float:
        """Error of distances [m]: twice a node's, whose cubics over h err by h⁴/384 times its fourth derivative.

        Over two intervals h₀ and h₁ the error at the sample between is h₀² h₁² / 24 times that derivative.
        """
        time, nodes, velocities = self.time, self.positions, self.velocities
        if self.samples == 1:
            return 0.0
        if self.samples == 2:
            return float("nan")
        h0, h1 = (np.diff(time)[:-1, None, None], np.diff(time)[1:, None, None])
        x, h = h0 / (h0 + h1), h0 + h1
        between = _hermite(x, h, nodes[:-2], nodes[2:], velocities[:-2], velocities[2:])
        derivative = 24 * np.linalg.norm(between - nodes[1:-1], axis=-1) / (h0**2 * h1**2)[..., 0]
        errors = derivative * (np.maximum(h0, h1) ** 4)[..., 0] / 384
        return float(2 * errors.max(initial=0.0))

    def _planar(self) -> bool:
        """Return whether one plane holds all nodes at all times."""
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


def _pairs(nodes: IntArray, rods: int, kinds: Sequence[Pairs], whole: NDArray[np.bool_]) -> tuple[IntArray, IntArray]:
    """Rows of the elements of all pairs (P, 2) that share no node, and their kinds (P,)."""
    i, j = np.triu_indices(len(nodes), 1)
    number = (i >= rods).astype(np.int64) + (j >= rods)  # as in `Pairs`
    wanted = ~sharing(nodes[i], nodes[j]) & np.isin(number, [_number(kind) for kind in kinds]) & whole[i] & whole[j]
    return np.stack([i, j], axis=1).astype(np.int64)[wanted], number[wanted]


def _number(kind: Pairs) -> int:
    return list(Pairs).index(kind)


_SEVERAL = kinds.many(kinds.choice(Pairs), "a list of kinds")
KINDS = _SEVERAL._replace(plain=lambda value: _SEVERAL.plain([value] if isinstance(value, (Pairs, str)) else value))


@value("clearance", OptionError, positional=2, eq=False)
class ClearanceOf:
    """The smallest distances between rods, between rods and strings, and between strings.

    Attributes:
        what: a run; or a scene (at its start), a structure (at its reference) or a state of equilibrium.
        nodes: of a structure elsewhere: (N, 3) [m], or (T, N, 3) with `time` (T,) [s] and `velocities` [m/s].
        pairs: kinds of pairs to search, or one.
        below: [m]: `events` has all approaches to at most this; 0 for touches and passages.
        string_radius: [m] of every string.
        tolerance: [m], see `Clearance`; events of down to this much above `below` may be among those reported.
        every_pair: find the nearest of every pair too.
        over_time: find the smallest distances at all samples too.
        progress: show a bar on stderr.

    Raises:
        OptionError: an argument out of its range, or a run without samples.
    """

    what: Trajectory | Scene | Structure | StaticState = field(None)
    nodes: ArrayLike | None = field(None, default=None)
    time: ArrayLike | None = field(None, default=None)
    velocities: ArrayLike | None = field(None, default=None)
    pairs: Collection[Pairs] = field(KINDS, default=tuple(Pairs))
    below: float = field(kinds.finite("m"), default=0.0)
    string_radius: float = field(kinds.not_negative("m"), default=0.0)
    tolerance: float = field(kinds.positive("m"), default=1e-6)
    every_pair: bool = field(kinds.flag(), default=False)
    over_time: bool = field(kinds.flag(), default=False)
    progress: bool = field(kinds.flag(), default=False)

    def __call__(self) -> Clearance:
        path = _path_of(self.what, self.nodes, self.time, self.velocities)
        wanted = [kind for kind in Pairs if kind in self.pairs]
        if not wanted:
            raise OptionError("clearance: pairs is empty; give at least one kind of pairs")
        search = ClearanceSearch(path, wanted, self.below, self.string_radius, self.tolerance)
        return search.result(self.every_pair, self.over_time, self.progress)


clearance = function_of(ClearanceOf)


def _path_of(what: Any, nodes: ArrayLike | None, time: ArrayLike | None, velocities: ArrayLike | None) -> Path:
    given = {"nodes": nodes, "time": time, "velocities": velocities}
    if isinstance(what, Trajectory):
        _refuse_given("a run has its own", **given)
        scene = what.scene
        good = np.isfinite(what.nodes).all(axis=(1, 2)) & np.isfinite(what.velocities).all(axis=(1, 2))
        count = int(np.argmin(good)) if not good.all() else len(what.time)
        if count == 0:
            raise OptionError(f"the run of scene '{what.scene.name}' ({what.engine}) has no samples to look at")
        samples = what.time[:count], what.nodes[:count], what.velocities[:count]
        return Path(scene.name, scene.structure, *samples, scene.break_times)
    if isinstance(what, Scene):
        _refuse_given("a scene has its own start", **given)
        return _still(what.name, what.structure, what.nodes0)
    if not isinstance(what, Structure):
        if not (hasattr(what, "model") and hasattr(what, "nodes")):
            raise OptionError(f"clearance of {what!r}; it must be a Trajectory, Scene, Structure or StaticState")
        _refuse_given("a state has its own", **given)
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
    moved = real_array("nodes", nodes, shape, "m", scalar=False)
    rates = real_array("velocities", velocities, shape, "m/s", scalar=False)
    return Path(what.name, what, times, moved, rates, np.full(len(what.strings), np.inf))


def _still(name: str, structure: Structure, nodes: Array) -> Path:
    until = np.full(len(structure.strings), np.inf)
    return Path(name, structure, np.zeros(1), nodes[None], np.zeros((1, *nodes.shape)), until)


def _refuse_given(why: str, **values: Any) -> None:
    for name, one in values.items():
        if one is not None:
            raise OptionError(f"{name} given: {why}; leave it out")
