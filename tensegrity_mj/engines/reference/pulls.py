"""Search for strings that are slack at both ends of a step, but pull for a moment within it.

Slack strings leave a motion so smooth that error-controlled steps grow long, and none of their stages may see it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import borrowing
from tensegrity_mj.dynamics.native.vectors import dot, row_of
from tensegrity_mj.engines.reference.dop853 import GOING, PULLED, interpolate, make_dense
from tensegrity_mj.engines.reference.equations import place

LOOKS = 16  # times within a step at which such a string is looked at, and again about its longest


@borrowing
def pulls_within(own: Any) -> int:
    """PULLED where any string does so in the step of a run (`dop853.Controlled`), by looking at states in between."""
    if not _may_pull(own):
        return GOING
    answer = make_dense(own)
    if answer:
        return answer
    start, end, near, longest = own.t, own.end, own.near, own.longest
    for m in range(len(near)):
        longest[m] = 0
    if _look(own, start, end, True):
        return PULLED
    spacing = (end - start) / LOOKS
    for k in range(LOOKS + 1):
        longest_here = False
        for m in range(len(near)):
            longest_here |= near[m] != 0 and longest[m] == k
        t = start + k * spacing
        if longest_here and _look(own, max(t - spacing, start), min(t + spacing, end), False):
            return PULLED
    return GOING


@borrowing
def _may_pull(own: Any) -> bool:
    """Mark in `near` the strings that are slack at both ends, and not too slack to have pulled within the step.

    Both ends of a segment may run at twice the speed of the step's ends, and have to come back again.
    """
    plant, near, gaps = PlantView(own.table), own.near, own.gaps
    broken, ranges, any_near = plant.broken, plant.ranges, False
    for m in range(len(near)):
        near[m], gaps[m] = broken[m] == 0, np.inf
    fastest = max(_gaps_at(own, own.y), _gaps_at(own, own.new))
    reach = 2.0 * np.sqrt(fastest) * (own.end - own.t)
    for m in range(len(near)):
        near[m] = near[m] != 0 and gaps[m] < (ranges[m, 1] - ranges[m, 0]) * reach
        any_near |= near[m] != 0
    return any_near


@borrowing
def _gaps_at(own: Any, y: Any) -> float:
    """Note in `gaps` and `near` how slack strings are at an end of the step; the largest squared speed of a node."""
    plant, near, gaps, fastest = PlantView(own.table), own.near, own.gaps, 0.0
    rest, lengths, velocities = plant.rest, plant.lengths, plant.velocities
    place(y, own.table)
    own.fresh = 0
    for m in range(len(near)):
        gap = rest[m] - lengths[m]
        gaps[m] = min(gaps[m], gap)
        near[m] = near[m] != 0 and gap > 0.0
    for n in range(len(velocities)):
        v = row_of(velocities, n)
        fastest = max(fastest, dot(v, v))
    return fastest


@borrowing
def _look(own: Any, start: float, end: float, note: bool) -> bool:
    """Return whether any of the strings `near` pulls at LOOKS + 1 times; `note` at which of them each is longest."""
    plant, near, longest, gaps, x = PlantView(own.table), own.near, own.longest, own.gaps, own.x
    rest, lengths = plant.rest, plant.lengths
    for m in range(len(near)):
        gaps[m] = np.inf
    for k in range(LOOKS + 1):
        interpolate(own, end if k == LOOKS else start + k * ((end - start) / LOOKS), x)
        place(x, own.table)
        for m in range(len(near)):
            gap = rest[m] - lengths[m]
            if near[m] and gap < 0.0:
                return True
            if note and gap < gaps[m]:
                gaps[m], longest[m] = gap, k
    return False
