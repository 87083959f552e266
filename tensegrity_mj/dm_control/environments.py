"""`environment`: a scene as a dm_control Environment, with rest lengths or force densities as actions; and its task."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from dm_control.rl import control
from dm_env import specs
from numpy.typing import ArrayLike

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import real_array
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.functions import function_of
from tensegrity_mj.dm_control.models import physics
from tensegrity_mj.dm_control.repairing import repair
from tensegrity_mj.dm_control.stepping import ScenePhysics, checked_command
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco.engine import MuJoCo
from tensegrity_mj.engines.mujoco.settings import Integrator
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.model.actuation import whole_ratio
from tensegrity_mj.model.ropes import completed
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.tasks.definition import RandomStart, State, Task, displace, target_distance
from tensegrity_mj.studies.tasks.robots import task_of

if TYPE_CHECKING:
    from dm_control.rl.control import Environment


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
        """The scene's start (the reset went there), or one near it, at which nothing overlaps that may touch.

        Raises:
            OptionError: where so many draws overlap that hardly any would not.
        """
        if self.start is not None:
            displace(physics.model.ptr, physics.data.ptr, self.scene, self.start, self._generator)
            physics.settle()
        self._goal, self._before = self.task.draw_goal(self._generator), None

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
        self._before = self.state(physics)
        physics.set_command(np.clip(values, self.low, self.high), self.period)

    def get_observation(self, physics: ScenePhysics) -> OrderedDict[str, Array]:
        """What the task observes, by its name; without another task nodes, velocities (N, 3), string_lengths,
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
        """The caller's reward, or the sum of the task's terms.

        Raises:
            OptionError: where the caller's is no finite number.
        """
        if self.reward is None:
            return sum(self.terms(physics).values())
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


OBSERVED = ("nodes", "velocities", "string_lengths", "rest_lengths", "tensions")


@value("", OptionError, positional=2, eq=False)
class SceneEnvironment:
    """A `dm_control.rl.control.Environment` of a scene, which is a `dm_env.Environment`.

    An action is one number a string: its rest length [m], held for the control step as a winch would hold it, or its
    force density [N/m], with L0 = L (1 - u/k) renewed at every stage as the string moves: the two hold modes of
    `Actuation`. Observations are `nodes` and `velocities` (N, 3), `string_lengths`, `rest_lengths` and `tensions` (M,),
    and where the scene has a target its `target` (N, 3) at the time. Limits of strings and winches are kept as engines
    keep them.

    Attributes:
        scene: the experiment. Its loads and elements are held over each physics step.
        action: what an action is.
        control_timestep: between two actions [s], a multiple of `timestep`.
        timestep: of the physics [s].
        integrator: of the physics.
        time_limit: of an episode [s], a multiple of `control_timestep`; the scene's duration by default. An episode
            that ends there has discount 1.
        bounds: least and greatest action, each a number or (M,). By default 0 to k for force densities; for rest
            lengths 0 to twice the largest of the designed one and the lengths at the start and at the targets; less
            where a string's `max_force_density` or `min_rest_length` leaves less.
        reward: of a control step, from its end. By default minus the mean distance [m] of the moving nodes from their
            targets.
        termination: discount in [0, 1] where the episode is to end, else None; called after each control step.
        start: random starts; every episode begins at the scene's start by default.

    Raises:
        OptionError: for options that are out of range or contradict each other, and for a scene without strings, or
            without a target where no reward is given.
        StructureError: for masses or sizes that MuJoCo cannot hold.
        ControllerError: on `step`, for an action that is not finite, not of the shape or not within the bounds.
        OptionError: on `reset`, where next to all random starts overlap what they may touch.
        PhysicsDivergence: on `step`; both a `DivergenceError` and dm_control's `PhysicsError`. `reset` begins anew.
    """

    scene: Scene = field(kinds.part(Scene, "a Scene, or load_scene(name or path)"))
    action: Command = field(kinds.choice(Command), default=Command.REST_LENGTH)
    control_timestep: float = field(kinds.positive("s"), default=0.01)
    timestep: float = field(kinds.positive("s"), default=1e-3)
    integrator: Integrator = field(kinds.choice(Integrator), default=Integrator.RK4)
    time_limit: float | None = field(kinds.positive("s"), none="None", default=None)
    bounds: tuple[ArrayLike, ArrayLike] | None = field(None, default=None)
    reward: Reward | None = field(None, default=None)
    termination: Termination | None = field(None, default=None)
    start: RandomStart | None = field(kinds.part(RandomStart), none="None", default=None)

    def __call__(self) -> Environment:
        scene, action, start = self.scene, self.action, self.start
        reward, termination = self.reward, self.termination
        timestep, control_timestep = self.timestep, self.control_timestep
        whole_ratio(control_timestep, timestep, "control_timestep over timestep")
        steps = whole_ratio(self.time_limit or scene.duration, control_timestep, "time_limit over control_timestep")
        if not scene.structure.strings:
            raise OptionError(f"scene '{scene.name}' has no strings: there is nothing to act with")
        if reward is None and scene.target is None:
            raise OptionError(f"scene '{scene.name}' has no target for the default reward: give one, or reward=")
        for name, function in (("reward", reward), ("termination", termination)):
            if function is not None and not callable(function):
                raise OptionError(f"{name} = {function!r}; it must be a function (scene, nodes, velocities, u)")
        for event in scene.breaks:
            whole_ratio(event.time, timestep, f"break of string '{event.string}' over timestep")
        low, high = _bounds(scene, action, self.bounds)
        observed = OBSERVED if scene.target is None else (*OBSERVED, "target")
        engine = MuJoCo(timestep, self.integrator)
        task = Task(scene, target_distance, low, high, observed, action, control_timestep, steps, engine, start)
        return _environment_of(task, reward, termination)


