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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known, finite, positive, real_array, whole
from tensegrity_mj.basics.jsontext import plain, plain_values
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.model import RANK, StaticModel, round_off
from tensegrity_mj.statics.path_steps import Critical as Critical
from tensegrity_mj.statics.path_steps import Kind as Kind
from tensegrity_mj.statics.path_steps import Point, Tangent, Walk, bordered, crossings, hides, scaled, zero
from tensegrity_mj.statics.state import StaticState
from tensegrity_mj.statics.strength import MemberLoads, Use

STRAIGHT = float(np.sqrt(2.0))  # the arc of a straight path
EASY = 2  # corrections up to which the next step may grow
GROWTH = 1.7  # of a step after an easy one
SHORTEST = 1e-7  # of the first step: below it, the curve ends here
CORNER = 0.05  # of the first step: below it, a curve may turn a corner, where a string becomes slack or taut


class End(enum.Enum):
    """Reasons for which a path ends."""

    REACHED = "reached the end"
    CRITICAL = "stability was lost"
    LONG = "as long as allowed"
    LOST = "no equilibrium nearby"


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
        """Model whose equilibria the path follows."""
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
        rows = self._rows(nodes)
        return np.array([state.reactions[rows].sum(axis=0) for state in self.states])

    def reaction_rate(self, nodes: Sequence[str]) -> Array:
        """(P, 3) [N]: dF/ds of the sum of these nodes' reactions, as `reaction` has it, by the path's parameter s.

        Divided by the nodes' displacement at s = 1 [m], it is the tangent stiffness [N/m] (appendix C's beams). At a
        limit point it has a pole.
        """
        rows = self._rows(nodes)
        out = np.zeros((len(self.states), 3))
        for p, state in enumerate(self.states):
            change = _reaction_change(state, self.rates[p], float(self.parameter_rates[p]))
            with np.errstate(divide="ignore", invalid="ignore"):
                out[p] = change.reshape(-1, 3)[rows].sum(axis=0) / self.parameter_rates[p]
        return out

    def _rows(self, nodes: Sequence[str]) -> list[int]:
        index = self.model.structure.node_index
        names = (nodes,) if isinstance(nodes, str) else nodes
        for name in names:
            check_known("reaction", name, index, "node")
        return [index[name] for name in names]


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
        points: the path has at most so many after its start, about evenly spaced by arc, and also the two on
            either side of where a string becomes slack or taut. Steps are at most so long; where the curve bends they
            are shorter, and their points are left out of the path again (critical states stay in `criticals`).
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
    state = starting_state(start, loads, holds)
    model = state.model
    if not np.any(model.loads) and not np.any(model.boundary.moved):
        raise OptionError(
            "a path (follow, --path) increases only what further loads and moved holds give (loads, holds; --load, "
            "--hold NODE=X,Y,Z); the loads of the scene itself stay constant, and nothing else was given: give at "
            "least one"
        )
    if goal == state.parameter:
        raise OptionError(f"to = {to!r}: the start is there already, a path of no length; give another value")
    walk, first = begin(state, goal, direction)
    course = _Course(walk, first, count, branches=direction is not None)
    with bar(progress, f"following {model.scene.name}", unit="point") as shown:
        end = course.run(goal, limit * STRAIGHT, stop_at_critical, shown.update)
    if len(course.points) == 1:
        raise InfeasibleError(
            f"'{model.scene.name}': no equilibrium was found near the start; take more points, smaller loads or "
            "displacements, or a start that is stable"
        )
    return course.path(end)


