"""Readings of MuJoCo's arrays in the scene's own terms: nodes, strings, forces. Pure functions over arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco.mjcf import UNLIMITED
from tensegrity_mj.errors import ElementError, OptionError
from tensegrity_mj.model import strings
from tensegrity_mj.model.elements.element import acted
from tensegrity_mj.model.events import NodalLoads
from tensegrity_mj.model.scene import Scene


def point_velocities(model: Any, data: Any, bodies: Any, points: Array) -> Array:
    """Velocities (N, 3) [m/s] of points (N, 3) that are fixed to the bodies (N,), in the world frame.

    MuJoCo's cvel is (ω, v) at the centre of mass of the body's kinematic tree.
    """
    spatial = data.cvel[bodies]
    arms = points - data.subtree_com[model.body_rootid[bodies]]
    return np.asarray(spatial[:, 3:] + np.cross(spatial[:, :3], arms))


class Strings(NamedTuple):
    """State of the strings: controls, lengths and rates (M,); those that break until `time` [s] are broken."""

    ctrl: Array
    lengths: Array
    rates: Array
    time: float


class StringActuators:
    """The strings' actuators of one command: what their controls mean, and what keeps them true to the string law."""

    def __init__(self, scene: Scene, command: Command, timestep: float) -> None:
        structure = scene.structure
        self.command, self.designed_lengths = command, structure.rest_lengths
        self.k, self.c = structure.stiffness, structure.damping
        self._largest_u = structure.limits("max_force_density")
        self._least_length = structure.limits("min_rest_length")
        self._winch_speed = structure.limits("winch_speed")
        self._clipped = structure.clipped
        # What a taut string may push with, by its own damper.
        self._most = np.where(self._clipped | (self.c == 0), 0.0, UNLIMITED)
        # A break is due at the step that begins then; MuJoCo's time is a sum with its roundings.
        times = {event.string: event.time - 1e-3 * timestep for event in scene.breaks}
        self._breaks = np.array([times.get(string.name, np.inf) for string in structure.strings])
        # Otherwise the force limits in the model are all that a slack string needs.
        self.needs_limits = bool(np.any(self.c > 0) or scene.breaks)

    def control(self, command: Array, at: Strings, period: float | None) -> Array:
        """Controls of rest lengths [m], or of force densities [N/m], kept within what strings and winches can do.

        Engines keep a law's likewise, see docs/laws.md. `at` is in force until now; `period` [s] is how long the
        command will hold, None to pass over winch speeds.
        """
        if self.command is Command.FORCE_DENSITY:
            return np.minimum(np.minimum(command, self._largest_u), self.k * (1 - self._least_length / at.lengths))
        kept = np.maximum(np.maximum(command, self._least_length), at.lengths * (1 - self._largest_u / self.k))
        if period is not None:
            rest, reach = self.rest_lengths(at), self._winch_speed * period
            kept = np.clip(kept, rest - reach, rest + reach)
        return np.asarray(kept - self.designed_lengths)

    def rest_lengths(self, at: Strings) -> Array:
        """Rest lengths L0 (M,) [m]."""
        if self.command is Command.REST_LENGTH:
            return np.asarray(self.designed_lengths + at.ctrl)
        return strings.rest_length(self.k, at.lengths, at.ctrl)

    def force_densities(self, at: Strings) -> Array:
        """Force densities u (M,) [N/m]: the elastic part of the tension over the length."""
        u = at.ctrl if self.command is Command.FORCE_DENSITY else self.k * (1 - self.rest_lengths(at) / at.lengths)
        return np.where(self._idle(at), 0.0, u)

    def _idle(self, at: Strings) -> NDArray[np.bool_]:
        """Mask (M,) of the strings that carry nothing: they are broken, or not longer than at rest."""
        slack = at.ctrl <= 0.0 if self.command is Command.FORCE_DENSITY else at.lengths <= self.rest_lengths(at)
        return np.asarray(slack | (self._breaks <= at.time))

    def tensions(self, at: Strings) -> Array:
        """Tensions T (M,) [N], dampers included."""
        total = self.force_densities(at) * at.lengths + self.c * at.rates
        total = np.where(self._clipped, np.maximum(0.0, total), total)
        return np.where(self._idle(at), 0.0, total)

    def force_limits(self, at: Strings) -> Array:
        """Limits (M, 2) of the actuators' forces [N]: none for an idle string, whose damper must not act either."""
        idle = self._idle(at)
        return np.column_stack([np.where(idle, 0.0, -UNLIMITED), np.where(idle, 0.0, self._most)])

    def designed(self, lengths: Array) -> Array:
        """Controls (M,) of the structure as designed, at the given lengths."""
        if self.command is Command.REST_LENGTH:
            return np.zeros(len(lengths))
        return strings.force_density(self.k, lengths, self.designed_lengths)


class HeldForces:
    """Forces on a scene's nodes, as controls of the actuators there, held over each physics step.

    They are of the state and time in the middle of a step with RK4, and at its beginning with the other integrators, as
    in the MuJoCo engine. With RK4 the error is of the second order in the step where forces depend on time and
    positions alone, and of the first where they depend on velocities, which are those of the step's beginning.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.effects = scene, scene.effects
        self.rows = np.array([scene.structure.node_index[name] for name in pushed_nodes(scene)], np.int64)

    def __len__(self) -> int:
        return 3 * len(self.rows)

    def controls(self, time: float, option: Any, nodes: Array, velocities: Array) -> Array:
        """Controls of the actuators [N] for the step that begins at a time [s], and at nodes (N, 3) [m] and [m/s].

        `option` is that of the MjModel, with its step and its integrator.

        Raises:
            OptionError: where the scene's load function fails or returns something else than finite (N, 3).
            ElementError: where an element does.
        """
        half = 0.5 * option.timestep * (option.integrator == mujoco.mjtIntegrator.mjINT_RK4)
        at, places = time + half, nodes + half * velocities
        forces = np.zeros_like(nodes)
        for element in self.effects:
            try:
                forces += acted(element, self.scene, at, places, velocities)
            except Exception as error:
                cause = f"failed near t = {at:.6g} s: {type(error).__name__}: {error}"
                if isinstance(element, NodalLoads):
                    raise OptionError(f"loads: the function {cause}") from error
                raise ElementError(f"element {element.label} {cause}") from error
        return forces[self.rows].ravel()


def pushed_nodes(scene: Scene) -> list[str]:
    """Nodes that forces may act on: those with loads, or all that move, where loads are a function or elements act."""
    names = [name for name in scene.structure.node_names if name not in scene.structure.fixed_nodes]
    if callable(scene.loads) or any(not isinstance(element, NodalLoads) for element in scene.effects):
        return names
    loaded = {load.node for load in scene.loads}
    return [name for name in names if name in loaded]
