"""Many runs at once: one program whose arrays have the runs last."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace

import jax
import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.engines.driving import Grid
from tensegrity_mj.engines.jax.model import Observed
from tensegrity_mj.engines.jax.program import Program, trajectory_of
from tensegrity_mj.engines.jax.settings import JAX
from tensegrity_mj.engines.recording import check_rows
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Trajectory

# What runs may differ in, as well as their starts, and what they may not.
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
        blocks: how many threads have a part of the runs each: XLA computes a small array on one core.
    """

    def __init__(self, options: JAX, requests: Sequence[Request], threads: int) -> None:
        if options.timestep is None:
            raise OptionError("simulate_many: engine JAX: the steps of many are fixed: use Method.RK4 and a timestep")
        self.options, self.requests, first = options, requests, requests[0]
        for number, request in enumerate(requests):
            if request.law.own is not first.law.own:
                raise OptionError(f"simulate_many: controllers[{number}] is another law than the first; JAX runs one")
            _check_alike(number, request.scene, first.scene)
        self.program, self.grid = Program(options, first), Grid.of(first, options.timestep)
        own = [self.program.model.own_parameters(request.scene) for request in requests]
        self.batched = tuple(own[0])
        self.program.parameters |= {name: np.stack([one[name] for one in own], axis=-1) for name in self.batched}
        width = self.program.parameters["nodes"].size // len(requests) * 2
        check_rows(float(len(requests)) * len(self.program.times), width)
        self.members: list[_Member] = []
        self.stages, self.seconds = self.program.steps.stages, 0.0
        self.counters = np.zeros((len(requests), 2), np.int64)
        alone = jax.default_backend() != "cpu"  # a GPU takes them all at once
        wanted = range(min(1 if alone else threads or os.cpu_count() or 1, len(requests)), 0, -1)
        self.blocks = next(count for count in wanted if len(requests) % count == 0)  # of one size, on a thread each

    def run(self) -> None:
        """Simulate all runs; a run that fails raises nothing here."""
        size, label = len(self.requests) // self.blocks, f"{self.options}, {len(self.requests)} runs"

        def block(number: int) -> tuple[Observed, dict[str, float], int]:
            own = copy(self.program)
            mine = slice(number * size, (number + 1) * size)
            own.parameters = {**own.parameters, **{name: own.parameters[name][..., mine] for name in self.batched}}
            own.request = replace(own.request, progress=own.request.progress and number == 0)
            return own.rows(label)

        with ThreadPoolExecutor(self.blocks) as pool:
            for number, (rows, cost, _) in enumerate(pool.map(block, range(self.blocks))):
                self.seconds = max(self.seconds, cost["wall_time"])
                for place, request in enumerate(self.requests[number * size : (number + 1) * size]):
                    own = Observed(*(one if one.ndim == 1 else one[..., place] for one in rows))
                    self.members.append(_Member(self.options, request, self.grid, own, cost))
                self.counters[number * size : (number + 1) * size, 1] = int(cost["steps"])


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
        """Positions and velocities (T, 6N), NaN after its end."""
        T = len(self.observed.time)
        found = np.full((len(self.grid.times), 2 * self.observed.nodes[0].size), np.nan)
        found[:T] = np.stack([self.observed.nodes, self.observed.velocities], axis=1).reshape(T, -1)
        return found

    def conclude(self, seconds: float) -> Trajectory:
        """Return its trajectory; it raises what `JAX.run` would."""
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