class _Course:
    """The points of a path, as far as it has been followed."""

    def __init__(self, walk: Walk, first: Point, count: int, branches: bool) -> None:
        self.walk, self.count, self.branches = walk, count, branches
        self.points, self.arcs = [first], [0.0]
        self.criticals: list[Critical] = []

    def run(self, goal: float, longest: float, stop_at_critical: bool, show: Callable[[], object]) -> End:
        """Follow it to a value of the parameter, or as far as it goes."""
        first = step = STRAIGHT / self.count
        sense = 1.0 if goal > self.points[0].state.parameter else -1.0
        while self.arcs[-1] < longest:
            here, arc = self.points[-1], self.arcs[-1]
            ahead = self._ahead(here, step, first)
            if ahead is None:
                step *= 0.5
                if step < SHORTEST * first:
                    return End.LOST
                continue
            passed = (ahead.state.parameter - goal) * sense >= 0
            if passed:
                ahead = self.walk.at_parameter(here, ahead, goal) or ahead
            # A critical start counts on neither side.
            crossed = [] if self.branches and len(self.points) == 1 else crossings(self.walk, here, ahead)
            lost = [k for k, one in enumerate(crossed) if one.critical.unstable_after > one.critical.unstable_before]
            if stop_at_critical and lost:
                crossed = crossed[: lost[0] + 1]
                ahead = crossed[-1].point
            self.criticals += [one.critical for one in crossed]
            self.points.append(ahead)
            self.arcs.append(arc + step)
            show()
            if stop_at_critical and lost:
                return End.CRITICAL
            if passed:
                return End.REACHED
            # A path that has become long for its loads, as one that snaps through, goes on in longer steps.
            most = max(STRAIGHT, arc + step) / self.count
            step = min(most, step * (GROWTH if ahead.effort <= EASY else 1.0))
        return End.LONG

    def _ahead(self, here: Point, step: float, first: float) -> Point | None:
        ahead = self.walk.step(here, step)
        if ahead is None and step < CORNER * first:
            ahead = self.walk.corner(here, step)
        # A turn of the parameter without a change of stability hides two changes.
        return None if ahead is not None and step > CORNER * first and hides(here, ahead) else ahead

    def path(self, end: End) -> Path:
        """The points that are shown: as many as are wanted, and those next to a string's change."""
        slack = np.array([point.state.slack for point in self.points])
        shown = {0, len(self.points) - 1}
        if len(self.points) - 1 > self.count:
            arcs = np.array(self.arcs)
            # The nearest point to each of equal parts of the arc.
            parts = np.linspace(0.0, arcs[-1], self.count + 1)
            after = np.clip(np.searchsorted(arcs, parts), 1, len(arcs) - 1)
            shown |= set((after - (parts - arcs[after - 1] < arcs[after] - parts)).tolist())
            changed = np.flatnonzero(np.any(slack[1:] != slack[:-1], axis=1))
            shown |= {*changed.tolist(), *(changed + 1).tolist()}
        else:
            shown |= set(range(len(self.points)))
        points = [self.points[row] for row in sorted(shown)]
        return Path(
            states=tuple(point.state for point in points),
            rates=np.array([point.tangent.x for point in points]),
            parameter_rates=np.array([point.tangent.s for point in points]),
            unstable=np.array([point.unstable for point in points]),
            lowest=np.array([point.value(0) for point in points]),
            criticals=tuple(self.criticals),
            end=end,
        )


def _reaction_change(state: StaticState, dx: Array, ds: float) -> Array:
    """dF (3N,) of the reactions along a tangent."""
    model = state.model
    K, slopes = model.hessian(state.x, state.bar_forces), model.rod_slopes(state.x)
    moved = K @ dx - ds * model.loads.ravel()
    # The change of the rods' forces follows from the free coordinates, which stay in balance.
    Z = model.boundary.Z
    C = sparse.csr_array(slopes @ Z)
    elastic = model.compliance > 0
    change = np.zeros(len(state.bar_forces))
    change[elastic] = (slopes @ dx)[elastic] / model.compliance[elastic]
    rigid = np.flatnonzero(~elastic)
    if len(rigid):
        left = Z.T @ (moved + slopes.T @ change)
        change[rigid] = np.linalg.lstsq(C[rigid].T.toarray(), -left, rcond=RANK)[0]
    return moved + slopes.T @ change


LEAST = 1e-6  # of the mean member: less that nodes move by on a straight path counts as so much


def starting_state(
    start: StaticState | StaticModel | Scene | Structure, loads: ArrayLike | None, holds: Sequence[Hold] | None
) -> StaticState:
    """The equilibrium at the start of a path, of the problem that the path solves; arguments as in `follow`."""
    if not isinstance(start, StaticState):
        model = start if isinstance(start, StaticModel) else StaticModel.of(start)
        still = tuple(Hold(h.nodes, h.directions) for h in model.holds)
        found = find_equilibrium(model.with_(holds=still, loads=np.zeros_like(model.loads)), parameter=0.0)
        return starting_state(found, model.loads if loads is None else loads, model.holds if holds is None else holds)
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
    state = StaticState(model, start.nodes, start.bar_forces, 0.0, 0)
    left = model.gradient(state.x, 0.0) + model.rod_pulls(state.x, state.bar_forces)
    left = np.abs(model.boundary.Z @ (model.boundary.Z.T @ left))
    if state.residual > 1e4 * round_off(model, state.x, 0.0, state.bar_forces):
        raise InfeasibleError(
            f"'{model.scene.name}': the start is not in equilibrium under the holds given: {left.max():.3g} N are left "
            f"on node '{list(model.structure.nodes)[int(left.argmax()) // 3]}', which nothing holds any more; hold "
            "what the start holds, or find an equilibrium first"
        )
    return state


def begin(state: StaticState, goal: float, direction: ArrayLike | None) -> tuple[Walk, Point]:
    """The measures of arc, and the first point with its tangent."""
    model, span = state.model, abs(goal - state.parameter)
    sense = 1.0 if goal > state.parameter else -1.0
    way = None
    if direction is not None:
        way = real_array("direction", direction, (len(model.structure.nodes), 3), "", scalar=False).ravel()
        way = model.boundary.Z @ (model.boundary.Z.T @ way)
        if not np.any(way):
            raise OptionError("direction: it moves nothing but what supports and holds keep; give another")
    at = state.linearized
    nothing = Tangent(np.zeros_like(state.x), 1.0, np.zeros_like(state.bar_forces))
    first = Point.of(state, at, nothing)
    idle = first.modes[:, np.abs(first.values) <= zero(model)]  # the tangent goes across what nothing resists
    right = (np.zeros(model.boundary.Z.shape[1]), np.zeros_like(state.bar_forces), 1.0)
    found = bordered(at, right, nothing, 1.0, 1.0, np.hstack([at.neutral, idle]))
    pushed = found is None or found.pushed > 1e-6
    if pushed and way is None:
        raise InfeasibleError(
            f"'{model.scene.name}': the start gives way: its loads or holds push along a motion that nothing resists, "
            "of a mechanism or at a limit point; give it supports, tension or a smaller load, or a direction"
        )
    move = 0.0 if found is None or pushed else span * float(np.linalg.norm(found.step.x))
    # Rigid rods in a line hardly move before they buckle; nor does it say how far they do then.
    walk = Walk(model, max(move, model.scale[0] * (LEAST if way is None else 1.0)), span)
    if way is None:
        assert found is not None
        return walk, first._replace(tangent=scaled(found.step, walk.move, span, sense))
    return walk, first._replace(tangent=scaled(nothing._replace(x=way, s=0.0), walk.move, span, 1.0))


