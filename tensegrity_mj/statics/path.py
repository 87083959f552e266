"""Static response to growing loads and prescribed displacements, through limit points, until something buckles.

The equilibria of a model form a curve over its parameter s, which multiplies further loads and what holds are moved by.
It is followed by pseudo-arclength: a step along the tangent, then Newton's method across it, so that the parameter may
turn back. Arc is measured so that nodes and parameter count alike at the start:

    (da)² = ‖dx‖² / ‖x'(0)‖² + (ds)²        from s = 0 to 1 at first about √2

At every point the stiffness at constant parameter is looked at: where it stops being positive definite, the structure
buckles under loads that are set, or snaps under displacements that are set.
"""

from __future__ import annotations

import enum
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from tensegrity_mj.checks import finite, positive, real_array
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.families.arguments import whole
from tensegrity_mj.scene import Scene
from tensegrity_mj.statics import linear_systems
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import find_equilibrium, round_off
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.statics.state import StaticState
from tensegrity_mj.structure import Structure

Array = NDArray[np.float64]

CORRECTIONS = 8  # of Newton's method, before a step is halved
LEAST = 1e-6  # of the mean member: less that nodes move by on a straight path counts as so much
EASY = 4  # corrections up to which the next step may grow
SHORTEST = 1e-7  # of the first step: below it, the curve ends here
SHARPEST = 0.8  # cosine of the angle between two tangents, below which a step is halved
CORNER = 0.05  # of the first step: below it, a curve may turn a corner, where a string becomes slack or taut
EIGENVALUES = 4  # at every point, and as many more as are negative
ZERO = 1e-10  # of the stiffest string, and
ROUGH = 1e-13  # of the stiffest rod: an eigenvalue of less counts as none
LOCATED = 1e-10  # of the arc between two points, or of the change of an eigenvalue: how well a critical point is known
SOFT = 1e-3  # of the change of an eigenvalue: below it, motions may be left out where they do not matter
TOGETHER = 1e-6  # of it: critical points that are nearer count as one


class Kind(enum.Enum):
    """What happens where the stiffness stops being definite."""

    LIMIT = "limit point"  # the parameter turns back
    BIFURCATION = "bifurcation"  # another curve of equilibria crosses
    SLACK = "slack string"  # the stiffness jumps, as a string becomes slack or taut


class End(enum.Enum):
    """Why a path ends."""

    REACHED = "reached the end"
    CRITICAL = "stability was lost"
    LONG = "as long as allowed"
    LOST = "no equilibrium nearby"


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


@dataclass(frozen=True, eq=False)
class Path:
    """A curve of equilibria; P points.

    Attributes:
        states: the points.
        rates: (P, n) x'(a) at the points, by arc.
        parameter_rates: (P,) s'(a).
        unstable: (P,) how many independent motions are unstable at constant parameter.
        lowest: (P,) [N/m] lowest eigenvalue of the stiffness at constant parameter.
        criticals: where the stiffness stops or begins being positive definite, in order.
        end: why the path ends.
    """

    states: tuple[StaticState, ...]
    rates: Array
    parameter_rates: Array
    unstable: NDArray[np.int64]
    lowest: Array
    criticals: tuple[Critical, ...]
    end: End

    @property
    def model(self) -> StaticModel:
        """What was solved."""
        return self.states[0].model

    @cached_property
    def parameters(self) -> Array:
        """s (P,)."""
        return np.array([state.parameter for state in self.states])

    @cached_property
    def nodes(self) -> Array:
        """(P, N, 3) [m]."""
        return np.array([state.nodes for state in self.states])

    @cached_property
    def rod_forces(self) -> Array:
        """(P, R) [N]."""
        return np.array([state.rod_forces for state in self.states])

    @cached_property
    def tensions(self) -> Array:
        """(P, M) [N]."""
        return np.array([state.tensions for state in self.states])

    def reaction(self, nodes: Sequence[str]) -> Array:
        """(P, 3) [N]: what supports and holds together push these nodes with."""
        index = self.model.structure.node_index
        rows = [_row(index, name) for name in ((nodes,) if isinstance(nodes, str) else nodes)]
        return np.array([state.reactions[rows].sum(axis=0) for state in self.states])

    def reaction_rate(self, nodes: Sequence[str]) -> Array:
        """(P, 3) [N]: dF/ds of these nodes' reaction: divided by the displacement at s = 1, the tangent stiffness.

        At a limit point it has a pole.
        """
        index = self.model.structure.node_index
        rows = [_row(index, name) for name in ((nodes,) if isinstance(nodes, str) else nodes)]
        out = np.zeros((len(self.states), 3))
        for p, state in enumerate(self.states):
            change = _reaction_change(state, self.rates[p], float(self.parameter_rates[p]))
            with np.errstate(divide="ignore", invalid="ignore"):
                out[p] = change.reshape(-1, 3)[rows].sum(axis=0) / self.parameter_rates[p]
        return out

    @property
    def first_slack(self) -> tuple[int, str] | None:
        """The first point with a slack string that was taut at the start, and the string; or None."""
        taut = ~self.states[0].slack
        for p, state in enumerate(self.states):
            lost = np.flatnonzero(taut & state.slack)
            if len(lost):
                return p, self.model.structure.strings[int(lost[0])].name
        return None


