"""Steps along a curve of equilibria: along its tangent, then by Newton's method across it."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import brentq

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.statics import linear_systems
from tensegrity_mj.statics.linear_systems import Linearized
from tensegrity_mj.statics.model import StaticModel, round_off
from tensegrity_mj.statics.state import StaticState

CORRECTIONS = 8  # of Newton's method, before a step is halved
NEARLY = 1e-6  # of the forces at first: corrections after that only take away round-off
SHARPEST = 0.8  # cosine of the angle between two tangents, below which a step is halved
EIGENVALUES = 4  # at every point, and as many more as are negative
ZERO = 1e-10  # of the stiffest string or joint, and
ROUGH = 1e-13  # of the stiffest rod: an eigenvalue of less counts as none


class Tangent(NamedTuple):
    """A direction of the curve."""

    x: Array  # (n,)
    s: float
    forces: Array  # (R,)


class Solution(NamedTuple):
    """Solution of the bordered equations."""

    step: Tangent
    pushed: float  # force by the parameter along the motions that were left out, as a part of all of it


class Point(NamedTuple):
    """An equilibrium on the curve."""

    state: StaticState
    tangent: Tangent
    values: Array  # lowest eigenvalues [N/m] of the stiffness at constant parameter, all that are negative among them
    modes: Array  # (n, of them)
    effort: int  # corrections until forces were nearly balanced

    @classmethod
    def of(cls, state: StaticState, at: Linearized, tangent: Tangent, effort: int = 0, expected: int = 0) -> Point:
        """Make a point with its eigenvalues, of which so many are expected to be negative."""
        count = EIGENVALUES + expected
        while True:
            values, modes = linear_systems.lowest_stiffness(at, count)
            if len(values) < count or values[-1] >= -zero(state.model):
                return cls(state, tangent, values, modes, effort)
            count *= 2

    @property
    def unstable(self) -> int:
        """Number of independent motions that are unstable at constant parameter."""
        return int(np.sum(self.values < -zero(self.state.model)))

    def value(self, which: int) -> float:
        """[N/m] the eigenvalue of that number, from 0; ∞ where there are fewer."""
        values = self.values if which < len(self.values) else self.state.softest(which + 1)[0]
        return float(values[which]) if which < len(values) else np.inf


class Walk:
    """Steps along a curve; arc is measured by a move [m] and a span of the parameter."""

    def __init__(self, model: StaticModel, move: float, span: float) -> None:
        self.model, self.move, self.span = model, move, span

    def step(self, at: Point, arc: float, *, bend: float = SHARPEST, idle: Array | None = None) -> Point | None:
        """The point so far ahead, or None where it is not found or the curve bends too much.

        Args:
            at: where to start.
            arc: how far to go.
            bend: the least cosine of the angle between the tangents here and there.
            idle: (n, p) motions that the correction does not make.
        """
        t = at.tangent
        x, s, forces = at.state.x + arc * t.x, at.state.parameter + arc * t.s, at.state.bar_forces + arc * t.forces
        return self._arrived(at, x, s, forces, t, bend, idle)

    def corner(self, at: Point, arc: float) -> Point | None:
        """The point so far ahead, around a corner: where strings that the tangent slackens, or pulls taut, are so."""
        model, t = self.model, at.tangent
        x, s, forces = at.state.x + arc * t.x, at.state.parameter + arc * t.s, at.state.bar_forces + arc * t.forces
        slack = model.tensions(model.lengths(x)) <= 0
        changed = np.flatnonzero(slack != at.state.slack)
        if not len(changed):
            return None
        tangent = self.tangent(Linearized(model, x, s, forces), t)
        if tangent is None:
            return None
        # The tangent has two senses: take the one in which these strings go on to lengthen, or shorten, as they did.
        lengthened = _lengthening(model, x, tangent.x)[changed] @ _lengthening(model, x, t.x)[changed]
        if lengthened < 0:
            tangent = Tangent(-tangent.x, -tangent.s, -tangent.forces)
        there = self._arrived(at, x, s, forces, tangent)
        return None if there is None or np.any(there.state.slack != slack) else there

    def at_parameter(self, before: Point, after: Point, goal: float) -> Point | None:
        """The point at a value of the parameter between two points."""
        part = (goal - before.state.parameter) / (after.state.parameter - before.state.parameter)
        x = before.state.x + part * (after.state.x - before.state.x)
        forces = before.state.bar_forces + part * (after.state.bar_forces - before.state.bar_forces)
        across = Tangent(np.zeros_like(x), 1.0, np.zeros_like(forces))
        return self._arrived(before, x, goal, forces, across, towards=before.tangent)

    def tangent(self, at: Linearized, before: Tangent) -> Tangent | None:
        """The tangent of the curve, of arc one, towards `before`."""
        nothing = (np.zeros(at.Z.shape[1]), np.zeros_like(at.forces), 1.0)
        found = bordered(at, nothing, before, self.move, self.span, at.neutral)
        return None if found is None else scaled(found.step, self.move, self.span, 1.0)

    def along(self, t: Tangent, dx: Array, ds: float) -> float:
        """Arc of a step by its part along a tangent."""
        return float(t.x @ dx) / self.move**2 + t.s * ds / self.span**2

    def _arrived(
        self,
        before: Point,
        x: Array,
        s: float,
        forces: Array,
        across: Tangent,
        bend: float = -np.inf,
        idle: Array | None = None,
        towards: Tangent | None = None,
    ) -> Point | None:
        """The point across a tangent from a place ahead of another point; its tangent is towards this or another."""
        found = self._corrected(x, s, forces, across, idle)
        if found is None:
            return None
        state, effort = found
        at = state.linearized
        tangent = self.tangent(at, towards or across)
        if tangent is None or self.along(across, tangent.x, tangent.s) < bend:
            return None
        return Point.of(state, at, tangent, effort, before.unstable)

    def _corrected(
        self, x: Array, s: float, forces: Array, across: Tangent, idle: Array | None
    ) -> tuple[StaticState, int] | None:
        """Correct by Newton's method across a tangent and idle motions; the state, and the steps until nearly there."""
        model, length = self.model, self.model.scale[0]
        best, first, effort = np.inf, 0.0, 0
        without: Array | None = None
        for used in range(CORRECTIONS + 1):
            at = Linearized(model, x, s, forces)
            size = float(np.abs(at.left).max(initial=0.0))
            off = float(np.abs(at.gaps).max(initial=0.0)) / length
            rough = 4 * round_off(model, x, s, forces)
            first = max(first, size)
            spent = used > 2 and size <= 1e3 * rough and off <= 1e-12 and size >= 0.3 * best
            if spent or (size <= rough and off <= 1e-14):
                least = linear_systems.least_forces(model, x, forces.copy())
                return StaticState(model, x.reshape(-1, 3).copy(), least, s, used), effort
            if not np.isfinite(size) or off > 1.0:
                return None
            best = min(best, size)
            if size > NEARLY * first or off > NEARLY:
                effort = used + 1
            if without is None:
                without = at.neutral if idle is None else np.hstack([at.neutral, idle])
            found = bordered(at, (-at.left, -at.gaps, 0.0), across, self.move, self.span, without)
            if found is None or float(np.abs(found.step.x).max(initial=0.0)) > length:
                return None
            x, s, forces = x + found.step.x, s + found.step.s, forces + found.step.forces
        return None


