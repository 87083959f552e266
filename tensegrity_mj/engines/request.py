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

    @property
    def intervals(self) -> dict[str, float]:
        """[s] of what fixed steps divide, by what it is."""
        found = {"duration": self.duration}
        if self.output_interval is not None:
            found["output interval"] = self.output_interval
        if self.sampled:
            assert self.actuation.period is not None
            found["control period"] = self.actuation.period
        breaks = [one for one in self.scene.breaks if 0 < one.time < self.duration]
        return found | {f"break of string '{one.string}'": one.time for one in breaks}


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