class _Tangent(NamedTuple):
    x: Array  # (n,)
    s: float
    forces: Array  # (R,)


def follow(
    start: StaticState | StaticModel | Scene | Structure,
    *,
    loads: ArrayLike | None = None,
    holds: Sequence[Hold] | None = None,
    to: float = 1.0,
    points: int = 100,
    longest: float = 3.0,
    direction: ArrayLike | None = None,
    stop_at_critical: bool = False,
    progress: bool = False,
) -> Path:
    """The curve of equilibria from a start, as loads grow or holds move.

        path = follow(state, holds=[Hold(base), Hold(top, displacement=(0.0, 0.0, -0.1))])
        buckled = follow(path.criticals[0].state, direction=path.criticals[0].mode)

    Args:
        start: a state, whose own path goes on from its parameter; with loads or holds given, theirs begins there at
            s = 0, and what was applied so far stays. Or a model, scene or structure, whose equilibrium at s = 0 is
            looked for first.
        loads: (N, 3) [N] that s multiplies; none by default, or those of the model.
        holds: boundary conditions, whose displacements s multiplies, counted from the start's nodes. They take the
            place of the model's holds, which by default stay: where they are, if `loads` are given to a state.
        to: last value of s.
        points: about how many on a straight path. Steps are shorter where the curve bends.
        longest: the path ends after so many times the arc of a straight one.
        direction: (N, 3) which way to go at first, in place of the tangent: a critical state's `mode` leads on to the
            branch that begins there, and -`mode` to its other half.
        stop_at_critical: end where stability is first lost; that state is the last.
        progress: show a bar on stderr.

    Raises:
        InfeasibleError: where there is no equilibrium at the start, or no path leads on from it.
        OptionError: for arguments that do not fit, and where nothing depends on the parameter.
    """
    goal, count, limit = finite("to", to), whole("points", points, 2), positive("longest", longest)
    state = _start(start, loads, holds)
    model = state.model
    if not np.any(model.loads) and not np.any(model.boundary.moved):
        raise OptionError("follow: nothing depends on the parameter; give loads, or holds with a displacement")
    if goal == state.parameter:
        raise OptionError(f"to = {to!r}: the start is there already, a path of no length; give another value")
    sense = 1.0 if goal > state.parameter else -1.0
    walk, first = _begin(state, goal, direction)
    full = float(np.sqrt(2.0)) / count
    step, arc, end = full, 0.0, End.LONG
    found: list[_Point] = [first]
    criticals: list[Critical] = []
    bar = _bar(progress, model.scene.name)
    try:
        while arc < limit * np.sqrt(2.0):
            here = found[-1]
            ahead = walk.step(here, step)
            if ahead is None and step < CORNER * full:
                ahead = walk.corner(here, step)
            # A turn of the parameter without a change of stability hides two changes.
            if ahead is None or (step > CORNER * full and walk.hides(here, ahead)):
                step *= 0.5
                if step < SHORTEST * full:
                    end = End.LOST
                    break
                continue
            passed = (ahead.state.parameter - goal) * sense >= 0
            if passed:
                ahead = walk.at_parameter(here, ahead, goal) or ahead
            arc += step
            # A critical start counts on neither side.
            crossed = walk.criticals(here, ahead) if len(found) > 1 or direction is None else []
            lost = [k for k, one in enumerate(crossed) if one.critical.unstable_after > one.critical.unstable_before]
            if stop_at_critical and lost:
                crossed, end = crossed[: lost[0] + 1], End.CRITICAL
                ahead = crossed[-1].point
            criticals += [one.critical for one in crossed]
            found.append(ahead)
            if bar is not None:
                bar.update(1)
            if end is End.CRITICAL:
                break
            if passed:
                end = End.REACHED
                break
            step = min(full, step * (1.7 if ahead.state.iterations <= EASY else 1.0))
    finally:
        if bar is not None:
            bar.close()
    if len(found) == 1:
        raise InfeasibleError(
            f"'{model.scene.name}': no equilibrium was found near the start; take more points, smaller loads or "
            "displacements, or a start that is stable"
        )
    return Path(
        states=tuple(point.state for point in found),
        rates=np.array([point.tangent.x for point in found]),
        parameter_rates=np.array([point.tangent.s for point in found]),
        unstable=np.array([point.unstable for point in found]),
        lowest=np.array([point.value(0) for point in found]),
        criticals=tuple(criticals),
        end=end,
    )


