"""Where on a curve of equilibria the stiffness, at constant parameter, stops or begins being positive definite."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.statics.path_steps import Point, Walk, zero
from tensegrity_mj.statics.state import StaticState

LOCATED = 1e-10  # of the arc between two points, or of the change of an eigenvalue: how well a critical point is known
SOFT = 1e-3  # of the change of an eigenvalue: below it, motions may be left out where they do not matter
TOGETHER = 1e-6  # of it: critical points that are nearer count as one


class Kind(enum.Enum):
    """What happens where the stiffness stops being definite."""

    LIMIT = "limit point"  # the parameter turns back
    BIFURCATION = "bifurcation"  # another curve of equilibria crosses
    SLACK = "slack string"  # the stiffness jumps, as a string becomes slack or taut


@dataclass(frozen=True, eq=False)
class Critical:
    """A state at which the stiffness, at constant parameter, stops (or begins) being positive definite.

    Attributes:
        kind: what happens there.
        state: the equilibrium.
        modes: (m, N, 3) the motions that nothing resists there, the largest entry of each 1: how the structure
            buckles. Mostly there is one; symmetry makes them come in pairs, of which any combination is another.
        unstable_before, unstable_after: how many independent motions are unstable.
    """

    kind: Kind
    state: StaticState
    modes: Array
    unstable_before: int
    unstable_after: int

    @property
    def mode(self) -> Array:
        """(N, 3) the first of the modes."""
        return np.asarray(self.modes[0])

    @property
    def parameter(self) -> float:
        """s."""
        return self.state.parameter


class Crossing(NamedTuple):
    """A critical state, and it as a point of the curve."""

    critical: Critical
    point: Point


def hides(before: Point, after: Point) -> bool:
    """Whether the parameter turns back between two points of the same stability."""
    return before.tangent.s * after.tangent.s < 0 and (before.unstable - after.unstable) % 2 == 0


def crossings(walk: Walk, before: Point, after: Point) -> list[Crossing]:
    """Where between two points motions become unstable, or stable again."""
    fewer, more = sorted((before.unstable, after.unstable))
    if fewer == more:
        return []
    dx, ds = after.state.x - before.state.x, after.state.parameter - before.state.parameter
    whole_arc = walk.along(before.tangent, dx, ds)
    seen = {0.0: before, whole_arc: after}
    places = sorted((*_enclosed(walk, seen, which), which) for which in range(fewer, more))
    groups = [[places[0]]]
    for place in places[1:]:
        if place[0] - groups[-1][-1][0] <= TOGETHER * whole_arc:
            groups[-1].append(place)
        else:
            groups.append([place])
    turned = before.tangent.s * after.tangent.s < 0
    flattest = min(groups, key=lambda group: abs(seen[group[0][1]].tangent.s)) if turned else None
    out = []
    for group in groups:
        _, a, b, _ = group[0]
        which = [place[3] for place in group]
        steep = 1e-3 * abs(before.value(which[0]) - after.value(which[0]))
        out.append(_crossing(seen[a], seen[b], steep, which, after.unstable == more, group is flattest))
    return out


def _enclosed(walk: Walk, seen: dict[float, Point], which: int) -> tuple[float, float, float]:
    """Where an eigenvalue changes sign, and the arcs seen on both sides of it; points looked at are added."""
    before, after = seen[min(seen)], seen[max(seen)]
    # Where an end is as good as critical, and has no sign of its own, it counts as `unstable` says.
    shift = 0.0 if before.value(which) * after.value(which) < 0 else zero(walk.model)
    scale = abs(before.value(which) - after.value(which))

    def value(arc: float) -> float:
        if arc not in seen:
            point = walk.step(before, arc, bend=-np.inf)
            if point is None:
                # Next to a bifurcation round-off leads off the curve, along motions that hardly anything resists.
                near = min(seen.values(), key=lambda other: abs(other.value(which)))
                soft = near.modes[:, np.abs(near.values) < SOFT * scale]
                point = walk.step(before, arc, bend=-np.inf, idle=soft)
            if point is None:  # beyond a corner
                return after.value(which) + shift
            seen[arc] = point
        there = seen[arc].value(which) + shift
        return there if abs(there) > LOCATED * scale else 0.0

    def is_above(arc: float) -> bool:
        return seen[arc].value(which) + shift >= 0

    def enclosing() -> tuple[float, float]:
        return next((a, b) for a, b in pairwise(sorted(seen)) if is_above(a) != is_above(b))

    root = brentq(value, *enclosing(), xtol=LOCATED * max(seen), maxiter=200, disp=False)
    return (float(root), *enclosing())


def _crossing(low: Point, high: Point, steep: float, which: list[int], rising: bool, turns: bool) -> Crossing:
    fewer, more = min(which), max(which) + 1
    jump = min(abs(low.value(fewer)), abs(high.value(fewer))) > steep
    changed = bool(np.any(low.state.slack != high.state.slack))
    kind = Kind.SLACK if jump and changed else Kind.LIMIT if turns else Kind.BIFURCATION
    there = min(low, high, key=(lambda p: p.value(fewer)) if jump else (lambda p: abs(p.value(fewer))))
    modes = there.state.softest(more)[1][:, fewer:].T
    largest = np.take_along_axis(modes, np.abs(modes).argmax(axis=1)[:, None], axis=1)
    modes = (modes / largest).reshape(len(modes), -1, 3)
    counts = (fewer, more) if rising else (more, fewer)
    return Crossing(Critical(kind, there.state, modes, *counts), there)
