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
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import real_array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.functions import function_of
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.approaches import Clearance, Pairs
from tensegrity_mj.runs.clearance_search import ClearanceSearch, Path
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.statics.state import StaticState


_SEVERAL = kinds.many(kinds.choice(Pairs), "a list of kinds")
KINDS = _SEVERAL._replace(plain=lambda value: _SEVERAL.plain([value] if isinstance(value, (Pairs, str)) else value))


@value("clearance", OptionError, positional=2, eq=False)
class ClearanceOf:
    """The smallest distances between rods, between rods and strings, and between strings.

    Attributes:
        what: a run; or a scene (at its start), a structure (at its reference) or a state of equilibrium.
        nodes: of a structure elsewhere: (N, 3) [m], or (T, N, 3) with `time` (T,) [s] and `velocities` [m/s].
        pairs: kinds of pairs to look at, or one.
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
