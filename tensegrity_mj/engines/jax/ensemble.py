"""Many runs at once: one program whose arrays have the runs last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.driving import Grid
from tensegrity_mj.engines.jax.model import Observed
from tensegrity_mj.engines.jax.program import Program
from tensegrity_mj.engines.jax.recording import trajectory_of
from tensegrity_mj.engines.recording import check_rows
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.engines.jax.engine import JAX

# What runs may differ in, beside their starts, and what they may not.
OF_STRINGS = ("stiffness", "damping", "rest_length", "force_density", "tension")
SAME = ("gravity", "loads", "breaks", "motions", "resistance", "water", "elements")


class JAXEnsemble:
    """Runs of scenes that differ in their starts and in their strings' numbers.

    Attributes:
        options: the engine.
        members: when `run` is done, a run each, which `conclude`s with its trajectory or its error.
        stages: evaluations of the forces a step.
        counters: (S, 2): the second column has the steps.
        seconds: wall time of the integration of all.
    """

    def __init__(self, options: JAX, requests: Sequence[Request]) -> None:
        if options.timestep is None:
            raise OptionError("simulate_many: engine JAX: the steps of many are fixed: use Method.RK4 and a timestep")
        self.options, self.requests, first = options, requests, requests[0]
        for number, request in enumerate(requests):
            if request.law.own is not first.law.own:
                raise OptionError(f"simulate_many: controllers[{number}] is another law than the first; JAX runs one")
            _check_alike(number, request.scene, first.scene)
        self.program, self.grid = Program(options, first), Grid.of(first, options.timestep)
        own = [self.program.model.own_parameters(request.scene) for request in requests]
        self.program.parameters |= {name: np.stack([one[name] for one in own], axis=-1) for name in own[0]}
        width = self.program.parameters["nodes"].size // len(requests) * 2
        check_rows(float(len(requests)) * len(self.program.times), width)
        self.members: list[_Member] = []
        self.stages, self.seconds = self.program.steps.stages, 0.0
        self.counters = np.zeros((len(requests), 2), np.int64)

    def run(self) -> None:
        """Simulate all; nothing is raised for what becomes of one."""
        rows, cost, _ = self.program.rows(f"{self.options}, {len(self.requests)} runs")
        self.seconds, self.counters[:, 1] = cost["wall_time"], int(cost["steps"])
        for number, request in enumerate(self.requests):
            own = Observed(*(one if one.ndim == 1 else one[..., number] for one in rows))
            self.members.append(_Member(self.options, request, self.grid, own, cost))


@dataclass(frozen=True)
class _Member:
    """One of the runs; of its end, rows of NaN say all."""

    options: JAX
    request: Request
    grid: Grid
    observed: Observed
    cost: dict[str, float]
    ended_early: float | None = None

    @property
    def rows(self) -> Array:
        """(T, 6N) positions and velocities, NaN behind its end."""
        T = len(self.observed.time)
        found = np.full((len(self.grid.times), 2 * self.observed.nodes[0].size), np.nan)
        found[:T] = np.stack([self.observed.nodes, self.observed.velocities], axis=1).reshape(T, -1)
        return found

    def conclude(self, seconds: float) -> Trajectory:
        """Its trajectory; it raises what `JAX.run` would."""
        return trajectory_of(self.options, self.request, self.observed, self.cost | {"wall_time": seconds})


def _check_alike(number: int, scene: Scene, first: Scene) -> None:
    """Raise OptionError where a scene differs from the first in more than its start and its strings' numbers."""
    if scene is first:
        return
    differs = [name for name in SAME if getattr(scene, name) != getattr(first, name)]
    one, other = scene.structure, first.structure
    if one is not other:
        pairs = list(zip(one.strings, other.strings, strict=True))
        strings = tuple(replace(b, **{key: getattr(a, key) for key in OF_STRINGS}) for a, b in pairs)
        if strings != one.strings or any(a.is_constant != b.is_constant for a, b in pairs):
            differs.append("strings (in more than stiffness, damping and how they are taut)")
        elif replace(one, strings=other.strings) != other:
            differs.append("structure")
    if differs:
        raise OptionError(
            f"scenes[{number}] ('{scene.name}'): its {differs[0]} differ from the first scene's; JAX runs many that "
            "differ in their starts and in stiffness, damping and rest lengths of strings: use MuJoCo, or run_many"
        )