class _Point(NamedTuple):
    state: StaticState
    tangent: _Tangent
    values: Array  # lowest eigenvalues, all that are negative among them
    modes: Array  # (n, of them)

    @classmethod
    def of(cls, state: StaticState, tangent: _Tangent, expected: int = 0) -> _Point:
        count = EIGENVALUES + expected
        while True:
            values, modes = state.softest(count)
            if len(values) < count or values[-1] >= -_zero(state.model):
                return cls(state, tangent, values, modes)
            count *= 2

    @property
    def unstable(self) -> int:
        return int(np.sum(self.values < -_zero(self.state.model)))

    def value(self, which: int) -> float:
        values = self.values if which < len(self.values) else self.state.softest(which + 1)[0]
        return float(values[which]) if which < len(values) else np.inf


class _Crossing(NamedTuple):
    critical: Critical
    point: _Point


class _Walk:
    """Steps along a curve; arc is measured by a move [m] and a span of the parameter."""

    def __init__(self, model: StaticModel, move: float, span: float) -> None:
        self.model, self.move, self.span = model, move, span

    def step(self, at: _Point, arc: float, *, bend: float = SHARPEST, idle: Array | None = None) -> _Point | None:
        """The point so far ahead, or None where it is not found or the curve bends too much."""
        t = at.tangent
        ahead = self._correct(
            at.state.x + arc * t.x, at.state.parameter + arc * t.s, at.state.rod_forces + arc * t.forces, t, idle
        )
        if ahead is None:
            return None
        tangent = _tangent(self.model, ahead.x, ahead.parameter, ahead.rod_forces, t, self.move, self.span)
        if tangent is None or self._along(t, tangent.x, tangent.s) < bend:
            return None
        return _Point.of(ahead, tangent, at.unstable)

    def corner(self, at: _Point, arc: float) -> _Point | None:
        """The point so far ahead, around a corner: where strings that the tangent slackens, or pulls taut, are so."""
        model, t = self.model, at.tangent
        x, s, forces = at.state.x + arc * t.x, at.state.parameter + arc * t.s, at.state.rod_forces + arc * t.forces
        slack = model.tensions(model.strings(x).lengths) <= 0
        changed = np.flatnonzero(slack != at.state.slack)
        if not len(changed):
            return None
        tangent = _tangent(model, x, s, forces, t, self.move, self.span)
        if tangent is None:
            return None
        # Of the two ways along it the one on which these strings go on to lengthen, or shorten, as they did.
        lengthened = _lengthening(model, x, tangent.x)[changed] @ _lengthening(model, x, t.x)[changed]
        if lengthened < 0:
            tangent = _Tangent(-tangent.x, -tangent.s, -tangent.forces)
        there = self._correct(x, s, forces, tangent)
        if there is None or np.any(there.slack != slack):
            return None
        tangent = _tangent(model, there.x, there.parameter, there.rod_forces, tangent, self.move, self.span)
        return None if tangent is None else _Point.of(there, tangent, at.unstable)

    def at_parameter(self, before: _Point, after: _Point, goal: float) -> _Point | None:
        """The point at a value of the parameter between two points."""
        part = (goal - before.state.parameter) / (after.state.parameter - before.state.parameter)
        x = before.state.x + part * (after.state.x - before.state.x)
        forces = before.state.rod_forces + part * (after.state.rod_forces - before.state.rod_forces)
        level = _Tangent(np.zeros_like(x), 1.0, np.zeros_like(forces))
        found = self._correct(x, goal, forces, level)
        if found is None:
            return None
        tangent = _tangent(self.model, found.x, goal, found.rod_forces, before.tangent, self.move, self.span)
        return None if tangent is None else _Point.of(found, tangent, before.unstable)

    def hides(self, before: _Point, after: _Point) -> bool:
        """Whether the parameter turns back between two points of the same stability."""
        return before.tangent.s * after.tangent.s < 0 and (before.unstable - after.unstable) % 2 == 0

    def criticals(self, before: _Point, after: _Point) -> list[_Crossing]:
        """Where between two points motions become unstable, or stable again."""
        fewer, more = sorted((before.unstable, after.unstable))
        if fewer == more:
            return []
        whole_arc = self._between(before, after)
        seen = {0.0: before, whole_arc: after}
        places = sorted((*self._enclosed(seen, which), which) for which in range(fewer, more))
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
            out.append(self._crossing(seen[a], seen[b], steep, which, after.unstable == more, group is flattest))
        return out

    def _enclosed(self, seen: dict[float, _Point], which: int) -> tuple[float, float, float]:
        """Where an eigenvalue changes sign, and the arcs seen on both sides of it; points looked at are added."""
        from scipy.optimize import brentq

        before, after = seen[min(seen)], seen[max(seen)]
        # Where an end is as good as critical, and has no sign of its own, it counts as `unstable` says.
        shift = 0.0 if before.value(which) * after.value(which) < 0 else _zero(self.model)

        scale = abs(before.value(which) - after.value(which))

        def value(arc: float) -> float:
            if arc not in seen:
                point = self.step(before, arc, bend=-np.inf)
                if point is None:
                    # Next to a bifurcation round-off leads off the curve, along motions that hardly anything resists.
                    near = min(seen.values(), key=lambda other: abs(other.value(which)))
                    soft = near.modes[:, np.abs(near.values) < SOFT * scale]
                    point = self.step(before, arc, bend=-np.inf, idle=soft)
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

    def _crossing(
        self, low: _Point, high: _Point, steep: float, which: list[int], rising: bool, turns: bool
    ) -> _Crossing:
        fewer, more = min(which), max(which) + 1
        jump = min(abs(low.value(fewer)), abs(high.value(fewer))) > steep
        changed = bool(np.any(low.state.slack != high.state.slack))
        kind = Kind.SLACK if jump and changed else Kind.LIMIT if turns else Kind.BIFURCATION
        there = min(low, high, key=(lambda p: p.value(fewer)) if jump else (lambda p: abs(p.value(fewer))))
        modes = there.state.softest(more)[1][:, fewer:].T
        largest = np.take_along_axis(modes, np.abs(modes).argmax(axis=1)[:, None], axis=1)
        modes = (modes / largest).reshape(len(modes), -1, 3)
        counts = (fewer, more) if rising else (more, fewer)
        return _Crossing(Critical(kind, there.state, modes, *counts), there)

    def _between(self, before: _Point, after: _Point) -> float:
        dx, ds = after.state.x - before.state.x, after.state.parameter - before.state.parameter
        return self._along(before.tangent, dx, ds)

    def _along(self, t: _Tangent, dx: Array, ds: float) -> float:
        return float(t.x @ dx) / self.move**2 + t.s * ds / self.span**2

    def _correct(
        self, x: Array, s: float, forces: Array, across: _Tangent, idle: Array | None = None
    ) -> StaticState | None:
        """Newton's method across a tangent, and across idle motions."""
        model, Z = self.model, self.model.boundary.Z
        best = np.inf
        for used in range(CORRECTIONS + 1):
            slopes = model.rod_slopes(x)
            left = Z.T @ (model.gradient(x, s) + slopes.T @ forces)
            lengths = model.rods(x).lengths - model.rod_lengths - model.compliance * forces
            size = float(np.abs(left).max(initial=0.0))
            off = float(np.abs(lengths).max(initial=0.0)) / model.scale[0]
            rough = 4 * round_off(model, x, s)
            spent = used > 2 and size <= 1e3 * rough and off <= 1e-12 and size >= 0.3 * best
            if spent or (size <= rough and off <= 1e-14):
                return StaticState(model, x.reshape(-1, 3).copy(), forces.copy(), s, used)
            if not np.isfinite(size) or off > 1.0:
                return None
            best = min(best, size)
            found = _bordered(model, x, s, forces, (-left, -lengths, 0.0), across, self.move, self.span, idle)
            if found is None or float(np.abs(found.step.x).max(initial=0.0)) > model.scale[0]:
                return None
            x, s, forces = x + found.step.x, s + found.step.s, forces + found.step.forces
        return None


