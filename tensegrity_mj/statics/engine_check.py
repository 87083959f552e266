"""The same equilibrium and the same frequencies by an engine's equations of motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.request import AcceleratingEngine
from tensegrity_mj.linearization.linearizing import linearize
from tensegrity_mj.statics.engines import engine_equilibrium
from tensegrity_mj.statics.modes import Modes
from tensegrity_mj.statics.standalone import require_rigid_and_free, standalone_scene
from tensegrity_mj.statics.state import StaticState

SAME = 1e-6  # of the mean member: nodes that are nearer are at the same place
SOFT = 1e-6  # of the largest ω²: those below are distinguished from central differences' error no better than to 1e-4


@dataclass(frozen=True, eq=False)
class EngineCheck:
    """What an engine finds, beside statics.

    Attributes:
        engine: one line.
        distance: [m] between the two places of any node, at most; bodies that nothing holds in place are laid upon each
            other first.
        same: whether they are the same place.
        acceleration: [m/s²] the largest that the engine leaves where it is at rest.
        frequencies: [Hz] the engine's, of the modes that statics has; NaN where one grows.
        frequency_error: the largest relative difference of ω² from statics', or NaN where there is none to compare.
        evaluations: calls of the engine.
        warnings: what the engine's linear model does not show, such as strings at the edge of slackness.
    """

    engine: str
    distance: float
    same: bool
    acceleration: float
    frequencies: Array
    frequency_error: float
    evaluations: int
    warnings: tuple[str, ...]

    def describe(self) -> str:
        """In words."""
        place = (
            f"the same equilibrium to {self.distance:.2g} m"
            if self.same
            else f"another equilibrium: nodes are up to {self.distance:.3g} m away"
        )
        swings = "" if np.isnan(self.frequency_error) else f", squared frequencies to {self.frequency_error:.2g}"
        return f"{self.engine}: {place}{swings}"


def check_engine(state: StaticState, modes: Modes, engine: AcceleratingEngine) -> EngineCheck:
    """Let an engine find the equilibrium from where the model starts, and the frequencies about it.

    Args:
        state: of rigid rods, and without holds, which engines know nothing of.
        modes: of that state.
        engine: `MuJoCo(...)`, `DAE(...)` or `ODE(...)`.

    Raises:
        OptionError: for elastic rods, and holds.
        InfeasibleError: where the engine finds no equilibrium.
    """
    model = state.model
    require_rigid_and_free(model)
    scene = standalone_scene(state)
    found = engine_equilibrium(scene, engine, nodes=model.start)
    there = found.nodes
    if state.neutral_motions.shape[1]:
        there = _laid_upon(there, state.nodes)
    distance = float(np.linalg.norm(there - state.nodes, axis=1).max(initial=0.0))
    # Dampers would move frequencies.
    undamped = found.scene.with_(structure=found.scene.structure.with_strings(damping=0.0))
    linear = linearize(undamped, engine)
    n = len(linear.coordinates)
    squares = np.sort(np.linalg.eigvals(-linear.A[n:, :n]).real)
    neutral = modes.neutral.shape[1]
    kept = np.sort(squares[np.argsort(np.abs(squares))[neutral:]])[: len(modes.squares)]
    compared = np.abs(modes.squares[: len(kept)]) > SOFT * np.abs(squares).max(initial=0.0)
    error = np.abs(kept / np.where(compared, modes.squares[: len(kept)], 1.0) - 1.0)[compared]
    return EngineCheck(
        engine=found.engine,
        distance=distance,
        same=distance <= SAME * model.scale[0],
        acceleration=float(np.abs(found.accelerations).max(initial=0.0)),
        frequencies=np.where(kept >= 0, np.sqrt(np.maximum(kept, 0.0)) / (2 * np.pi), np.nan),
        frequency_error=float(error.max()) if len(error) else float("nan"),
        evaluations=found.evaluations,
        warnings=linear.warnings,
    )


def _laid_upon(nodes: Array, other: Array) -> Array:
    """The nodes, moved as one body to where the sum of squared distances is least (Kabsch 1976)."""
    a, b = nodes.mean(axis=0), other.mean(axis=0)
    left, _, right = np.linalg.svd((nodes - a).T @ (other - b))
    sense = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(left @ right)) or 1.0)])
    return np.asarray((nodes - a) @ (left @ sense @ right) + b)