environment = function_of(SceneEnvironment)


def task_environment(task: str | Task, seed: int = 0) -> Environment:
    """A task of `tensegrity_mj.gymnasium` as dm_control plays it: the same limits, observations, reward and starts.

    An action is a rest length [m] a string. `env.task.terms(env.physics)` has the terms of the last reward.

    Args:
        task: SixBarRoll, PrismReach or SpineReach, or a `tensegrity_mj.studies.tasks.Task`.
        seed: of the whole sequence of episodes.

    Raises:
        OptionError: for a task that is none; on `step` and `reset` as `environment`.
    """
    found = task_of(task)
    start = found.start or RandomStart()
    return _environment_of(replace(found, start=replace(start, seed=seed)), None, None)


def _environment_of(task: Task, reward: Reward | None, termination: Termination | None) -> Environment:
    engine = task.engine
    model = physics(task.scene, engine.timestep, engine.integrator, task.action)
    repair()
    from dm_control.rl.control import Environment

    substeps = whole_ratio(task.period, engine.timestep, "control_timestep over timestep")
    # dm_control compares whole steps with a quotient; a little less than the last step keeps round-off out of it.
    limit = (task.steps - 0.5) * substeps * model.timestep()
    played = TensegrityTask(task, reward, termination)
    return Environment(model, played, time_limit=limit, n_sub_steps=substeps, legacy_step=True)


def _bounds(scene: Scene, action: Command, given: tuple[ArrayLike, ArrayLike] | None) -> tuple[Array, Array]:
    structure = scene.structure
    if given is None:
        least = np.zeros(len(structure.strings))
        if action is Command.REST_LENGTH:
            least = np.maximum(least, structure.limits("min_rest_length"))
        return least, np.maximum(_largest(scene, action), np.nextafter(least, np.inf))
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise OptionError(f"bounds = {given!r}; it must be a pair: the least action and the greatest")
    unit = "m" if action is Command.REST_LENGTH else "N/m"
    shape = (len(structure.strings),)
    low, high = (np.array(real_array("bounds", one, shape, unit)) for one in given)
    for string, least, greatest in zip(structure.strings, low, high, strict=True):
        if not 0 <= least < greatest:
            raise OptionError(
                f"bounds of string '{string.name}' = {least:g} to {greatest:g} {unit}; allowed: 0 <= least < greatest"
            )
    return low, high


def _largest(scene: Scene, action: Command) -> Array:
    structure = scene.structure
    if action is Command.FORCE_DENSITY:
        return np.minimum(structure.stiffness, structure.limits("max_force_density"))
    lengths = [structure.rest_lengths, structure.string_lengths(scene.nodes0)]
    if scene.target is not None:
        lengths.extend(structure.string_lengths(completed(structure, scene.target.nodes, structure.positions)))
    return np.asarray(2 * np.max(lengths, axis=0))
