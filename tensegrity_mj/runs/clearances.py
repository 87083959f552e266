"""Clearance: how near rods and strings come to each other, which, when and where. Thesis §2.5 and §8.2.

An element is the straight line between its two nodes, a rod a capsule of its radius about that line, as in `contact`; a
string has a radius of zero unless given, and slack ones are as straight as taut ones. Distances are those of
the surfaces, negative where elements overlap: by what must be given way to, or by all of both radii where the centre
lines cross.

Elements that share a node are joined and not looked at: their distance is zero at the joint, by construction. So
nothing is said of two joined rods that fold onto each other.

Between its samples a trajectory is the cubics of its node positions and velocities (Hermite). Over these the search
leaves nothing out, see `least_distance`: a thin rod that passes another between two samples is found. What the
cubics differ from the true motion is estimated by how well those over every second sample meet the samples between.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import finite, positive, real_array
from tensegrity_mj.basics.functions import function_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.approaches import Clearance, Pairs
from tensegrity_mj.runs.clearance_search import ClearanceSearch, Path
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.statics.state import StaticState


@dataclass(frozen=True, eq=False)
class ClearanceOf:
    """The smallest distances between rods, between rods and strings, and between strings.

    Attributes:
        what: a run; or a scene (at its start), a structure (at its reference) or a state of equilibrium.
        nodes: of a structure elsewhere: (N, 3) [m], or (T, N, 3) with `time` (T,) [s] and `velocities` [m/s].
        pairs: kinds of pairs to look at.
        below: [m]: `events` has all approaches to at most this; 0 for touches and passages.
        string_radius: [m] of every string.
        tolerance: [m], see `Clearance`; events of down to this much above `below` may be among those reported.
        every_pair: find the nearest of every pair too.
        over_time: find the smallest distances at all samples too.
        progress: show a bar on stderr.

    Raises:
        OptionError: an argument out of its range, or a run without samples.
    """

    what: Trajectory | Scene | Structure | StaticState
    nodes: ArrayLike | None = None
    _: KW_ONLY
    time: ArrayLike | None = None
    velocities: ArrayLike | None = None
    pairs: Collection[Pairs] = tuple(Pairs)
    below: float = 0.0
    string_radius: float = 0.0
    tolerance: float = 1e-6
    every_pair: bool = False
    over_time: bool = False
    progress: bool = False

    def __call__(self) -> Clearance:
        path = _path_of(self.what, self.nodes, self.time, self.velocities)
        kinds = _kinds(self.pairs)
        margin = positive("tolerance", self.tolerance, "m")
        level = finite("below", self.below, " [m]")
        radius = finite("string_radius", self.string_radius, " >= 0 m")
        if radius < 0:
            raise OptionError(f"string_radius = {self.string_radius!r}; it must be a finite number >= 0 m")
        return ClearanceSearch(path, kinds, level, radius, margin).result(
            self.every_pair, self.over_time, self.progress
        )


clearance = function_of(ClearanceOf)


def _path_of(what: Any, nodes: ArrayLike | None, time: ArrayLike | None, velocities: ArrayLike | None) -> Path:
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
        return Path(what.scene.name, structure, what.time[:count], what.nodes[:count], what.velocities[:count], until)
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
    moved = real_array("nodes", nodes, shape, "m", scalar=False)
    rates = real_array("velocities", velocities, shape, "m/s", scalar=False)
    return Path(what.name, what, times, moved, rates, np.full(len(what.strings), np.inf))


def _still(name: str, structure: Structure, nodes: Array) -> Path:
    until = np.full(len(structure.strings), np.inf)
    return Path(name, structure, np.zeros(1), nodes[None], np.zeros((1, *nodes.shape)), until)


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
