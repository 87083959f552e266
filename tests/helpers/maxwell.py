"""Elements with a state, in Python and compiled: spring and dashpot in series, a thruster and a brake that lag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import ACT_SIGNATURE, Effect, Motion, NativeElement
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.model import Element, Work


@dataclass(frozen=True)
class Maxwell(Element):
    """A spring and a dashpot in series, of no length, from a place to a node; its state is the dashpot's elongation."""

    node: str
    stiffness: float
    damping: float
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    work = Work.STORED
    smooth = True
    vectorized = True

    def stretch(self, scene: Any, nodes: Any, state: Any) -> Any:
        return nodes[..., scene.structure.node_index[self.node], :] - np.array(self.place) - state

    def act(self, scene: Any, time: Any, nodes: Any, velocities: Any, state: Any) -> Any:  # type: ignore[override]
        forces = np.zeros_like(nodes)
        forces[..., scene.structure.node_index[self.node], :] = -self.stiffness * self.stretch(scene, nodes, state)
        return forces

    def energy(self, scene: Any, nodes: Any, state: Any) -> Any:  # type: ignore[override]
        return 0.5 * self.stiffness * np.sum(self.stretch(scene, nodes, state) ** 2, axis=-1)

    def state0(self, scene: Any) -> Any:
        return np.array(self.start)

    def rates(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:
        return self.stiffness / self.damping * self.stretch(scene, nodes, state)

    def lost(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> float:
        return self.stiffness**2 / self.damping * float(np.sum(self.stretch(scene, nodes, state) ** 2))


Packed, pack = view_of("TestMaxwell", node="size", stiffness="real", damping="real", place=("f8", 3))


@dataclass(frozen=True)
class CompiledMaxwell(Maxwell):
    """The same by a compiled function."""

    compiled = "maxwell:pack_maxwell"


def pack_maxwell(element: Any, scene: Any) -> NativeElement:
    """What `act_maxwell` reads."""
    node, place = scene.structure.node_index[element.node], np.array(element.place)
    packed = pack(node=node, stiffness=element.stiffness, damping=element.damping, place=place)
    return NativeElement(act_maxwell.address, packed.address, (packed,))


@c_function(ACT_SIGNATURE)
def act_maxwell(t: Any, motion_at: Any, context_at: Any, effect_at: Any) -> Any:
    """f = -k u, d(state)/dt = k u / c, with u = x - place - state, and what the dashpot takes."""
    own, nodes, effect = Packed(context_at), Motion(motion_at).nodes, Effect(effect_at)
    for x in range(3):
        pull = own.stiffness * (nodes[own.node, x] - own.place[x] - effect.state[x])
        effect.forces[own.node, x] -= pull
        effect.rates[x] = pull / own.damping
        effect.given += pull * pull / own.damping
    return SOLVED


@dataclass(frozen=True)
class Thruster(Element):
    """A force along x that follows cos(ω t) by a lag of first order; its state is the force [N]."""

    node: str
    force: float
    lag: float

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:  # type: ignore[override]
        forces = np.zeros_like(nodes)
        forces[scene.structure.node_index[self.node], 0] = state[0]
        return forces

    def state0(self, scene: Any) -> Any:
        return np.zeros(1)

    def rates(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:
        return (self.force * np.cos(4.0 * time) - state) / self.lag


@dataclass(frozen=True)
class SlowBrake(Element):
    """A damper that sees a node's velocity late, in a wind along x; its state is what it sees [m/s]."""

    node: str
    damping: float
    lag: float
    wind: float = 0.3
    work = Work.LOST

    def act(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:  # type: ignore[override]
        forces = np.zeros_like(nodes)
        forces[scene.structure.node_index[self.node]] = self.damping * (np.array([self.wind, 0.0, 0.0]) - state)
        return forces

    def given(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> float:  # type: ignore[override]
        return self.damping * float(self.wind - state[0]) * self.wind

    def state0(self, scene: Any) -> Any:
        return np.zeros(3)

    def rates(self, scene: Any, time: float, nodes: Any, velocities: Any, state: Any) -> Any:
        return (velocities[scene.structure.node_index[self.node]] - state) / self.lag
