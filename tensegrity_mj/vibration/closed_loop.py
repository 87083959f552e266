"""Linear model of a scene under a law: the commands at a state and, if the law is continuous, their derivative."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import NO_SOLUTION, Command, NativeLaw
from tensegrity_mj.dynamics.native.pointers import address_of
from tensegrity_mj.errors import InfeasibleError, OptionError
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.strings import force_density, rest_length
from tensegrity_mj.vibration.blocks import DENSE
from tensegrity_mj.vibration.bodies import SLOTS, Bodies
from tensegrity_mj.vibration.small_motions import LawDerivative, Vibration, vibration

if TYPE_CHECKING:
    from tensegrity_mj.dynamics.native.plant import Plant

LAW_STEP = 1e-5  # of the structure's size: a central difference's error is its square
# By the law's evaluation.
_WRITTEN = ("nodes", "velocities", "segment_lengths", "lengths", "rates", "command", "report")
_WAYS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])  # ahead and behind, of nodes and of velocities


class LawAtStates:
    """A law's commands as a function of the state, and their derivative."""

    def __init__(self, scene: Scene, native: NativeLaw, plant: Plant | None = None) -> None:
        """`plant`: one that is packed already for a run of the scene under the law, and is left as it is."""
        # Compiled functions: only where there is a law.
        from tensegrity_mj.dynamics.native.law_at_states import evaluate_at_states
        from tensegrity_mj.dynamics.native.plant import Plant

        self.native, self._commands = native, evaluate_at_states
        self._plant = Plant(scene, native, Actuation.continuous(), OnInfeasible.STOP) if plant is None else plant

    def __call__(self, time: float, states: Array) -> Array:
        """(K, M) force densities [N/m] or rest lengths [m] at states (K, 2, N, 3), nodes and velocities.

        Raises:
            InfeasibleError, ControllerError: what the law says at the first where it has none.
        """
        states, plant = np.ascontiguousarray(states), self._plant
        commands = np.empty((len(states), len(plant.scene.structure.strings)))
        before = {name: np.array(plant[name]) for name in _WRITTEN}
        try:
            status = int(self._commands(plant.address, time, len(states), address_of(states), address_of(commands)))
            plant.raise_if_failed(status, time)
            if status == NO_SOLUTION:
                raise InfeasibleError(plant.infeasible_message(time))
        finally:
            for name, values in before.items():
                plant[name][:] = values
        return commands

    def derivative(self, model: Vibration, velocities: Array, time: float) -> LawDerivative:
        """Compute the law's part of K and D at the state of a model, by central differences."""
        n, nodes = model.size, model.state.nodes
        size = float(np.ptp(nodes, axis=0).max(initial=0.0)) or 1.0
        units = model.motion(model.project(np.eye(n)).T)
        largest = np.abs(units).max(axis=(1, 2), initial=0.0)
        moving = np.flatnonzero(largest > 0)
        h = LAW_STEP * size / largest[moving]
        moved = h[:, None, None] * units[moving]
        states = np.array([nodes, velocities]) + _WAYS[:, None, :, None, None] * moved[:, None]
        commands = self(time, states.reshape(4 * len(moving), 2, *nodes.shape))
        ahead, behind = commands.reshape(2, 2, len(moving), len(model.taut)).swapaxes(0, 1)
        slopes = np.zeros((2, len(model.taut), n))
        slopes[:, :, moving] = ((ahead - behind) / (2 * h[:, None])).swapaxes(1, 2)
        paths = model.scene.structure.paths
        # Derivative of the lengths by y: its transpose takes tensions to forces.
        stretch = paths.total(np.einsum("mx,nmx->mn", model.state.segments.directions, paths.spans(units)), axis=0)
        if self.native.command is Command.FORCE_DENSITY:
            weight = np.where(model.taut, model.state.lengths, 0.0)
        else:
            weight = -np.where(model.taut, model.stiffness, 0.0)
        push = (stretch * weight[:, None]).T
        return LawDerivative(push @ slopes[0], push @ slopes[1])


@dataclass(frozen=True, eq=False)
class Loop:
    """A scene and the law that sets its strings; `at` gives the linear model of a state.

    Attributes:
        scene: the scene that moves.
        bodies: of its structure.
        law: sets rest lengths or force densities; None for constant rest lengths.
        mode: of the actuation.
    """

    scene: Scene
    bodies: Bodies
    law: LawAtStates | None
    mode: Mode

    @property
    def is_closed(self) -> bool:
        """True where the law follows small motions: it is continuous, and not held."""
        return self.law is not None and self.mode is Mode.CONTINUOUS

    def at(self, nodes: Array, velocities: Array, rest_lengths: Array | None, time: float) -> Vibration:
        """The model about a state (N, 3) [m], [m/s], with rest lengths (M,) [m]; None for those that the law sets.

        Raises:
            OptionError: where the loop through the law is too large.
            InfeasibleError, ControllerError: what the law says at the state.
        """
        structure, law = self.scene.structure, self.law
        broken = self.scene.break_times <= time
        densities = None
        rest = structure.rest_lengths if rest_lengths is None else rest_lengths
        if law is not None:
            command = law(time, np.array([[nodes, velocities]]))[0]
            lengths = structure.string_lengths(nodes)
            sets_densities = law.native.command is Command.FORCE_DENSITY
            if rest_lengths is None:
                rest = rest_length(structure.curves, lengths, command) if sets_densities else command
            if (sets_densities and self.is_closed) or self.mode is Mode.HOLD_FORCE_DENSITY:
                k = structure.stiffness
                linear = structure.curves.linear
                densities = k * (1 - rest / lengths) if linear else force_density(structure.curves, lengths, rest)
                densities = np.maximum(0.0, densities)
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
            raise OptionError(f"the loop through the law is checked for up to {DENSE // SLOTS} rods and point masses")
        return replace(model, law=law.derivative(model, velocities, time))