def _begin(state: StaticState, goal: float, direction: ArrayLike | None) -> tuple[_Walk, _Point]:
    """The measures of arc, and the first point with its tangent."""
    model, span = state.model, abs(goal - state.parameter)
    sense = 1.0 if goal > state.parameter else -1.0
    way = None
    if direction is not None:
        way = real_array("direction", direction, (len(model.structure.nodes), 3), "", scalar=False).ravel()
        way = model.boundary.Z @ (model.boundary.Z.T @ way)
        if not np.any(way):
            raise OptionError("direction: it moves nothing but what supports and holds keep; give another")
    nothing = _Tangent(np.zeros_like(state.x), 1.0, np.zeros_like(state.rod_forces))
    first = _Point.of(state, nothing)
    idle = first.modes[:, np.abs(first.values) <= _zero(model)]  # the tangent goes across what nothing resists
    right = (np.zeros(model.boundary.Z.shape[1]), np.zeros_like(state.rod_forces), 1.0)
    found = _bordered(model, state.x, state.parameter, state.rod_forces, right, nothing, 1.0, 1.0, idle)
    pushed = found is None or found.pushed > 1e-6
    if pushed and way is None:
        raise InfeasibleError(
            f"'{model.scene.name}': the start gives way: its loads or holds push along a motion that nothing resists, "
            "of a mechanism or at a limit point; give it supports, tension or a smaller load, or a direction"
        )
    move = 0.0 if found is None or pushed else span * float(np.linalg.norm(found.step.x))
    # Rigid rods in a line hardly move before they buckle; nor does it say how far they do then.
    walk = _Walk(model, max(move, model.scale[0] * (LEAST if way is None else 1.0)), span)
    if way is None:
        assert found is not None
        return walk, first._replace(tangent=_scaled(found.step, walk.move, span, sense))
    return walk, first._replace(tangent=_scaled(nothing._replace(x=way, s=0.0), walk.move, span, 1.0))


