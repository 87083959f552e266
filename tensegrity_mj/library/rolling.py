"""The six-bar robot rolls by a sequence of shapes: one string of its base shortened at a time, open loop.

It stands on a closed triangle, one of three strings (`six_bar`). Shortened, a string of it pulls the centre of mass
over an edge beside it: the robot tips onto the open triangle there, whose third corner swings down, and, shortened
further, over that one's other string onto the next closed triangle. Which string tips it over which edge follows from
the symmetry; `statics.standing.tipping` finds the fractions of the rest length at which it does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.fields import field, function_of, value
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.six_bar import icosahedron
from tensegrity_mj.model.events import ControlSpec
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure

Nodes = frozenset[int]  # of a triangle or an edge


@dataclass(frozen=True)
class Roll:
    """One step from a closed triangle over an open one to the next closed one; names of nodes in the structure's order.

    Attributes:
        base: that it begins on.
        string: a string of the base, which is shortened.
        through: the open triangle, over whose edge with the base it tips.
        lands: the triangle that it ends on.
        travel: (2,) [m] from the centre of one to that of the other, where a rigid body rolls.
    """

    base: tuple[str, ...]
    string: str
    through: tuple[str, ...]
    lands: tuple[str, ...]
    travel: tuple[float, float]


def rolls(structure: Structure, base: tuple[str, ...], heading: float, steps: int) -> list[Roll]:
    """The steps of a six-bar robot that keeps to a straight line as well as its triangles let it.

    Of the three triangles that it may land on it takes the one whose centre is farthest ahead of where it began, as a
    rigid body that rolls.

    Args:
        structure: as it stands on the base; the shape of `icosahedron`, in any size and place.
        base: names of a closed triangle.
        heading: direction in the xy plane [rad], from x to y.
        steps: how many.
    """
    from scipy.spatial import ConvexHull

    nodes, names = structure.positions, structure.node_names
    triangles = [frozenset(int(i) for i in face) for face in ConvexHull(nodes).simplices]
    strings = {frozenset(structure.node_index[name] for name in one.nodes): one.name for one in structure.strings}
    way = np.array([np.cos(heading), np.sin(heading), 0.0])
    side = np.array([-way[1], way[0], 0.0])
    now, found = frozenset(structure.node_index[name] for name in base), []
    start = _centre(nodes, now)

    def wander(choice: tuple[Nodes, Nodes, Nodes, Array]) -> float:
        gone = _centre(choice[3], choice[2]) - start
        return float(gone @ way - abs(gone @ side))

    for _ in range(steps):
        choices = []
        for edge in (now - {corner} for corner in now):
            through = next(one for one in triangles if edge < one and one != now)
            over = next(pair for pair in strings if pair < through and pair != edge)
            lands = next(one for one in triangles if over < one and one != through)
            turned = _rolled(_rolled(nodes, now, edge, through), through, over, lands)
            choices.append((edge, through, lands, turned))
        edge, through, lands, turned = max(choices, key=wander)
        gone = _centre(turned, lands) - _centre(nodes, now)
        groups = [tuple(names[i] for i in sorted(group)) for group in (now, through, lands)]
        string = strings[_pulled(structure, now, edge)]
        found.append(Roll(groups[0], string, groups[1], groups[2], (float(gone[0]), float(gone[1]))))
        nodes, now = turned, lands
    return found


@value("six_bar_roll", OptionError)
class SixBarRoll:
    """The six-bar robot of `icosahedron` rolls over its triangles, string after string.

    Each step shortens its string, holds it while the robot tips and comes to rest, lets it out again, and waits.

    Attributes:
        steps: from closed triangle to closed triangle.
        heading: direction of the way [rad], from x to y. Where it is 1.15, or a sixth of a turn more, it goes straight
            on, and six steps are one turn.
        fraction: fraction of the rest length, to which a string is shortened.
        move, pause: how long a string takes to be shortened, and to be let out, and how long it stands after each [s].
        prestress: force density over stiffness of the strings.
        friction: coefficient of friction of the floor.
        name: name of scene and structure.

    Raises:
        OptionError, StructureError, SceneError: for parameters that make no such scene.
    """

    steps: int = field(kinds.whole(1, 1000), default=6)
    heading: float = 1.15
    fraction: float = field(kinds.within(0.1, 1), default=0.35)
    move: float = field(kinds.positive("s"), default=0.5)
    pause: float = field(kinds.positive("s"), default=0.5)
    prestress: float = field(kinds.within(0, 0.9), default=0.1)
    friction: float = 0.6
    name: str = "six_bar_roll"

    def __call__(self) -> Scene:
        scene = icosahedron(prestress=self.prestress, friction=self.friction, name=self.name)
        steps = rolls(scene.structure, ("r1a", "r4a", "r6b"), self.heading, self.steps)
        ends = np.round(self.pause + (self.move + self.pause) * np.arange(2 * self.steps + 1), 9).tolist()
        moves = [
            [step.string, begin, round(begin + self.move, 9), fraction]
            for k, step in enumerate(steps)
            for begin, fraction in ((ends[2 * k], self.fraction), (ends[2 * k + 1], 1.0))
        ]
        return scene.with_(control=ControlSpec("program", {"moves": moves}), duration=ends[-1])


six_bar_roll = function_of(SixBarRoll)


def _pulled(structure: Structure, base: Nodes, edge: Nodes) -> Nodes:
    """The string of a closed triangle that tips it over an edge.

    The rods of its corners are along three axes. Of the edge's two corners it begins at the one whose axis follows that
    of the other, the axes in their order around.
    """
    axis = {node: int(np.flatnonzero((structure.rod_nodes == node).any(axis=1))[0]) // 2 for node in base}
    first, second = edge
    start = first if (axis[first] - axis[second]) % 3 == 1 else second
    return (base - edge) | {start}


def _centre(nodes: Array, triangle: Nodes) -> Array:
    return np.asarray(nodes[sorted(triangle)].mean(axis=0))


def _rolled(nodes: Array, base: Nodes, edge: Nodes, lands: Nodes) -> Array:
    """The nodes, turned about an edge of what is down until the next triangle is."""
    first, second = (nodes[i] for i in sorted(edge))
    (third,), (landing,) = nodes[sorted(base - edge)], nodes[sorted(lands - edge)]
    along = (second - first) / np.linalg.norm(second - first)
    out = np.cross(along, [0.0, 0.0, 1.0])
    out *= np.sign(out @ (first - third))
    arm = landing - first - ((landing - first) @ along) * along
    arm /= np.linalg.norm(arm)
    before, after = (np.array([along, across, np.cross(along, across)]) for across in (arm, out))
    return np.asarray(first + (nodes - first) @ before.T @ after)
