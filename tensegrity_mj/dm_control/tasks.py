"""The task of a scene's environment: actions, observations, reward, end."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np
from dm_control.rl import control
from dm_env import specs

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dm_control.episodes import RandomStart, Reward, Termination
from tensegrity_mj.dm_control.stepping import ScenePhysics, checked_command
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.model.elements.contact import overlaps
from tensegrity_mj.model.scene import Scene

# How far outside its bounds an action may be, relative to their size: single precision, rounded.
ROUNDING = 1e-6
MOST_DRAWS = 100  # of a random start, before it is given up


class TensegrityTask(control.Task):  # type: ignore[misc]
    """See `environment`, which makes it from checked options."""

    def __init__(
        self,
        scene: Scene,
        action: Command,
        period: float,
        low: Array,
        high: Array,
        reward: Reward | None,
        termination: Termination | None,
        start: RandomStart | None,
    ) -> None:
        self.scene, self.action = scene, action
        self.period, self.low, self.high = period, low, high
        self.reward, self.termination, self.start = reward, termination, start
        self.names = [string.name for string in scene.structure.strings]
        self._generator = None if start is None else np.random.default_rng(start.seed)
        index = scene.structure.node_index
        self._moving = [row for name, row in index.items() if name not in scene.structure.fixed_nodes]

    def initialize_episode(self, physics: ScenePhysics) -> None:
        """The scene's start (the reset went there), or one near it, at which nothing overlaps that may touch.

        Raises:
            OptionError: where so many draws overlap that hardly any would not.
        """
        if self.start is None or self._generator is None:
            return
        still, inside = physics.turning_axially(), []
        for _ in range(MOST_DRAWS):
            drawn = self._generator.uniform(-1, 1, (2, len(still)))
            drawn[:, still] = 0.0  # no axial spin: it would only be round-off's
            physics.displace(self.start.displacement * drawn[0], self.start.speed * drawn[1])
            contact = self.scene.contact
            inside = [] if contact is None else overlaps(self.scene.structure, contact, physics.nodes())
            if not inside:
                return
            physics.reset()
        raise OptionError(
            f"{self.start}: {MOST_DRAWS} starts in a row overlap what they may touch; in the last {inside[0]}: draw "
            "smaller displacements, or begin farther away"
        )

    def action_spec(self, physics: ScenePhysics) -> specs.BoundedArray:
        """(M,), a number a string; its name lists the strings, with tabs between, as dm_control does."""
        return specs.BoundedArray((len(self.names),), np.float64, self.low, self.high, "\t".join(self.names))

    def before_step(self, action: Any, physics: ScenePhysics) -> None:
        """Set the action, kept within the limits of strings and winches.

        Raises:
            ControllerError: for a wrong shape, or a value that is not finite or not within the bounds.
        """
        values = checked_command(f"action ({self.action.value})", action, self.names)
        room = ROUNDING * np.maximum(np.abs(self.low), np.abs(self.high))
        outside = (values < self.low - room) | (values > self.high + room)
        if outside.any():
            m = int(np.argmax(outside))
            raise ControllerError(
                f"action ({self.action.value}) of string '{self.names[m]}' = {values[m]:.9g}; it must be within "
                f"{self.low[m]:.9g} and {self.high[m]:.9g}: clip it to the action spec, or give other bounds"
            )
        physics.set_command(np.clip(values, self.low, self.high), self.period)

    def get_observation(self, physics: ScenePhysics) -> OrderedDict[str, Array]:
        """nodes, velocities (N, 3), string_lengths, rest_lengths, tensions (M,); target (N, 3) if there is one."""
        observation = OrderedDict(
            nodes=physics.nodes(),
            velocities=physics.velocities(),
            string_lengths=physics.string_lengths(),
            rest_lengths=physics.rest_lengths(),
            tensions=physics.tensions(),
        )
        if self.scene.target is not None:
            observation["target"] = self.target(physics)
        return observation

    def target(self, physics: ScenePhysics) -> Array:
        """Target node positions (N, 3) [m] at the current time."""
        assert self.scene.target is not None
        return target_nodes(self.scene.structure, self.scene.target, np.array([physics.time()]))[0]

    def get_reward(self, physics: ScenePhysics) -> float:
        """The caller's reward, or minus the mean distance [m] of the moving nodes from their targets.

        Raises:
            OptionError: where the caller's is no finite number.
        """
        if self.reward is None:
            gaps = np.linalg.norm(physics.nodes() - self.target(physics), axis=1)
            return -float(np.mean(gaps[self._moving]))
        value, number = self._value_of(self.reward, physics)
        if not np.isfinite(number):
            raise OptionError(
                f"reward: it returned {value!r} at t = {physics.time():.6g} s; it must be a finite number"
            )
        return number

    def get_termination(self, physics: ScenePhysics) -> float | None:
        """The caller's discount, or None to go on.

        Raises:
            OptionError: where it is neither None nor a number in [0, 1].
        """
        value, discount = (None, np.nan) if self.termination is None else self._value_of(self.termination, physics)
        if value is None:
            return None
        if not 0 <= discount <= 1:
            raise OptionError(
                f"termination: it returned {value!r} at t = {physics.time():.6g} s; it must be None to go on, or the "
                "last discount, 0 to 1"
            )
        return discount

    def _value_of(self, function: Any, physics: ScenePhysics) -> tuple[Any, float]:
        """What a function of the caller's returns, and that as a number, NaN where it is none."""
        value = function(self.scene, physics.nodes(), physics.velocities(), physics.force_densities())
        try:
            return value, float(value)
        except (TypeError, ValueError):
            return value, np.nan