def bordered(
    at: Linearized, right: tuple[Array, Array, float], across: Tangent, move: float, span: float, without: Array
) -> Solution | None:
    """The step that takes away forces (q,) and gaps (R,), along a tangent by so much, and across motions (n, p)."""
    model = at.model
    Z, moved = at.Z, model.boundary.moved
    q, R, p = Z.shape[1], len(at.forces), without.shape[1]
    compliance = model.compliance + linear_systems.proximal(model) * (model.compliance == 0)
    by_parameter, stretched = at.by_parameter
    row = np.concatenate([Z.T @ across.x / move**2, np.zeros(R)])
    last = float(moved @ across.x) / move**2 + across.s / span**2
    # The row is as large as the stiffness, so that it keeps its place among the others.
    weight = model.scale[1] / max(float(np.abs(row).max(initial=0.0)), abs(last))
    neutral = np.asarray(Z.T @ without)
    # Columns of the motions, and of the parameter.
    columns = np.block([[neutral, by_parameter[:, None]], [np.zeros((R, p)), stretched[:, None]]])
    rows = np.block([[neutral.T, np.zeros((p, R))], [weight * row]])
    corner = np.diag([0.0] * p + [weight * last])
    matrix: Array | sparse.csc_array
    if at.small:
        H, C = at.free_hessian, at.free_slopes
        matrix = np.block([[np.block([[H, C.T], [C, -np.diag(compliance)]]), columns], [rows, corner]])
    else:
        saddle = linear_systems.saddle_matrix(at.free_hessian, at.free_slopes, compliance)
        beside, below, last_block = map(sparse.csr_array, (columns, rows, corner))
        matrix = sparse.csc_array(sparse.block_array([[saddle, beside], [below, last_block]]))
    found = linear_systems.solve(matrix, np.concatenate([right[0], right[1], np.zeros(p), [weight * right[2]]]))
    if found is None:
        return None
    ds = float(found[-1])
    held = np.abs(found[q + R : -1]).max(initial=0.0) / (np.abs(by_parameter).max(initial=0.0) * abs(ds) or 1.0)
    return Solution(Tangent(Z @ found[:q] + ds * moved, ds, found[q : q + R]), float(held))


def scaled(tangent: Tangent, move: float, span: float, sense: float) -> Tangent:
    """Return the tangent in the same direction, of arc one."""
    size = float(np.sqrt(tangent.x @ tangent.x / move**2 + (tangent.s / span) ** 2))
    return Tangent(sense * tangent.x / size, sense * tangent.s / size, sense * tangent.forces / size)


def zero(model: StaticModel) -> float:
    """[N/m] of an eigenvalue that counts as none."""
    elastic = model.compliance > 0
    return ZERO * model.scale[1] + ROUGH * float(np.max(1.0 / model.compliance[elastic], initial=0.0))


def _lengthening(model: StaticModel, x: Array, motion: Array) -> Array:
    """(M,): how strings lengthen in a motion (3N,)."""
    paths = model.structure.paths
    along = np.einsum("mk,mk->m", model.segments(x).directions, paths.spans(motion.reshape(-1, 3)))
    return np.asarray(paths.total(along))


LOCATED = 1e-10  # of the arc between two points, or of the change of an eigenvalue: how well a critical point is known
SOFT = 1e-3  # of the change of an eigenvalue: below it, motions may be left out where they do not matter
TOGETHER = 1e-6  # of it: critical points that are nearer count as one


class Kind(enum.Enum):
    """Kinds of points at which the stiffness stops being definite."""

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
    """Return whether the parameter turns back between two points of the same stability."""
    return before.tangent.s * after.tangent.s < 0 and (before.unstable - after.unstable) % 2 == 0


def crossings(walk: Walk, before: Point, after: Point) -> list[Crossing]:
    """Return the places between two points at which motions become unstable, or stable again."""
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
    """Find where an eigenvalue changes sign, and the arcs seen on both sides of it; new points are added to `seen`."""
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
