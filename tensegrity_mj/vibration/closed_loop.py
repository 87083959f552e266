"""The linear model of a scene under a law: what the law sets at a state, and where it is continuous its derivative."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, Command, NativeLaw
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.vibration.blocks import DENSE
from tensegrity_mj.vibration.bodies import SLOTS, Bodies
from tensegrity_mj.vibration.small_motions import LawDerivative, Vibration, vibration

LAW_STEP = 1e-5  # of the structure's size: a central difference's error is its square


class AskedLaw:
    """A law's commands as a function of the state, and their derivative."""

    def __init__(self, scene: Scene, native: NativeLaw) -> None:
        from tensegrity_mj.dynamics.native.asking import ask_at_nodes  # compiled functions: only where a law is asked
        from tensegrity_mj.dynamics.native.plant import Plant
        from tensegrity_mj.dynamics.native.slots import COMMAND, NODES, STATUS, VELOCITIES

        self.native = native
        self._plant = plant = Plant(scene, native, Actuation.continuous(), OnInfeasible.STOP)
        self._nodes, self._velocities, self._command = plant[NODES], plant[VELOCITIES], plant[COMMAND]
        self._ask, self._status = ask_at_nodes, STATUS

    def __call__(self, time: float, nodes: Array, velocities: Array) -> Array:
        """(M,) force densities [N/m] or rest lengths [m].

        Raises:
            InfeasibleError, ControllerError: what the law says there.
        """
        table = self._plant.table
        self._nodes[:], self._velocities[:] = nodes, velocities
        status = int(self._ask(self._plant.address, time))
        self._plant.raise_if_failed(max(status, int(table[self._status])), time)
        if status == NO_SOLUTION:
            raise InfeasibleError(self._plant.infeasible_message(time))
        return np.array(self._command)

    def derivative(self, model: Vibration, velocities: Array, time: float) -> LawDerivative:
        """Its part of K and D at the state of a model, by central differences."""
        n, nodes = model.size, model.nodes
        at, values = np.zeros((len(model.taut), n)), np.zeros((len(model.taut), n))
        size = float(np.ptp(nodes, axis=0).max(initial=0.0)) or 1.0
        units = np.zeros((n, *nodes.shape))
        for k in range(n):
            units[k] = model.motion(model.project(np.eye(n)[k]))
        largest = np.abs(units).max(axis=(1, 2), initial=0.0)
        for k in np.flatnonzero(largest > 0).tolist():
            h = LAW_STEP * size / largest[k]
            ahead, behind = (self(time, nodes + x * units[k], velocities) for x in (h, -h))
            at[:, k] = (ahead - behind) / (2 * h)
            ahead, behind = (self(time, nodes, velocities + x * units[k]) for x in (h, -h))
            values[:, k] = (ahead - behind) / (2 * h)
        i, j = model.scene.structure.string_nodes.T
        # How lengths change with y: its transpose takes tensions to forces.
        stretch = np.einsum("mx,nmx->mn", model.direction, units[:, j] - units[:, i])
        if self.native.command is Command.FORCE_DENSITY:
            weight = np.where(model.taut, model.length, 0.0)
        else:
            weight = -np.where(model.taut, model.scene.structure.stiffness, 0.0)
        push = (stretch * weight[:, None]).T
        return LawDerivative(push @ at, push @ values)


@dataclass(frozen=True, eq=False)
class Loop:
    """A scene and what sets its strings; `at` gives the linear model of a state.

    Attributes:
        scene: what moves.
        bodies: of its structure.
        law: what sets rest lengths or force densities; None for rest lengths that stay.
        mode: of the actuation.
    """

    scene: Scene
    bodies: Bodies
    law: AskedLaw | None
    mode: Mode

    @property
    def is_closed(self) -> bool:
        """Whether the law follows small motions: it is continuous, and not held."""
        return self.law is not None and self.mode is Mode.CONTINUOUS

    def at(self, nodes: Array, velocities: Array, rest_lengths: Array | None, time: float) -> Vibration:
        """The model about a state (N, 3) [m], [m/s], with rest lengths (M,) [m]; None for those that the law sets.

        Raises:
            OptionError: where the loop through the law is too large.
            InfeasibleError, ControllerError: what the law says at the state.
        """
        structure, law = self.scene.structure, self.law
        events = {event.string: event.time for event in self.scene.breaks}
        broken = np.array([events.get(string.name, math.inf) <= time for string in structure.strings], bool)
        densities = None
        rest = structure.rest_lengths if rest_lengths is None else rest_lengths
        if law is not None:
            command = law(time, nodes, velocities)
            lengths = structure.string_lengths(nodes)
            sets_densities = law.native.command is Command.FORCE_DENSITY
            if rest_lengths is None:
                rest = lengths * (1 - command / structure.stiffness) if sets_densities else command
            if (sets_densities and self.is_closed) or self.mode is Mode.HOLD_FORCE_DENSITY:
                densities = np.maximum(0.0, structure.stiffness * (1 - rest / lengths))
        model = vibration(
            self.scene,
            nodes,
            velocities,
            rest,
            force_densities=densities,
            broken=broken,
            time=time,
            bodies=self.bodies,
        )
        if law is None or not self.is_closed:
            return model
        if not model.is_dense:
            raise OptionError(f"the loop through the law is looked at for up to {DENSE // SLOTS} rods and point masses")
        return replace(model, law=law.derivative(model, velocities, time))