@dataclass(frozen=True, eq=False)
class Curve:
    """A force [N] over a displacement [m], (P,) each, along a path.

    Attributes:
        name: what is loaded or moved.
        displacement: of a loaded node along its load, or of what a hold moves along its way.
        force: the load, or the reaction of the moved nodes along their way.
        is_load: whether the force is given, and the displacement found.
    """

    name: str
    displacement: Array
    force: Array
    is_load: bool


@dataclass(frozen=True)
class SlackEvent:
    """A string that becomes slack, or taut again, between a point of a path and the one before it.

    Attributes:
        string: its name.
        point: the later of the two.
        parameter: where it does, by a straight line between the two.
        slack: whether it becomes slack.
    """

    string: str
    point: int
    parameter: float
    slack: bool


@dataclass(frozen=True, eq=False)
class Response:
    """A path and what it says.

    Attributes:
        path: the equilibria.
        curves: one a loaded node and one a hold that moves.
        slack_events: in order.
        members: forces and limits of all members, a row a point; its times are parameters.
    """

    path: Path
    curves: tuple[Curve, ...]
    slack_events: tuple[SlackEvent, ...]
    members: MemberLoads

    @classmethod
    def of(cls, path: Path) -> Response:
        """Make the response from a path."""
        lengths = np.array([state.rod_lengths for state in path.states])
        loads = MemberLoads(
            path.model.structure,
            path.rod_forces,
            lengths,
            path.tensions,
            path.parameters,
            path.states[-1].determinacy.chosen,
        )
        return cls(path, tuple(_curves(path)), tuple(_slack_events(path)), loads)

    @property
    def largest_parameter(self) -> float:
        """The largest that the path comes to: at a limit point, what the structure bears."""
        return float(self.path.parameters.max())

    @property
    def first_violation(self) -> Use | None:
        """The largest use at the first point where a member is beyond its limit; its `time` is the parameter."""
        return self.members.first_exceeded

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        path, first = self.path, plain(self.first_violation)
        return {
            "end": path.end.value,
            "points": len(path.states),
            "parameters": path.parameters.tolist(),
            "lowest_stiffness": path.lowest.tolist(),
            "unstable": path.unstable.tolist(),
            "largest_parameter": self.largest_parameter,
            **plain_values(path, "nodes", "rod_forces", "tensions"),
            "curves": [
                {
                    "name": curve.name,
                    "kind": "load" if curve.is_load else "displacement",
                    **plain_values(curve, "displacement", "force"),
                }
                for curve in self.curves
            ],
            "criticals": [
                plain_values(critical, "kind", "parameter", "mode", "unstable_before", "unstable_after")
                for critical in path.criticals
            ],
            "slack_events": plain(self.slack_events),
            "first_violation": first and {"parameter": first.pop("time"), **first},
        }


def _curves(path: Path) -> list[Curve]:
    model, s = path.model, path.parameters
    names = model.structure.node_names
    found = []
    for row in np.flatnonzero(np.any(model.loads, axis=1)):
        size = float(np.linalg.norm(model.loads[row]))
        moved = (path.nodes[:, row] - model.start[row]) @ (model.loads[row] / size)
        found.append(Curve(f"load on {names[row]}", moved, s * size, True))
    for hold in model.holds:
        way = np.array(hold.displacement)
        size = float(np.linalg.norm(way))
        if size > 0:
            force = path.reaction(hold.nodes) @ (way / size)
            found.append(Curve(f"{', '.join(hold.nodes)} moved", s * size, force, False))
    return found


def _slack_events(path: Path) -> list[SlackEvent]:
    model, s = path.model, path.parameters
    margin = np.array([state.lengths for state in path.states]) - model.rest_lengths
    slack = np.array([state.slack for state in path.states])
    found = []
    for point in range(1, len(slack)):
        for row in np.flatnonzero(slack[point] != slack[point - 1]):
            before, after = margin[point - 1, row], margin[point, row]
            part = before / (before - after) if before != after else 1.0
            there = float(s[point - 1] + part * (s[point] - s[point - 1]))
            found.append(SlackEvent(model.structure.strings[row].name, point, there, bool(slack[point, row])))
    return sorted(found, key=lambda event: event.point)
