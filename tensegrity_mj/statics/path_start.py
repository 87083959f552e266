"""Where a path of equilibria begins: its first state, the measures of its arc, and its first tangent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.checks import real_array
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.statics.boundary import Hold
from tensegrity_mj.statics.equilibrium import find_equilibrium
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.statics.path_steps import Point, Tangent, Walk, bordered, scaled, zero
from tensegrity_mj.statics.rounding import round_off
from tensegrity_mj.statics.state import StaticState

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
