"""Results of statics for a scene."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.statics.balance import Balance
from tensegrity_mj.statics.model import StaticModel
from tensegrity_mj.statics.modes import Modes
from tensegrity_mj.statics.path import Response
from tensegrity_mj.statics.prestress import Prestressability
from tensegrity_mj.statics.sizing import Sizing
from tensegrity_mj.statics.state import StaticState, standalone_scene
from tensegrity_mj.statics.strength import MemberCheck, TrajectoryCheck

if TYPE_CHECKING:
    from tensegrity_mj.statics.engines import EngineCheck


class Search(enum.Enum):
    """Methods of finding an equilibrium."""

    NEWTON = "newton"
    RELAXATION = "relaxation"  # dynamic, with kinetic damping
    BOTH = "both"  # Newton's, and the other to compare with


@dataclass(frozen=True, eq=False)
class StaticResult:
    """Data of a `StaticStudy`, whose documentation explains the fields; it words, draws and saves them."""

    model: StaticModel
    search: Search
    start: Balance
    state: StaticState | None
    failure: str = ""
    other: StaticState | None = None
    modes: Modes | None = None
    prestressability: Prestressability | None = None
    members: MemberCheck | None = None
    response: Response | None = None
    engine: EngineCheck | None = None
    sizing: Sizing | None = None
    run: TrajectoryCheck | None = None
    notes: tuple[str, ...] = ()

    @property
    def moved(self) -> float:
        """[m]: how far the node that moved most is from the scene's start; NaN without an equilibrium."""
        if self.state is None:
            return float("nan")
        return float(np.linalg.norm(self.state.nodes - self.model.scene.nodes0, axis=1).max(initial=0.0))

    @property
    def difference(self) -> float:
        """[m]: the largest difference of a member's length between the two searches; NaN unless both were made."""
        if self.state is None or self.other is None:
            return float("nan")
        pairs = ((self.state.lengths, self.other.lengths), (self.state.rod_lengths, self.other.rod_lengths))
        return max(float(np.abs(a - b).max(initial=0.0)) for a, b in pairs)

    def scene(self) -> Scene:
        """The scene that starts in the equilibrium, with further loads as its own and without broken strings.

        Raises:
            InfeasibleError: where there is no equilibrium.
        """
        if self.state is None:
            raise InfeasibleError(self.failure)
        return standalone_scene(self.state)

    @property
    def status(self) -> str:
        """ "ok" or "infeasible"."""
        return "infeasible" if self.state is None else "ok"
