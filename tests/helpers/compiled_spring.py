"""A spring to the ground with a compiled function, written as docs/developing/models.md says."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import positive, text, vector
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import ACT_SIGNATURE, Effect, Motion, NativeElement
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model import Element, Work

Spring, pack = view_of("TestSpring", node="size", stiffness="real", place=("f8", 3))


@value("CompiledSpring", SceneError)
class CompiledSpring(Element):
    """A spring of no length from a node to a place.

    Attributes:
        node: its name.
        stiffness: [N/m].
        place: [m].
    """

    node: str = field(text())
    stiffness: float = field(positive("N/m"))
    place: tuple[float, float, float] = field(vector("m"), default=(0.0, 0.0, 0.0))

    work = Work.STORED
    smooth = True
    vectorized = True
    compiled = "compiled_spring:pack_spring"
    packed: ClassVar[list[Element]] = []  # for the test: whose compiled function was taken

    def _away(self, scene: Any, nodes: Any) -> Any:
        return nodes[..., scene.structure.node_index[self.node], :] - np.array(self.place)

    def act(self, scene: Any, time: Any, nodes: Any, velocities: Any) -> Any:
        """See `Element`."""
        forces = np.zeros_like(nodes)
        forces[..., scene.structure.node_index[self.node], :] = -self.stiffness * self._away(scene, nodes)
        return forces

    def energy(self, scene: Any, nodes: Any) -> Any:
        """See `Element`."""
        return 0.5 * self.stiffness * np.sum(self._away(scene, nodes) ** 2, axis=-1)


def pack_spring(element: Any, scene: Any) -> NativeElement:
    """What `act_spring` reads."""
    CompiledSpring.packed.append(element)
    node = scene.structure.node_index[element.node]
    packed = pack(node=node, stiffness=element.stiffness, place=np.array(element.place))
    return NativeElement(act_spring.address, packed.address, (packed,))


@c_function(ACT_SIGNATURE)
def act_spring(t: Any, motion_at: Any, context_at: Any, effect_at: Any) -> Any:
    """f = k (place - x) at its node."""
    spring, nodes, forces = Spring(context_at), Motion(motion_at).nodes, Effect(effect_at).forces
    for x in range(3):
        forces[spring.node, x] += spring.stiffness * (spring.place[x] - nodes[spring.node, x])
    return SOLVED
