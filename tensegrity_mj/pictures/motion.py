"""Motion of a run for pictures: nodes and tensions at any time between samples, and the places of supports."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.target import target_positions
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model import strings
from tensegrity_mj.model.elements.terrain import Terrain
from tensegrity_mj.model.elements.water import sea_of
from tensegrity_mj.model.elements.waves import Sea
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.pictures.camera import corners_of
from tensegrity_mj.runs.trajectory import Status, Trajectory


@dataclass(frozen=True, eq=False)
class Pose:
    """One instant: node positions (N, 3) [m]; of the strings (M,) tensions [N], rest lengths [m], and which broke."""

    nodes: Array
    tensions: Array
    rest_lengths: Array
    broken: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Motion:
    """The drawable part of a trajectory; every number in it is finite.

    Attributes:
        structure, target: what is drawn.
        down: unit vector (3,) that slack strings hang along: gravity's, or -z where there is none.
        title, label: the scene's name; the engine's line.
        note: what a viewer must know about how the run ended, or nothing.
        diverged: whether the last samples may be beyond all reason.
        time: (T,) strictly increasing [s], T >= 1.
        nodes, velocities: (T, N, 3) [m], [m/s].
        tensions, rest_lengths: (T, M) [N], [m].
        break_times: (M,) [s] when each string breaks, ∞ for never; it is not drawn from then on.
        floor: what it may land on: a point of it [m] and its unit normal, (3,) each, or None.
        terrain: what is uneven on the floor, or None.
        sea: the waves of the water that it is in, or None.
    """

    structure: Structure
    target: Target | None
    down: Array
    title: str
    label: str
    note: str
    diverged: bool
    time: Array
    nodes: Array
    velocities: Array
    tensions: Array
    rest_lengths: Array
    break_times: Array
    floor: tuple[Array, Array] | None
    terrain: Terrain | None
    sea: Sea | None

    @classmethod
    def of(cls, source: Trajectory | Scene) -> Motion:
        """The motion of a run, or a scene at rest at its start.

        A run is drawn up to its first sample that is not finite.

        Raises:
            OptionError: if there is no finite sample at all, or the source is neither of the two.
        """
        if isinstance(source, Scene):
            structure, nodes, rest = source.structure, source.nodes0, source.structure.rest_lengths
            lengths, rates = structure.string_lengths(nodes), structure.string_rates(nodes, source.velocities0)
            pull = strings.tension(structure.curves, structure.damping, lengths, rates, rest, structure.clipped)
            samples = {"nodes": nodes, "velocities": source.velocities0, "tensions": pull, "rest_lengths": rest}
            at_once = {name: values[None] for name, values in samples.items()}
            return cls._in(source, label="", note="", diverged=False, time=np.zeros(1), **at_once)
        if not isinstance(source, Trajectory):
            raise OptionError(f"a picture is made of a Trajectory or a Scene, not of a {type(source).__name__}")
        # The leading part whose times increase and whose nodes are finite.
        good = np.isfinite(source.time) & np.all(np.isfinite(source.nodes), axis=(1, 2))
        good[1:] &= ~(np.diff(source.time) <= 0.0)
        count = len(good) if good.all() else int(np.argmin(good))
        if count == 0:
            raise OptionError(
                f"the trajectory of scene '{source.scene.name}' has no sample that can be drawn (it has "
                f"{len(source.time)}): at least one with finite time and node positions is needed"
            )
        note = ""
        if source.status is not Status.COMPLETED:
            note = f"{source.status.value} at t = {source.time[count - 1]:.4g} s"
        elif count < len(source.time):
            note = f"not finite after t = {source.time[count - 1]:.4g} s"
        rest = source.rest_lengths + source.permanent_stretch
        return cls._in(
            source.scene,
            label=source.engine,
            note=note,
            diverged=source.status is Status.DIVERGED or count < len(source.time),
            time=source.time[:count],
            nodes=source.nodes[:count],
            velocities=np.nan_to_num(source.velocities[:count], posinf=0.0, neginf=0.0),
            tensions=np.nan_to_num(source.tensions[:count], posinf=0.0, neginf=0.0),
            # A rest length that is not known is drawn as taut.
            rest_lengths=np.nan_to_num(rest[:count], posinf=0.0, neginf=0.0),
        )

    @classmethod
    def _in(cls, scene: Scene, **samples: Any) -> Motion:
        """Return the motion with what a scene adds to the samples."""
        contact = scene.contact
        return cls(
            structure=scene.structure,
            target=scene.target,
            down=down_of(scene),
            title=scene.name,
            break_times=scene.break_times,
            floor=None if contact is None or contact.floor is None else (contact.floor * contact.up, contact.up),
            terrain=None if contact is None else contact.terrain,
            sea=None if scene.water is None else sea_of(scene),
            **samples,
        )

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """Time of the last drawable sample [s]."""
        return float(self.time[-1])

    def positions(self, times: Array) -> Array:
        """Node positions (..., N, 3) [m] at the given times, which are clipped to the run.

        Cubic Hermite interpolation with the recorded velocities: error h⁴/384 max |d⁴n/dt⁴| for samples h apart.
        """
        moments = np.clip(np.asarray(times, float), self.start, self.end)
        if len(self.time) == 1:
            return np.broadcast_to(self.nodes[0], (*moments.shape, *self.nodes.shape[1:])).copy()
        return np.asarray(self._cubics(moments))

    def pose(self, time: float) -> Pose:
        """The instant at `time` [s]; tensions and rest lengths are interpolated linearly."""
        nodes = self.positions(np.array(time))
        if len(self.time) == 1:
            return Pose(nodes, self.tensions[0], self.rest_lengths[0], self.break_times <= self.start)
        moment = min(max(time, self.start), self.end)
        i = min(int(np.searchsorted(self.time, moment, side="right")), len(self.time) - 1) - 1
        s = (moment - self.time[i]) / (self.time[i + 1] - self.time[i])
        tensions, rest_lengths = ((1.0 - s) * one[i] + s * one[i + 1] for one in (self.tensions, self.rest_lengths))
        return Pose(nodes, tensions, rest_lengths, self.break_times <= time)

    def aim(self, pose: Pose, time: float) -> Pose | None:
        """A pose at `time` [s] moved to where the target is then; None without one."""
        targets = self.target_positions(np.array([time]))
        return None if targets is None else replace(pose, nodes=targets[0])

    def target_positions(self, times: Array) -> Array | None:
        """Node positions (T, N, 3) [m] of the target at times (T,); None without a target."""
        return target_positions(self.structure, self.target, times)

    def corners(self) -> Array:
        """Return where members meet, see `corners_of`, at a few instants; of very many members, every so many."""
        structure = self.structure
        pairs = np.concatenate([structure.rod_nodes, structure.paths.nodes, structure.body_edges])
        nodes = self.positions(np.linspace(self.start, self.end, 1 if len(self.time) == 1 else 7))
        return corners_of(pairs[:: 1 + len(pairs) // 150], nodes)

    @cached_property
    def _cubics(self) -> Any:
        from scipy.interpolate import CubicHermiteSpline  # slow to load

        return CubicHermiteSpline(self.time, self.nodes, self.velocities)


def down_of(scene: Scene) -> Array:
    """Unit vector (3,) along gravity, or -z where there is none."""
    gravity = np.array(scene.gravity, float)
    size = float(np.linalg.norm(gravity))
    return gravity / size if size > 0.0 else np.array([0.0, 0.0, -1.0])


MAX_PIECES = 400  # drawn at a time; where a run leaves more, the oldest vanish
MAX_SAMPLES = 6000  # of a path before it is simplified


@dataclass(frozen=True, eq=False)
class Traces:
    """Straight pieces of all traces in the order in which they are completed.

    Attributes:
        starts, ends: (P, 3) [m].
        times: (P,) when each is complete [s], ascending.
        nodes: (P,) the node that leaves it.
        corners: for each traced node's row, the times (C,) and positions (C, 3) of the corners of its trace.
    """

    starts: Array
    ends: Array
    times: Array
    nodes: NDArray[np.int64]
    corners: dict[int, tuple[Array, Array]]

    @classmethod
    def of(cls, motion: Motion, rows: NDArray[np.int64], tolerance: float) -> Traces:
        """Traces of the nodes `rows`, off the true path by at most `tolerance` [m]."""
        # The times of a film's frames are not known here: sample finely enough that Hermite pieces look smooth.
        fine = 4 if len(motion.time) < MAX_SAMPLES // 4 else 1
        count = min((len(motion.time) - 1) * fine + 1, MAX_SAMPLES)
        times = np.interp(np.linspace(0, len(motion.time) - 1, count), np.arange(len(motion.time)), motion.time)
        paths = motion.positions(times)
        pieces = [(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64))]
        corners: dict[int, tuple[Array, Array]] = {}
        for row in rows:
            chosen = simplify(paths[:, row], tolerance)
            points = paths[chosen, row]
            corners[int(row)] = (times[chosen], points)
            pieces.append((points[:-1], points[1:], times[chosen][1:], np.full(len(chosen) - 1, row)))
        starts, ends, done, nodes = (np.concatenate(column) for column in zip(*pieces, strict=True))
        order = np.argsort(done, kind="stable")
        return cls(starts[order], ends[order], done[order], nodes[order], corners)


def moving_rows(motion: Motion, tolerance: float) -> NDArray[np.int64]:
    """Rows of the nodes of members as given that move farther than `tolerance` [m] from where they start."""
    index = motion.structure.node_index
    carried = set(motion.structure.rod_nodes.ravel().tolist())
    carried |= {index[mass.node] for mass in motion.structure.given.point_masses}
    carried |= {int(row) for frame in motion.structure.moving_frames for row in frame.rows}
    travel = np.max(np.linalg.norm(motion.nodes - motion.nodes[0], axis=-1), axis=0)
    return np.array([row for row in sorted(carried) if travel[row] > tolerance], np.int64)


def simplify(path: Array, tolerance: float) -> NDArray[np.int64]:
    """Indices of the points (P, 3) to keep so that no other is farther than `tolerance` from the line through them.

    The method of Douglas and Peucker: split at the farthest point until all are near.
    """
    keep = np.zeros(len(path), bool)
    keep[[0, -1]] = True
    pending = [(0, len(path) - 1)]
    while pending:
        first, last = pending.pop()
        if last - first < 2:
            continue
        inner = path[first + 1 : last] - path[first]
        chord = path[last] - path[first]
        length = float(chord @ chord)
        share = np.clip(inner @ chord / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(inner))
        distance = np.linalg.norm(inner - share[:, None] * chord, axis=1)
        farthest = int(np.argmax(distance))
        if distance[farthest] > tolerance:
            middle = first + 1 + farthest
            keep[middle] = True
            pending += [(first, middle), (middle, last)]
    return np.flatnonzero(keep)


def supported_points(structure: Structure, nodes: Array) -> list[tuple[Array, int]]:
    """Return the points [m] where the structure is held, each with its number of held directions (1 to 3)."""
    places = support_places(structure)
    return [((1.0 - sigma) * nodes[i] + sigma * nodes[j], held) for i, j, sigma, held, _ in places]


def support_places(structure: Structure) -> list[tuple[int, int, float, int, str]]:
    """Rows of two nodes, σ of the held point between them, in how many directions it is held, and what holds it.

    Linear constraints of one or two nodes are among them.
    """
    rows = structure.node_index
    places = [(rows[name], rows[name], 0.0, 3, name) for name in structure.fixed_nodes]
    for rod, (i, j) in zip(structure.rods, structure.rod_nodes.tolist(), strict=True):
        if held := len(rod.support.directions):
            places.append((i, j, rod.support.sigma, held, f"support of {rod.name}"))
    for one in structure.constraints:
        (first, *_), (last, weight), total = one.nodes, list(one.nodes.items())[-1], sum(one.nodes.values())
        if len(one.nodes) <= 2 and total:
            places.append((rows[first], rows[last], weight / total, 1, one.name))
    return places
