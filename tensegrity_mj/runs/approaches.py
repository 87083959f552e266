"""Results of a clearance search: approaches of elements, stretches of time in which they are near, and the whole."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import plain_values


class Pairs(enum.Enum):
    """Kinds of pairs of elements."""

    ROD_ROD = "rod-rod"
    ROD_STRING = "rod-string"
    STRING_STRING = "string-string"


@dataclass(frozen=True)
class Approach:
    """Place and time at which two elements are nearest to each other.

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
    """A stretch of time in which two elements are at most the given distance apart.

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
        pairs: the nearest of every pair, the nearest first; None unless requested.
        time, over_time: at the samples (T,) [s] the smallest distance (T,) [m] of each kind; None unless requested.
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
        return plain_values(self, *(one.name for one in fields(self) if one.name not in ("time", "over_time")))