class _Solution(NamedTuple):
    step: _Tangent
    pushed: float  # force by the parameter along the motions that were left out, as a part of all of it


def _bordered(
    model: StaticModel,
    x: Array,
    s: float,
    forces: Array,
    right: tuple[Array, Array, float],
    across: _Tangent,
    move: float,
    span: float,
    idle: Array | None = None,
) -> _Solution | None:
    """The step that takes away forces (q,) and gaps (R,), and goes along a tangent by so much, across idle motions."""
    Z, moved = model.boundary.Z, model.boundary.moved
    K, slopes = model.hessian(x, forces), model.rod_slopes(x)
    C = sparse.csr_array(slopes @ Z)
    q, R = Z.shape[1], C.shape[0]
    compliance = model.compliance + linear_systems.proximal(model) * (model.compliance == 0)
    by_parameter = np.asarray(Z.T @ (K @ moved - model.loads.ravel()))
    without = model.neutral_motions(x, s, forces)
    if idle is not None:
        without = np.hstack([without, idle])
    neutral = sparse.csr_array((Z.T @ without).T)
    p = neutral.shape[0]
    row = np.concatenate([Z.T @ across.x / move**2, np.zeros(R)])
    last = float(moved @ across.x) / move**2 + across.s / span**2
    # The row is as large as the stiffness, so that it keeps its place among the others.
    weight = model.scale[1] / max(float(np.abs(row).max(initial=0.0)), abs(last))
    saddle = linear_systems.saddle_matrix(sparse.csr_array(Z.T @ K @ Z), C, compliance)
    columns = sparse.csr_array(sparse.vstack([neutral.T, sparse.csr_array((R, p))]))
    with_s = np.concatenate([by_parameter, slopes @ moved])
    matrix = sparse.csc_array(
        sparse.block_array(
            [
                [saddle, columns, sparse.csr_array(with_s[:, None])],
                [columns.T, None, sparse.csr_array((p, 1))],
                [sparse.csr_array(weight * row[None]), sparse.csr_array((1, p)), sparse.csr_array([[weight * last]])],
            ]
        )
    )
    found = linear_systems.solve(matrix, np.concatenate([right[0], right[1], np.zeros(p), [weight * right[2]]]))
    if found is None:
        return None
    ds = float(found[-1])
    held = np.abs(found[q + R : -1]).max(initial=0.0) / (np.abs(by_parameter).max(initial=0.0) * abs(ds) or 1.0)
    return _Solution(_Tangent(Z @ found[:q] + ds * moved, ds, found[q : q + R]), float(held))


