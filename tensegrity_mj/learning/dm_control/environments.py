"""Scenes as a dm_control Physics, and as Environments with rest lengths or force densities as actions."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import member, real_array
from tensegrity_mj.basics.fields import field, function_of, value
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco.settings import Integrator, MuJoCo
from tensegrity_mj.errors import OptionError
from tensegrity_mj.learning.dm_control.models import model
from tensegrity_mj.learning.dm_control.repairing import repair
from tensegrity_mj.learning.tasks.definition import RandomStart, Task, target_distance
from tensegrity_mj.learning.tasks.robots import task_of
from tensegrity_mj.model.actuation import whole_ratio
from tensegrity_mj.model.ropes import completed
from tensegrity_mj.model.scene import Scene

if TYPE_CHECKING:
    from dm_control.rl.control import Environment

    from tensegrity_mj.learning.dm_control.stepping import ScenePhysics
    from tensegrity_mj.learning.dm_control.tasks import Reward, Termination


OBSERVED = ("nodes", "velocities", "string_lengths", "rest_lengths", "tensions")


def physics(
    scene: Scene,
    timestep: float = 1e-3,
    integrator: Integrator = Integrator.RK4,
    command: Command = Command.REST_LENGTH,
) -> ScenePhysics:
    """A dm_control `Physics` of a scene, at the scene's start.

        physics = tensegrity_mj.learning.dm_control.physics(scene, timestep=5e-3)
        physics.set_control(rest_lengths - scene.structure.rest_lengths)     # [m]
        physics.step()

    It steps as the MuJoCo engine does with rest lengths (or force densities) held from step to step. Controls are
    changes of the strings' rest lengths [m] from the designed ones, or force densities [N/m] with
    `Command.FORCE_DENSITY`; `set_command` takes the rest lengths themselves. `reset()` goes back to the scene's start.

    Raises:
        OptionError: for a time step, an integrator or a command that is none.
        StructureError: for rods that share nodes, and for masses or sizes that MuJoCo cannot hold.
        SceneError: for supports that move, and for water that adds mass to rods.
    """
    options = MuJoCo(timestep, integrator)
    member("command", command, Command)
    options.model(scene)  # for its errors: dm_control's would not say what to do
    repair()
    from tensegrity_mj.learning.dm_control.stepping import ScenePhysics

    return ScenePhysics.of_scene(scene, command, ET.tostring(model(scene, command, options), encoding="unicode"))


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
    """A task of `learning.gymnasium` as dm_control plays it: the same limits, observations, reward and starts.

    An action is a rest length [m] a string. `env.task.terms(env.physics)` has the terms of the last reward.

    Args:
        task: SixBarRoll, PrismReach or SpineReach, or a `tensegrity_mj.learning.tasks.Task`.
        seed: of the whole sequence of episodes.

    Raises:
        OptionError: for a task that is none; on `step` and `reset` as `environment`.
    """
    found = task_of(task)
    start = found.start or RandomStart()
    return _environment_of(replace(found, start=replace(start, seed=seed)), None, None)


def _environment_of(task: Task, reward: Reward | None, termination: Termination | None) -> Environment:
    engine = task.engine
    made = physics(task.scene, engine.timestep, engine.integrator, task.action)
    from dm_control.rl.control import Environment

    from tensegrity_mj.learning.dm_control.tasks import TensegrityTask

    substeps = whole_ratio(task.period, engine.timestep, "control_timestep over timestep")
    # dm_control compares whole steps with a quotient; a little less than the last step keeps round-off out of it.
    limit = (task.steps - 0.5) * substeps * made.timestep()
    played = TensegrityTask(task, reward, termination)
    return Environment(made, played, time_limit=limit, n_sub_steps=substeps, legacy_step=True)


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
