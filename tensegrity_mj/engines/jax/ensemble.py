"""Many runs at once: one program whose arrays have the runs last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

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

# What runs may differ in: parameters that have a batch.
OF_STRINGS = ("stiffness", "damping", "rest_length", "force_density", "tension")
SAME = ("gravity", "loads", "breaks", "motions", "resistance", "water", "elements")
DIFFER = ("nodes", "velocities", "rest_lengths", "stiffness", "damping")


class JAXEnsemble:
    """Runs of scenes that differ in their starts and in their strings' numbers.

    Attributes:
        options: the engine.
        members: a run each, which `conclude`s with its trajectory or its error.
        stages: evaluations of the forces a step.
        counters: (S, 2): the second column has the steps.
        seconds: wall time of the integration of all.
    """

    def __init__(self, options: JAX, requests: Sequence[Request]) -> None:
        if options.timestep is None:
            raise OptionError("simulate_many: engine JAX: the steps of many are fixed: use Method.RK4 and a timestep")
        self.options, self.seconds, self.stages, first = options, 0.0, 4, requests[0]
        for number, request in enumerate(requests):
            if request.law.own is not first.law.own:
                raise OptionError(f"simulate_many: controllers[{number}] is another law than the first; JAX runs one")
            _check_alike(number, request.scene, first.scene)
        self.program = Program(options, first)
        for name in DIFFER:
            self.program.parameters[name] = np.stack([_value(one.scene, name) for one in requests], axis=-1)
        self.members = [_Member(self, number, request) for number, request in enumerate(requests)]
        width = self.program.parameters["nodes"].size // len(requests) * 2
        check_rows(float(len(requests)) * len(self.program.times), width)
        self.counters = np.zeros((len(requests), 2), np.int64)
        self.rows: Any = None

    def run(self) -> None:
        """Simulate all; nothing is raised for what becomes of one."""
        self.rows, cost, _ = self.program.fixed(f"{self.options}, {len(self.members)} runs")
        self.seconds, self.counters[:, 1] = cost["wall_time"], int(cost["steps"])

    def of(self, number: int) -> Observed:
        """The rows of one run."""
        return Observed(*(rows if rows.ndim == 1 else rows[..., number] for rows in self.rows))


class _Member:
    """One of the runs."""

    def __init__(self, whole: JAXEnsemble, number: int, request: Request) -> None:
        self._whole, self._number, self.request = whole, number, request

    @property
    def grid(self) -> Grid:
        """Its steps."""
        return self._whole.program.grid

    @property
    def rows(self) -> Array:
        """(T, 6N) positions and velocities, NaN behind its end."""
        own = self._whole.of(self._number)
        T = len(own.time)
        found = np.full((len(self.grid.times), 2 * own.nodes[0].size), np.nan)
        found[:T] = np.concatenate([own.nodes.reshape(T, -1), own.velocities.reshape(T, -1)], axis=1)
        return found

    @property
    def ended_early(self) -> float | None:
        """Its NaN say so."""
        return None

    def conclude(self, seconds: float) -> Trajectory:
        """Its trajectory; it raises what `JAX.run` would."""
        steps = int(self._whole.counters[self._number, 1])
        cost = {"wall_time": seconds, "steps": steps, "evaluations": 4 * steps}
        return trajectory_of(self._whole.options, self.request, self._whole.of(self._number), cost)


def _value(scene: Scene, name: str) -> Array:
    starts = {"nodes": "nodes0", "velocities": "velocities0"}
    return np.asarray(getattr(scene, starts[name]) if name in starts else getattr(scene.structure, name))


def _check_alike(number: int, scene: Scene, first: Scene) -> None:
    """Raise OptionError where a scene differs from the first in more than its start and its strings' numbers."""
    if scene is first:
        return
    differs = [name for name in SAME if getattr(scene, name) != getattr(first, name)]
    one, other = scene.structure, first.structure
    if one is not other:
        pairs = zip(one.strings, other.strings, strict=True)
        strings = tuple(replace(b, **{key: getattr(a, key) for key in OF_STRINGS}) for a, b in pairs)
        if strings != one.strings:
            differs.append("strings (in more than stiffness, damping and how they are taut)")
        elif replace(one, strings=other.strings) != other:
            differs.append("structure")
    if differs:
        raise OptionError(
            f"scenes[{number}] ('{scene.name}'): its {differs[0]} differ from the first scene's; JAX runs many that "
            "differ in their starts and in stiffness, damping and rest lengths of strings: use MuJoCo, or run_many"
        )
