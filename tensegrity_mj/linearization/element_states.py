"""The states of elements as variables of a linear model, of which no engine knows.

An engine is given the scene with elements that act as those do at the states of the moment. How the states change is
what the elements themselves say.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.linearization.differences import central
from tensegrity_mj.model.elements.element import Element, acted, rated, split_states, states_at_start
from tensegrity_mj.model.scene import Scene

STEP = 1e-5  # of a state, and of 1 in its unit where it is smaller: of twelve differences, 6e-5 are the outermost


@dataclass(frozen=True, eq=False)
class _AtState(Element):
    """Element that acts at a state which others change."""

    element: Element
    state: Array

    def act(self, scene: Scene, time: float, nodes: Array, velocities: Array) -> Array:
        """See `Element`."""
        return acted(self.element, scene, time, nodes, velocities, self.state)


class ElementStates:
    """The states of a scene's elements (S,).

    Attributes:
        start: those about which the model is.
        scene: the same to an engine, whose elements have no states.
    """

    def __init__(self, scene: Scene) -> None:
        self.start = states_at_start(scene.elements, scene)
        self._now, self._elements = self.start.copy(), scene.elements
        pairs = zip(scene.elements, split_states(scene.elements, scene, self._now), strict=True)
        self.scene = scene
        if len(self.start):
            self.scene = scene.with_(elements=[_AtState(element, *own) if own else element for element, own in pairs])

    def become(self, states: Array) -> None:
        """Have the elements of `scene` act at these states (S,)."""
        self._now[:] = states

    def rates(self, time: float, nodes: Array, velocities: Array) -> Array:
        """Rates (S,) of the states as they are now, at a time [s], positions and velocities (N, 3)."""
        parts = zip(self._elements, split_states(self._elements, self.scene, self._now), strict=True)
        found = [rated(element, self.scene, time, nodes, velocities, *own) for element, own in parts if own]
        return np.concatenate([np.zeros(0), *found])

    def slopes(self, function: Callable[[Array], Array]) -> Array:
        """Derivatives (m, S) of a function (m,) of the states, at the start, by central differences."""
        steps = STEP * np.maximum(1.0, np.abs(self.start))
        ways = np.eye(len(steps))
        columns = [
            central(lambda part, way=way: function(self.start + part * way), h)  # type: ignore[misc]
            for way, h in zip(ways, steps, strict=True)
        ]
        return np.column_stack(columns)
