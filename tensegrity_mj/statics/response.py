"""Response along a path of equilibria: forces over displacements, and where strings become slack or taut."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.jsontext import plain, plain_values
from tensegrity_mj.statics.member_loads import MemberLoads, Use
from tensegrity_mj.statics.path import Path


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