def _tangent(
    model: StaticModel, x: Array, s: float, forces: Array, before: _Tangent, move: float, span: float
) -> _Tangent | None:
    """The tangent of the curve, of arc one, towards `before`."""
    right = (np.zeros(model.boundary.Z.shape[1]), np.zeros_like(forces), 1.0)
    found = _bordered(model, x, s, forces, right, before, move, span)
    return None if found is None else _scaled(found.step, move, span, 1.0)


def _scaled(tangent: _Tangent, move: float, span: float, sense: float) -> _Tangent:
    """The same direction, of arc one."""
    size = float(np.sqrt(tangent.x @ tangent.x / move**2 + (tangent.s / span) ** 2))
    return _Tangent(sense * tangent.x / size, sense * tangent.s / size, sense * tangent.forces / size)


def _zero(model: StaticModel) -> float:
    """[N/m] of an eigenvalue that counts as none."""
    elastic = model.compliance > 0
    return ZERO * model.scale[1] + ROUGH * float(np.max(1.0 / model.compliance[elastic], initial=0.0))


def _lengthening(model: StaticModel, x: Array, motion: Array) -> Array:
    """(M,): how strings lengthen in a motion (3N,)."""
    i, j = model.structure.string_nodes.T
    moved = motion.reshape(-1, 3)
    return np.einsum("mk,mk->m", model.strings(x).directions, moved[j] - moved[i])


def _reaction_change(state: StaticState, dx: Array, ds: float) -> Array:
    """dF (3N,) of the reactions along a tangent."""
    model = state.model
    K, slopes = model.hessian(state.x, state.rod_forces), model.rod_slopes(state.x)
    moved = K @ dx - ds * model.loads.ravel()
    # What the rods' forces change by follows from the free coordinates, which stay in balance.
    Z = model.boundary.Z
    C = sparse.csr_array(slopes @ Z)
    elastic = model.compliance > 0
    change = np.zeros(len(state.rod_forces))
    change[elastic] = (slopes @ dx)[elastic] / model.compliance[elastic]
    rigid = np.flatnonzero(~elastic)
    if len(rigid):
        left = Z.T @ (moved + slopes.T @ change)
        change[rigid] = np.linalg.lstsq(C[rigid].T.toarray(), -left, rcond=linear_systems.RANK)[0]
    return moved + slopes.T @ change


def _start(
    start: StaticState | StaticModel | Scene | Structure, loads: ArrayLike | None, holds: Sequence[Hold] | None
) -> StaticState:
    if not isinstance(start, StaticState):
        model = start if isinstance(start, StaticModel) else StaticModel.of(start)
        still = tuple(Hold(h.nodes, h.directions) for h in model.holds)
        found = find_equilibrium(model.with_(holds=still, loads=np.zeros_like(model.loads)), parameter=0.0)
        return _start(found, model.loads if loads is None else loads, model.holds if holds is None else holds)
    if loads is None and holds is None:
        return start
    if isinstance(holds, Hold):
        holds = (holds,)
    model, shape = start.model, start.nodes.shape
    model = model.with_(
        start=np.array(start.nodes),
        forces=model.forces + start.parameter * model.loads,  # what has been applied so far stays
        loads=np.zeros(shape) if loads is None else np.array(real_array("loads", loads, shape, "N", scalar=False)),
        holds=tuple(Hold(h.nodes, h.directions) for h in model.holds) if holds is None else tuple(holds),
    )
    model.boundary  # noqa: B018  its errors belong here
    state = StaticState(model, start.nodes, start.rod_forces, 0.0, 0)
    left = model.gradient(state.x, 0.0) + model.rod_slopes(state.x).T @ state.rod_forces
    left = np.abs(model.boundary.Z @ (model.boundary.Z.T @ left))
    if state.residual > 1e4 * round_off(model, state.x, 0.0):
        raise InfeasibleError(
            f"'{model.scene.name}': the start is not in equilibrium under the holds given: {left.max():.3g} N are left "
            f"on node '{list(model.structure.nodes)[int(left.argmax()) // 3]}', which nothing holds any more; hold "
            "what the start holds, or find an equilibrium first"
        )
    return state


def _row(index: dict[str, int], name: str) -> int:
    if name not in index:
        raise OptionError(f"there is no node '{name}'")
    return index[name]


def _bar(progress: bool, name: str):  # type: ignore[no-untyped-def]
    if not progress:
        return None
    from tqdm import tqdm

    return tqdm(desc=f"following {name}", unit="point", file=sys.stderr, disable=None)
