"""Equilibria from an engine's own accelerations alone: what MuJoCo, the DAE and the ODE hold to be at rest.

In the coordinates δ of `linearization.chart` about the nodes of the moment, at rest, an engine has a(δ) = -M⁻¹ ∇Π. Each
step solves

    (μ - ∂a/∂δ) s = a        which is        (K + μ M) s = -∇Π

with ∂a/∂δ by central differences: a Newton step for μ = 0, and a short way down the energy for a large one. μ starts
above what would make K + μ M indefinite, and falls as forces do. A step is taken where the force along it does not turn
against it, so that it stays on the near side of the energy's least value on its way. Neutral motions, along which a and
∂a/∂δ vanish, get no step: the least μ is far above their round-off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance, real_array, whole
from tensegrity_mj.dynamics.native.law import native_law
from tensegrity_mj.engines import request, requirements, table
from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.linearization.chart import Chart, chart_of
from tensegrity_mj.linearization.linearizing import linearize, reach_of
from tensegrity_mj.model.rods import kinetic_energy
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.statics.modes import Modes
from tensegrity_mj.statics.state import StaticState, require_rigid_and_free, standalone_scene

STEP = 1e-5  # of the shortest member: central differences have an error of its square, 1e-10 of ∂a/∂δ
LEAST_SHIFT = 1e-9  # of the largest ∂a/∂δ: above that error, below what holds the softest motion of most structures
LONGEST_MOVE = 0.3  # of the shortest member, of any node in one step
SMALL_MOVE = 1e-10  # of the same: the Newton step after which none follows
SPENT_MOVE = 1e-6  # of the same: below it, steps that get no shorter are made of round-off
PATIENCE = 3  # of these
OVERSHOOT = 0.5  # of the force along a step: what it may be against it after it
TRIALS = 40
ESCAPES = 6
KICK = 1e-2  # of the shortest member, along a motion that nothing holds back
UNSTABLE = 1e-6  # of the largest ∂a/∂δ


@dataclass(frozen=True, eq=False)
class EngineEquilibrium:
    """State in which an engine is at rest; N nodes.

    Attributes:
        scene: the one in question, starting there at rest.
        engine: one line.
        nodes: (N, 3) [m].
        accelerations: (N, 3) [m/s²] what is left of them.
        move: [m] the last step's largest: how far off the nodes may be.
        growth: [1/s²] the largest eigenvalue of ∂a/∂δ: below zero, or zero of neutral motions, where it is stable.
        iterations, evaluations: steps, and calls of the engine.
    """

    scene: Scene
    engine: str
    nodes: Array
    accelerations: Array
    move: float
    growth: float
    iterations: int
    evaluations: int


def engine_equilibrium(
    scene: Scene, engine: request.AcceleratingEngine, *, nodes: ArrayLike | None = None, iterations: int = 300
) -> EngineEquilibrium:
    """A stable equilibrium of a scene by an engine's accelerations alone, near the start.

    All that acts at rest and t = 0 counts, water and wind where the nodes are; contact and breaks do not.

    Args:
        scene: strings have their own rest lengths.
        engine: `MuJoCo(...)`, `DAE(...)` or `ODE(...)`; only its equations count, not its steps.
        nodes: (N, 3) [m] where to start; the scene's start by default.
        iterations: at most.

    Raises:
        OptionError: for arguments that do not fit.
        SceneError: for a start that stretches a rod or breaks a support, and moved supports.
        InfeasibleError: where none is found.
    """
    instance("scene", scene, Scene, "use a Scene, or load_scene(name or path)")
    engine = table.checked_engine(engine, "accelerations")
    limit = whole("iterations", iterations, 1)
    requirements.require(None, scene, "engine_equilibrium")
    shape = (len(scene.structure.nodes), 3)
    start = scene.nodes0 if nodes is None else real_array("nodes", nodes, shape, "m", scalar=False)
    scene = scene.with_(initial_nodes=start, initial_velocities=None, breaks=(), contact=None, control=None)
    return _Search(scene, engine).found(limit)


class AtRest:
    """A scene's accelerations at rest by its engine alone, in coordinates of charts, and how often it was called."""

    def __init__(self, scene: Scene, engine: request.AcceleratingEngine) -> None:
        self.scene, self.engine, self.evaluations = scene, engine, 0
        self.field = engine.accelerations(request.Request(scene, native_law(None, scene.structure)))
        self.still = np.zeros_like(scene.nodes0)
        self.reach = reach_of(scene.structure, scene.nodes0)

    def accelerations(self, chart: Chart, delta: Array) -> Array:
        """δ̈ (n,) at rest at δ."""
        self.evaluations += 1
        rest = np.zeros(chart.size)
        nodes, rates = chart.state(delta, rest)
        return chart.accelerations(delta, rest, self.field(0.0, nodes, rates)[1])

    def slopes(self, chart: Chart) -> Array:
        """∂a/∂δ (n, n)."""
        columns = []
        for k in range(chart.size):
            h = STEP * self.reach / chart.lever(k)
            unit = h * np.eye(chart.size)[k]
            columns.append((self.accelerations(chart, unit) - self.accelerations(chart, -unit)) / (2 * h))
        return np.array(columns).reshape(chart.size, chart.size).T


