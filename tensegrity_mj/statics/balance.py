"""Distance of a structure from equilibrium at its start: one definition, for all that report it.

Of the forces on the nodes (strings, weights, a rod's half at either end, and all that acts there), axial forces of the
rods and reactions of supports and holds take away as much as they can. What is left, r (N, 3), is the least there is in
the sum of its squares: the part of the forces along motions that keep rods' lengths and supports. The unbalanced force
is the largest magnitude of it on a node,

    max_n ‖r_n‖₂        r = -Z Zᵀ (∇Π + Cᵀ N),   N: those that leave the least

which is zero in equilibrium, and the same in any system of coordinates. Elastic rods carry what their lengths say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.statics import linear_systems
from tensegrity_mj.statics.model import StaticModel, round_off

BALANCED = 1e-9  # of the largest force in a member or load: less than that is left in equilibrium


@dataclass(frozen=True, eq=False)
class Balance:
    """Forces on the nodes that neither rods nor supports can balance.

    Attributes:
        left: r (N, 3) [N].
        node: the name of the node with the largest of it.
        is_equilibrium: whether that is none, within round-off and `BALANCED` of the largest force.
    """

    left: Array
    node: str
    is_equilibrium: bool

    @property
    def unbalanced(self) -> float:
        """[N] its largest magnitude on a node."""
        return float(np.linalg.norm(self.left, axis=1).max(initial=0.0))

    def describe(self) -> str:
        """Return a description, as text."""
        size = f"{self.unbalanced:.5g} N"
        if self.is_equilibrium:
            return f"{size}, round-off: an equilibrium" if self.unbalanced > 0 else "none: an equilibrium"
        return f"{size} on node '{self.node}', the largest that neither rods nor supports can balance"


def balance(model: StaticModel) -> Balance:
    """Return the balance of a model at its start, without what the parameter of a path multiplies."""
    x, Z = model.start.ravel(), model.boundary.Z
    gradient = model.gradient(x, 0.0)
    forces = linear_systems.rod_forces(model, x, gradient)
    left = -(Z @ (Z.T @ (gradient + model.rod_pulls(x, forces)))).reshape(-1, 3)
    parts = (model.tensions(model.lengths(x)), forces, model.external(0.0), model.element_forces(x))
    largest = max(float(np.abs(part).max(initial=0.0)) for part in parts)
    sizes = np.linalg.norm(left, axis=1)
    threshold = max(BALANCED * largest, round_off(model, x, 0.0, forces))
    worst = model.structure.node_names[int(sizes.argmax())] if len(sizes) else ""
    return Balance(left, worst, bool(sizes.max(initial=0.0) <= threshold))


def unheld_gravity(scene: Scene) -> Array:
    """(3,) [m/s²]: the part of gravity along straight lines on which no support holds the structure; zero for none.

    Contact and water hold only where the structure touches them, and are left out.
    """
    gravity = np.array(scene.gravity)
    free = StaticModel.of(scene).boundary.straight_ways()
    falls = free @ (free.T @ gravity)
    return falls if np.linalg.norm(falls) > 1e-9 * np.linalg.norm(gravity) else np.zeros(3)
