"""What every engine is given and what it gives back: a request, recorded rows, and the trajectory made of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import NativeLaw
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene


@dataclass(frozen=True)
class Request:
    """One run to be made: the same for every engine."""

    scene: Scene
    law: NativeLaw
    actuation: Actuation = field(default_factory=Actuation.continuous)
    on_infeasible: OnInfeasible = OnInfeasible.STOP
    duration: float = 1.0
    output_interval: float | None = None
    progress: bool = False

    @property
    def sampled(self) -> bool:
        """Whether the law is sampled."""
        there = bool(self.law.address) or self.law.own is not None  # compiled, or as arrays alone
        return there and self.actuation.mode is not Mode.CONTINUOUS


class Accelerations(Protocol):
    """Accelerations of the nodes from an engine's own equations, at one state and without a step.

    Called with time [s], node positions and velocities (N, 3), and rest lengths (M,) [m] (None: the structure's, or
    what the law sets). Returns the positions (N, 3) [m] where the engine places the nodes, and their accelerations
    (N, 3) [m/s²].
    """

    def __call__(
        self, time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None
    ) -> tuple[Array, Array]: ...


class AcceleratingEngine(Protocol):
    """An engine that gives the accelerations of the nodes."""

    def accelerations(self, request: Request) -> Accelerations:
        """See `Accelerations`."""
        ...


def cost_of_law(request: Request) -> dict[str, float]:
    """How often a law in Python was called, and its part of the wall time [s]; nothing for a compiled one."""
    if request.law.spent is None:
        return {}
    calls, seconds = request.law.spent
    return {"law_calls": calls, "law_time": seconds}