class _Search(AtRest):
    """Search by Newton's steps from the scene's start."""

    def found(self, limit: int) -> EngineEquilibrium:
        """Search downwards; leave unstable points, and search downwards again."""
        nodes, used = np.array(self.scene.nodes0), 0
        for _ in range(ESCAPES):
            nodes, move, slopes, chart, taken = self._down(nodes, limit - used)
            used += taken
            values, vectors = np.linalg.eig(slopes)
            top = int(np.argmax(values.real)) if len(values) else 0
            growth = float(values.real[top]) if len(values) else 0.0
            if growth <= UNSTABLE * float(np.abs(slopes).max(initial=0.0)):
                left = self.field(0.0, nodes, self.still)[1]
                there = self.scene.with_(initial_nodes=nodes)
                return EngineEquilibrium(there, str(self.engine), nodes, left, move, growth, used, self.evaluations)
            motion = np.asarray(vectors[:, top].real, float)
            far = float(np.linalg.norm(chart.state(np.zeros(chart.size), motion)[1], axis=1).max())
            nodes = chart.state(motion * (KICK * self.reach / far), np.zeros(chart.size))[0]
        raise InfeasibleError(
            f"'{self.scene.name}': {ESCAPES} unstable equilibria were left one after another; start elsewhere "
            "(nodes=...)"
        )

    def _down(self, nodes: Array, limit: int) -> tuple[Array, float, Array, Chart, int]:
        """Nodes at rest, the last move [m], ∂a/∂δ and the chart there, and the number of steps."""
        shift: float | None = None
        last, spent = np.inf, 0
        for taken in range(limit):
            chart = chart_of(self.scene.structure, nodes)
            none = np.zeros(chart.size)
            a, slopes = self.accelerations(chart, none), self.slopes(chart)
            stiffest = float(np.abs(slopes).max(initial=0.0))
            if not chart.size or (stiffest == 0 and not a.any()):
                return nodes, 0.0, slopes, chart, taken
            if stiffest == 0:
                raise self._none(taken, a)
            least = max(LEAST_SHIFT * stiffest, 1e-300)
            highest = float(np.linalg.eigvals(slopes).real.max())
            steady = highest <= UNSTABLE * stiffest
            shift = max(least, highest) if shift is None else shift
            # Newton's own step shows how near a place of rest is, a stable one or not.
            step = np.asarray(np.linalg.solve(least * np.eye(chart.size) - slopes, a), float)
            move = float(np.linalg.norm(chart.state(none, step)[1], axis=1).max())
            if move <= SMALL_MOVE * self.reach:
                return chart.state(step, none)[0], move, slopes, chart, taken + 1
            spent = spent + 1 if move <= SPENT_MOVE * self.reach and move >= 0.9 * last else 0
            if spent == PATIENCE:  # forces of round-off make no better one
                return nodes, move, slopes, chart, taken
            last = min(last, move)
            for _ in range(TRIALS):
                # K + μ M is definite above the highest eigenvalue of ∂a/∂δ.
                mu = max(shift, least) if steady else max(shift, 1.5 * highest)
                s = np.asarray(np.linalg.solve(mu * np.eye(chart.size) - slopes, a), float)
                move = float(np.linalg.norm(chart.state(none, s)[1], axis=1).max())
                if move <= LONGEST_MOVE * self.reach:
                    there = self.accelerations(chart, s)
                    along, after = self._power(chart, a, s), self._power(chart, there, s)
                    if after > -OVERSHOOT * along:
                        break
                shift = 4.0 * max(mu, least)
            else:
                raise self._none(taken, a)
            nodes = chart.state(s, none)[0]
            shift = max(shift / 8.0, least * 0.5)
        raise self._none(limit, np.zeros(0))

    def _power(self, chart: Chart, a: Array, s: Array) -> float:
        """The force along a step, by the masses and the accelerations that it makes: aᵀ M s."""
        none = np.zeros(chart.size)
        (_, one), (_, other) = chart.state(none, a), chart.state(none, s)
        structure = self.scene.structure
        return float(kinetic_energy(structure, one + other) - kinetic_energy(structure, one - other)) / 2

    def _none(self, taken: int, a: Array) -> InfeasibleError:
        left = f": {np.abs(a).max():.3g} of acceleration is left" if a.size else ""
        return InfeasibleError(
            f"'{self.scene.name}': no equilibrium of {self.engine} after {taken} steps{left}. Is anything held by "
            "slack strings alone, or does the structure fall without end? Start nearer (nodes=...), or allow more "
            "iterations"
        )


SAME = 1e-6  # of the mean member: nodes that are nearer are at the same place
SOFT = 1e-6  # of the largest ω²: those below are distinguished from central differences' error no better than to 1e-4


@dataclass(frozen=True, eq=False)
class EngineCheck:
    """Comparison of an engine's equilibrium and frequencies with those of statics.

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
        """Return a description, as text."""
        place = (
            f"the same equilibrium to {self.distance:.2g} m"
            if self.same
            else f"another equilibrium: nodes are up to {self.distance:.3g} m away"
        )
        swings = "" if np.isnan(self.frequency_error) else f", squared frequencies to {self.frequency_error:.2g}"
        return f"{self.engine}: {place}{swings}"


def check_engine(state: StaticState, modes: Modes, engine: request.AcceleratingEngine) -> EngineCheck:
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
