"""The task of a scene's environment: actions, observations, reward, end."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
from dm_control.rl import control
from dm_env import specs

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.learning.dm_control.stepping import ScenePhysics, checked_command
from tensegrity_mj.learning.tasks.definition import State, Task, displace
from tensegrity_mj.model.scene import Scene

# How far outside its bounds an action may be, relative to their size: single precision, rounded.
ROUNDING = 1e-6
# (scene, nodes (N, 3), velocities (N, 3), force densities (M,)) after a control step.
Reward = Callable[[Scene, Array, Array, Array], float]
Termination = Callable[[Scene, Array, Array, Array], float | None]


class TensegrityTask(control.Task):  # type: ignore[misc]
    """A task as dm_control plays it; see `environment`, which makes it from checked options.

    Args:
        task: what is commanded and observed, the reward, the start.
        reward: in place of the task's.
        termination: see `environment`.
    """

    def __init__(self, task: Task, reward: Reward | None = None, termination: Termination | None = None) -> None:
        self.task, self.scene, self.action = task, task.scene, task.action
        self.period, self.low, self.high = task.period, task.low, task.high
        self.reward, self.termination, self.start = reward, termination, task.start
        self.names = [string.name for string in task.scene.structure.strings]
        self._generator = np.random.default_rng(None if task.start is None else task.start.seed)
        self._goal = np.zeros(3)
        self._before: State | None = None

    def initialize_episode(self, physics: ScenePhysics) -> None:
        """Set the scene's start (the reset went there), or one near it, at which nothing overlaps that may touch.

        Raises:
            OptionError: where so many draws overlap that hardly any would not.
        """
        if self.start is not None:
            displace(physics.model.ptr, physics.data.ptr, self.scene, self.start, self._generator)
            physics.settle()
        self._goal, self._before = self.task.draw_goal(self._generator), None

    def action_spec(self, physics: ScenePhysics) -> specs.BoundedArray:
        """Specification of actions (M,), one per string; its name lists the strings, separated by tabs."""
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
        self._before = self.state(physics)
        physics.set_command(np.clip(values, self.low, self.high), self.period)

    def get_observation(self, physics: ScenePhysics) -> OrderedDict[str, Array]:
        """Observations of the task by their names; without another task nodes, velocities (N, 3), string_lengths,
        rest_lengths, tensions (M,), and target (N, 3) if there is one."""
        return OrderedDict((name, part[0]) for name, part in self.task.observe(self.state(physics)).items())

    def state(self, physics: ScenePhysics) -> State:
        """The robot now, the only one of n."""
        velocities, before = physics.velocities(), self._before
        seen = physics.string_lengths(), physics.rest_lengths(), physics.tensions()
        rates = 0 * velocities if before is None else (velocities - before.velocities[0]) / self.period
        parts = (np.array(physics.time()), physics.nodes(), velocities, *seen, rates, self._goal)
        return State(*(part[None] for part in parts))

    def target(self, physics: ScenePhysics) -> Array:
        """Target node positions (N, 3) [m] at the current time."""
        return self.task.targets(self.state(physics))[0]

    def terms(self, physics: ScenePhysics) -> dict[str, float]:
        """The terms of the task's reward for the last control step."""
        after = self.state(physics)
        terms = self.task.scored(after if self._before is None else self._before, after)
        return {name: float(term[0]) for name, term in terms.items()}

    def get_reward(self, physics: ScenePhysics) -> float:
        """The caller's reward, or the sum of the task's terms; raise OptionError for one that is no finite number."""
        if self.reward is None:
            return sum(self.terms(physics).values())
        value, number = self._value_of(self.reward, physics)
        if not np.isfinite(number):
            raise OptionError(
                f"reward: it returned {value!r} at t = {physics.time():.6g} s; it must be a finite number"
            )
        return number

    def get_termination(self, physics: ScenePhysics) -> float | None:
        """The caller's discount, or None to go on; raise OptionError for one that is neither None nor in [0, 1]."""
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
        """Call a function of the caller's; return its value, and that as a number, NaN where it is none."""
        value = function(self.scene, physics.nodes(), physics.velocities(), physics.force_densities())
        try:
            return value, float(value)
        except (TypeError, ValueError):
            return value, np.nan
