"""Robots for learning: commanded step by step, many at once, each of which starts anew at any time.

A member is a run as `simulate` makes it, with its rest lengths commanded and held (`Actuation.hold_rest_length`), by
the same compiled code. It records nothing and keeps no ledger: its state is read from the batch after each period.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import SimulationError
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.controllers.replay import cubics
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco import ensemble, install, many, run_view, settings
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.learning.tasks.definition import substeps
from tensegrity_mj.learning.tasks.starts import RandomStart, displace
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.model.scene import Scene

VELOCITIES = mujoco.mjtStage.mjSTAGE_VEL.value
NEVER = 2**40  # steps: more than any episode has


class Fleet(ensemble.MuJoCoEnsemble):
    """Robots of one structure, whose numbers may differ from robot to robot.

    Attributes:
        commands: (n, M) [m], the rest lengths that are taken up at the next `advance`.
        substeps: of the integrator in a period.

    Raises:
        OptionError: where the period is no multiple of the step, and for strings whose tension is a curve.
    """

    def __init__(self, scene: Scene, options: settings.MuJoCo, period: float, count: int, threads: int) -> None:
        self.substeps = substeps(period, options.timestep)
        if not scene.structure.curves.linear:
            raise OptionError(f"scene '{scene.name}': tensions of its strings are curves; give them a stiffness alone")
        self._period, M = period, len(scene.structure.strings)
        self._never = NEVER * options.timestep
        self._coefficients = np.zeros((count, 1, M, 4))
        self._held, self._broken = np.zeros((count, M)), np.zeros((count, M), np.int64)
        self._numbers = np.zeros((count, 3, M))  # stiffness, damping, whether tensions are clipped
        super().__init__(options, [self._request(scene, number) for number in range(count)], threads)
        self._scene = scene
        names = ("site_xpos", "cvel", "subtree_com", "ten_length", "ten_velocity")
        self._read = {name: self.batch.bind(name) for name in names}

    @property
    def commands(self) -> Array:
        return self._coefficients[:, 0, :, 3]

    def start(
        self, number: int, scene: Scene | None = None, start: RandomStart | None = None, generator: Any = None
    ) -> None:
        """Let a robot start anew: as the scene that the fleet was made of, or another, or at random near its start.

        Raises:
            OptionError: for a scene of another layout; as `starts.displace`.
        """
        own = self._scene if scene is None else scene
        ready = self.ready if own is self._scene else self.prepare(own)
        self.give_models({number: ready})
        member, structure = self.enter(number, self._request(own, number), ready), own.structure
        self._held[number] = self.commands[number] = structure.rest_lengths
        self._broken[number] = 0
        self._numbers[number] = structure.stiffness, structure.damping, structure.clipped
        # The work of contacts is nobody's.
        member.plant.set(held=self._held[number], broken=self._broken[number], touches=0)
        if start is not None:
            displace(ready.model, self.data, own, start, generator)
            self.batch.qpos[number], self.batch.qvel[number] = self.data.qpos, self.data.qvel

    def advance(self, ids: Sequence[int] | NDArray[np.int64]) -> NDArray[np.bool_]:
        """A control period of these robots; which of them have come to an end that no run goes on from."""
        if not len(ids):  # which the batch would take for all
            return np.zeros(0, bool)
        with install.installed(self.guide, many.many_runs):
            try:
                self.batch.step(ids, nstep=self.substeps, stage=VELOCITIES)
            except SimulationError as error:
                self.counters[error.ids, run_view.ENDED] = run_view.RUNNING - 1
        ended = (self.counters[ids, run_view.ENDED] != run_view.RUNNING) | self.batch.warning[ids, :, 1].any(axis=1)
        finite = np.isfinite(self.batch.qpos[ids]).all(axis=1) & np.isfinite(self.batch.qvel[ids]).all(axis=1)
        return np.asarray(ended | ~finite)

    def look(self, ids: Sequence[int] | NDArray[np.int64], fresh: bool = False) -> dict[str, Array]:
        """Read the state of these robots now, by the names of `State`; `fresh` where they have just started."""
        if fresh:
            self.batch.forward(ids, stage=VELOCITIES)
        places, cvel, com, lengths, rates = (array[ids] for array in self._read.values())
        sites, bodies, roots = self.ready.nodes
        nodes, spatial = places[:, sites], cvel[:, bodies]
        # cvel is (ω, v) at the centre of mass of the kinematic tree.
        velocities = spatial[..., 3:] + np.cross(spatial[..., :3], nodes - com[:, roots])
        M = self._held.shape[1]
        lengths, rates, rest = lengths[:, :M], rates[:, :M], self._held[ids]
        stiffness, damping, clipped = np.moveaxis(self._numbers[ids], 1, 0)
        tensions = stiffness * (lengths - rest) + damping * rates
        tensions = np.where(clipped > 0, np.maximum(tensions, 0.0), tensions)
        tensions = np.where((lengths <= rest) | (self._broken[ids] > 0), 0.0, tensions)
        return {
            "nodes": nodes,
            "velocities": velocities,
            "lengths": lengths,
            "rest_lengths": rest,
            "tensions": tensions,
        }

    def _request(self, scene: Scene, number: int) -> Request:
        law = cubics(np.array([0.0, 1.0]), self._coefficients[number], Command.REST_LENGTH)
        actuation = Actuation.hold_rest_length(self._period)
        return Request(scene, law, actuation, duration=self._never, output_interval=self._never)
