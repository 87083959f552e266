"""Linear constraints on nodes: weighted sums of nodes that keep their place along a direction, or move as prescribed.

They are the rows of N P = D, direction by direction: what no support of one rod says. A rod held at two points, a
node on a line or a plane, the centre of some nodes over a point.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import direction, finite, mapping, number, printable_name, within
from tensegrity_mj.errors import StructureError
from tensegrity_mj.model.members import Rod, Vector

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene
    from tensegrity_mj.model.structure import Structure


WEIGHT = number("a finite number that is not zero (leave out a node that has no weight)", lambda x: x != 0)


@value("constraint {name!r}", StructureError)
class Constraint:
    """One coordinate that nodes keep: Σ_a w_a direction·n_a = value.

    A motion of that name (`Scene.motions`) moves it: the value changes by direction · d(t).

    Attributes:
        name: unique among the constraints.
        nodes: node name -> its weight w_a; one node of weight 1 is held along the direction itself.
        direction: of any length but zero, in the world frame.
        value: [m] times the direction's length; None for its value at the reference nodes.
    """

    name: str = field(printable_name())
    nodes: Mapping[str, float] = field(mapping(printable_name(), WEIGHT, "a table of node name = weight", "node", 1))
    direction: Vector = field(direction())
    value: float | None = field(finite("m"), default=None, none="None for what the nodes give")

    __hash__ = None  # type: ignore[assignment]

    def __attrs_post_init__(self) -> None:
        if not self.nodes:
            raise refused(self, "nodes = {}; give at least one and its weight, as {'n1': 1.0}")

    @classmethod
    def along(cls, name: str, rod: Rod, at: float, direction: ArrayLike, value: float | None = None) -> Constraint:
        """Constrain the point (1 - at) n_i + at n_j of a rod, which may so be held at more points than its support's.

        Raises:
            StructureError: for a place that is not within [0, 1], or no direction.
        """
        sigma = checked(f"constraint '{name}': at", at, within(0, 1), StructureError)
        weights = {node: weight for node, weight in zip(rod.nodes, (1.0 - sigma, sigma), strict=True) if weight}
        return cls(name, weights, direction, value)  # type: ignore[arg-type]

    @property
    def unit(self) -> Array:
        """The direction (3,) at length one."""
        return np.array(self.direction) / np.linalg.norm(self.direction)


def constraint_rows(structure: Structure) -> Array:
    """(C, 3N): w_a e of each constraint, e its direction at length one, over the coordinates of the nodes in a row."""
    rows = np.zeros((len(structure.constraints), len(structure.nodes), 3))
    for row, one in zip(rows, structure.constraints, strict=True):
        for node, weight in one.nodes.items():
            row[structure.node_index[node]] = weight * one.unit
    return rows.reshape(len(rows), 3 * len(structure.nodes))


def constraint_values(scene: Scene, time: float) -> Array:
    """(3, C): what the rows of `constraint_rows` give at a time [s], and its first and second derivative [m, s]."""
    structure = scene.structure
    values = np.zeros((3, len(structure.constraints)))
    values[0] = structure.constraint_rows @ structure.positions.ravel()
    places = {one.name: k for k, one in enumerate(structure.constraints)}
    for motion in scene.motions:
        if motion.support in places:
            k = places[motion.support]
            values[:, k] += motion.at(time) @ structure.constraints[k].unit
    return values


def check_constraints(structure: Structure, tolerance: float) -> None:
    """Raise StructureError where a constraint fits neither the nodes, to within a tolerance [m], nor the others."""
    free = set(structure.nodes) - set(structure.fixed_nodes)
    for one in structure.constraints:
        for node in one.nodes:
            if node not in free:
                raise StructureError(
                    f"constraint '{one.name}': fixed node '{node}' has a place already: leave it out, and have its "
                    "weight times its place in the value, which is what the other nodes give unless it is given"
                )
        if one.value is not None:
            size = float(np.linalg.norm(one.direction))
            found = sum(w * np.dot(one.direction, structure.nodes[node]) for node, w in one.nodes.items())
            if not abs(found - one.value) <= tolerance * size * sum(map(abs, one.nodes.values())):
                raise StructureError(
                    f"constraint '{one.name}': its nodes give {found:.12g} at the reference, but value = "
                    f"{one.value:.12g}: move the nodes there, or leave the value out to take it from them"
                )
    rows = structure.constraint_rows

    def repeats(count: int) -> bool:
        return int(np.linalg.matrix_rank(rows[:count], tol=1e-9 * float(np.abs(rows).max()))) < count

    if len(rows) and repeats(len(rows)):
        first = next(count for count in range(1, len(rows) + 1) if repeats(count))
        raise StructureError(
            f"constraint '{structure.constraints[first - 1].name}' repeats what those before it hold: leave it out"
        )
