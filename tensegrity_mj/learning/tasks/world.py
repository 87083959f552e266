"""A task played by many robots at once, each in an episode of its own: start, observe, act, reward, end; its error.

`Fleet` steps the robots. A member is a run as `simulate` makes it, with its rest lengths commanded and held
(`Actuation.hold_rest_length`), by the same compiled code. It records nothing and keeps no ledger: its state is read
from the batch after each period.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import SimulationError
from numpy.typing import ArrayLike, NDArray

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known, checked, real_array, sequence_of
from tensegrity_mj.basics.kinds import whole
from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.controllers.replay import Replay, cubics
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.engines.mujoco import ensemble, install, many, run_view, settings
from tensegrity_mj.engines.reference.dae import DAE
from tensegrity_mj.engines.request import Request
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.engines.table import engine_settings
from tensegrity_mj.errors import ControllerError, OptionError
from tensegrity_mj.learning.tasks.definition import LONGEST, RandomStart, State, Task, displace, substeps
from tensegrity_mj.learning.tasks.robots import task_of
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.model.capabilities import refusal
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.simulation import simulate
from tensegrity_mj.studies.parameter_values import Draw, decoded, number_from, once
from tensegrity_mj.studies.parameters import Draft
from tensegrity_mj.studies.scene_parameters import single_draws

ACTIONS = ("length", "speed")
MOST_ROBOTS = 100_000  # each has some 50 kB in MuJoCo
LARGEST = 1e6  # of what is observed, in its unit: no robot that has not diverged comes near it
Ids = NDArray[np.int64]


@dataclass(frozen=True)
class Outcome:
    """Outcome of a control period, a row for each robot that made it.

    Attributes:
        observation: (n, size) float32.
        reward: (n,), the sum of the terms.
        terms: (n,) each.
        diverged: (n,) whether the simulation was lost; the reward is 0 then, and the episode over.
        truncated: (n,) whether the episode has all its control periods.
    """

    observation: Array
    reward: Array
    terms: Mapping[str, Array]
    diverged: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class World:
    """Robots that play a task, each any number of times.

    Args:
        task: a Task, or the name of one.
        count: number of robots.
        action: "length": an action is a rest length between `low` (-1) and `high` (1) of the task; "speed": the speed
            of a winch, between as fast in (-1) and as fast out (1) as it can.
        parameters, draws: see `Variations`; the draws are made anew for each episode.
        threads: 0 for as many as there are cores. The results do not depend on it.
        max_episode_steps: control periods of an episode; the task's by default, -1 for no end.

    Attributes:
        slices: where each part of an observation stands, by its name.
        steps: (n,) control periods since each robot started.
        drawn: names of what is drawn for each episode. Where it is empty, all seeds give the same episode.

    Raises:
        OptionError: for options that are out of range, and scenes that MuJoCo cannot step many of.
    """

    def __init__(
        self,
        task: str | Task,
        count: int = 1,
        *,
        action: str = "length",
        parameters: Mapping[str, Any] | None = None,
        draws: Sequence[Draw] = (),
        threads: int = 0,
        max_episode_steps: int | None = None,
    ) -> None:
        self.task = task = task_of(task)
        if task.action is not Command.REST_LENGTH:
            raise OptionError(
                f"task: action = {task.action}; here winches are commanded by Command.REST_LENGTH, and force densities "
                "by dm_control's `environment`"
            )
        check_known("action", action, ACTIONS, "kind of action")
        most = task.steps if max_episode_steps is None else max_episode_steps
        endless = isinstance(most, int) and most == -1
        self._most: int = LONGEST if endless else checked("max_episode_steps", most, whole(1, LONGEST))
        self.count: int = checked("number of robots", count, whole(1, MOST_ROBOTS))
        self.variations = Variations(task, parameters, draws)
        start, goal = task.start, task.goal
        found = {"start": start and (start.displacement or start.speed), "goal": goal and any(goal.reach)}
        self.drawn = [name for name, drawn in found.items() if drawn] + [one.parameter for one in self.variations.draws]
        scene, engine = self.variations.base.scene, self.variations.engine
        require(engine, scene, "simulate_many")
        speed = scene.structure.limits("winch_speed")
        if action == "speed" and not np.all(np.isfinite(speed)):
            name = scene.structure.strings[int(np.argmax(np.isinf(speed)))].name
            raise OptionError(f"action = 'speed': the winch of string '{name}' has no winch_speed; give it one")
        self._stroke = speed * task.period if action == "speed" else None
        self.fleet = Fleet(scene, engine, task.period, self.count, checked("threads", threads, whole(0, 1024)))
        M, N = len(scene.structure.strings), len(scene.structure.nodes)
        self.steps = np.zeros(self.count, np.int64)
        self._noise, self._delay = np.zeros((self.count, 2)), np.zeros(self.count, np.int64)
        self._queue = np.zeros((self.count, 1, M))  # what was commanded, the latest first
        self._generators: list[Any] = [None] * self.count
        zeros = np.zeros((self.count, M))
        nodes = np.zeros((self.count, N, 3))
        self._states = State(np.zeros(self.count), nodes, nodes, zeros, zeros, zeros, nodes, np.zeros((self.count, 3)))
        self._states = State(**{name: np.array(part) for name, part in vars(self._states).items()})
        parts = task.observe(replace(self._states, nodes=np.array([scene.nodes0] * self.count)))
        ends = np.cumsum([part[0].size for part in parts.values()])
        self.slices = {
            name: slice(int(end) - part[0].size, int(end))
            for (name, part), end in zip(parts.items(), ends, strict=True)
        }
        self.size = int(ends[-1])

    def start(self, ids: Ids, generators: Sequence[np.random.Generator]) -> Array:
        """Let these robots start anew, with draws of their generators; return their observations (n, size).

        Raises:
            OptionError, StructureError, SceneError: where a draw makes no scene, or no start is found.
        """
        goals = []
        for number, generator in zip(ids.tolist(), generators, strict=True):
            self._generators[number] = generator
            varied = self.variations.draw(generator)
            self.fleet.start(number, varied.scene, self.task.start, generator)
            goals.append(self.task.draw_goal(generator))
            self._delay[number] = varied.delay
            self._noise[number] = varied.position_noise, varied.velocity_noise
        if len(ids):
            more = max(0, int(self._delay.max()) + 1 - self._queue.shape[1])
            self._queue = np.pad(self._queue, ((0, 0), (0, more), (0, 0)))
            self._queue[ids] = self.fleet.commands[ids, None]
            self.steps[ids] = 0
            seen = self.fleet.look(ids, fresh=True)
            self._keep(ids, State(np.zeros(len(ids)), **seen, accelerations=0 * seen["nodes"], goal=np.array(goals)))
        return self._observed(ids)

    def step(self, ids: Ids, actions: Array) -> Outcome:
        """Make a control period of these robots under actions (n, M), which are clipped to [-1, 1].

        Raises:
            ControllerError: for actions of another shape, or that are not finite.
            OptionError: for a reward that is none.
        """
        task, before = self.task, self._of(ids)
        names = [string.name for string in task.scene.structure.strings]
        if actions.shape != (len(ids), len(names)) or not np.isfinite(actions).all():
            raise ControllerError(
                f"action = {actions}; it must be {len(names)} finite numbers, one for each of the strings "
                f"{', '.join(names)}"
            )
        if self._stroke is None:
            wanted = task.commanded(actions)
        else:
            wanted = np.clip(self._queue[ids, 0] + np.clip(actions, -1, 1) * self._stroke, task.low, task.high)
        self._queue[ids] = np.concatenate([wanted[:, None], self._queue[ids, :-1]], axis=1)
        self.fleet.commands[ids] = self._queue[ids, self._delay[ids]]
        diverged = self.fleet.advance(ids)
        self.steps[ids] += 1
        seen = self.fleet.look(ids)
        with np.errstate(over="ignore", invalid="ignore"):  # of those that diverged
            means = (seen["velocities"] - before.velocities) / task.period
            after = State(self.steps[ids] * task.period, **seen, accelerations=means, goal=before.goal)
            terms = task.scored(before, after, diverged)
            self._keep(ids, after)
            reward = sum(terms.values(), np.zeros(len(ids)))
            return Outcome(self._observed(ids), reward, terms, diverged, self.steps[ids] >= self._most)

    def state(self, ids: Ids | None = None) -> State:
        """State of the robots now, without noise."""
        return self._of(np.arange(self.count) if ids is None else ids)

    def _of(self, ids: Ids) -> State:
        return State(**{name: part[ids] for name, part in vars(self._states).items()})

    def _keep(self, ids: Ids, state: State) -> None:
        for name, part in vars(state).items():
            getattr(self._states, name)[ids] = part

    def _observed(self, ids: Ids) -> Array:
        state = self._of(ids)
        if self._noise[ids].any():
            moving = self.task.moving
            for row, number in enumerate(ids):
                drawn = self._generators[number].standard_normal((2, len(moving), 3))
                state.nodes[row, moving] += self._noise[number, 0] * drawn[0]
                state.velocities[row, moving] += self._noise[number, 1] * drawn[1]
        parts = [part.reshape(len(ids), math.prod(part.shape[1:])) for part in self.task.observe(state).values()]
        return np.clip(np.nan_to_num(np.concatenate(parts, axis=1)), -LARGEST, LARGEST).astype(np.float32)


# What else may vary, by its field: control periods until a command is taken up, and standard deviations of measured
# nodes and their velocities [m], [m/s], as of `controllers.Delayed` and `Noisy`.
LOOP = {"delay": "delay", "noise.position": "position_noise", "noise.velocity": "velocity_noise"}

SETTINGS = kinds.mapping(kinds.text(), kinds.Kind(lambda one: one), "a mapping of paths to values", "parameter")


@dataclass(frozen=True)
class Variation:
    """One episode's scene and loop (see LOOP)."""

    scene: Scene
    delay: int = 0
    position_noise: float = 0.0
    velocity_noise: float = 0.0


class Variations:
    """Parameters that are fixed, and those that are drawn anew for each episode.

    Args:
        task: to begin with.
        parameters: path -> value: structure..., scene... and engine... as in a sweep, and those of LOOP.
        draws: of the same, but for the engine's.

    Raises:
        OptionError: for paths that name nothing here, values that they cannot have, and parameters given twice.
    """

    def __init__(self, task: Task, parameters: Mapping[str, Any] | None, draws: Sequence[Draw]) -> None:
        scene, settings = task.scene, checked("parameters", {} if parameters is None else parameters, SETTINGS)
        draws = sequence_of("draws", draws)
        for draw in draws:
            if not isinstance(draw, Draw):
                raise OptionError(f"draws holds {draw!r}; use Draw(parameter, distribution)")
        self.draws = single_draws(scene, draws)
        given = [*settings, *(draw.parameter for draw in self.draws)]
        for number, path in enumerate(given):
            roots = ("structure", "scene", "engine")[: 3 if number < len(settings) else 2]
            if path not in LOOP and str(path).partition(".")[0] not in roots:
                known = (*(f"{root}...." for root in roots), *LOOP)
                raise OptionError(f"parameter {path!r}: {unknown(str(path), known, 'parameter of an environment')}")
        once(given)
        of_engine = {path: settings.pop(path) for path in list(settings) if path.startswith("engine")}
        name, options = engine_settings(task.engine)
        self.engine: Any = Draft(scene, engine=name, engine_options=options).apply(of_engine).make_engine()
        self.base = Variation(scene)
        self.base = self._made(settings)

    def draw(self, generator: np.random.Generator) -> Variation:
        """Draw the scene and the loop of the next episode."""
        if not self.draws:
            return self.base
        return self._made({draw.parameter: draw.sample(generator) for draw in self.draws})

    def _made(self, settings: Mapping[str, Any]) -> Variation:
        varied, of_scene = self.base, dict(settings)
        for path in LOOP.keys() & settings.keys():
            value = number_from(path, decoded(of_scene.pop(path)), getattr(varied, LOOP[path]))
            if value < 0 or (path == "delay" and value != round(value)):
                need = "a whole number of control periods >= 0" if path == "delay" else "a number >= 0"
                raise OptionError(f"{path} = {value:g}; it must be {need}")
            varied = replace(varied, **{LOOP[path]: type(getattr(varied, LOOP[path]))(value)})
        return replace(varied, scene=Draft(varied.scene).apply(of_scene).scene) if of_scene else varied


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
            OptionError: for a scene of another layout; as `displace`.
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


FINER = 16  # the step of the reference in a scene with contact that the DAE does not have


def measured_error(
    task: str | Task, episodes: int = 3, steps: int | None = None, seed: int = 0, actions: ArrayLike | None = None
) -> dict[str, Any]:
    """Measure how far nodes are from a fine reference, from starts drawn as the task has them.

    The reference is the DAE at tolerances of 1e-10, or where it refuses the scene MuJoCo with RK4 and a step 16 times
    as short.

    Args:
        task: a task, or the name of one.
        episodes: how many.
        steps: control periods of each; the task's by default.
        seed: of the first episode; the next has the next.
        actions: (steps, M) in [-1, 1], such as those of a policy; drawn evenly in each period by default.

    Returns:
        `largest` and `mean`: distance of a node [m] over nodes, times and episodes; `after_1_s`: the largest up to 1 s;
        `reference`, `episodes`, `seconds`: what they are of.

    Raises:
        OptionError: for a task that is none; as `simulate`.
    """
    task = task_of(task)
    M = len(task.low)
    given = None if actions is None else real_array("actions", actions, (np.shape(actions)[0], M), scalar=False)
    count = task.steps if steps is None else checked("steps", steps, whole(1))
    count = count if given is None else len(given)
    engine: Any = DAE(rtol=1e-10, atol=1e-10)
    if refusal(engine, task.scene) is not None:
        engine = settings.MuJoCo(task.engine.timestep / FINER)
    times = np.arange(count + 1) * task.period
    found = []
    for number in range(checked("episodes", episodes, whole(1))):
        generator, world = np.random.default_rng(seed + number), World(task, threads=1)
        only = np.zeros(1, np.int64)
        world.start(only, [generator])
        states, commands = [world.state()], []
        for step in range(count):
            world.step(only, generator.uniform(-1, 1, (1, M)) if given is None else given[step : step + 1])
            states.append(world.state())
            commands.append(world.fleet.commands[0].copy())
        start = {"initial_nodes": states[0].nodes[0], "initial_velocities": states[0].velocities[0]}
        run = simulate(
            task.scene.with_(**start),
            Replay(times, [*commands, commands[-1]], held=True, period=task.period),
            engine,
            duration=float(times[-1]),
            actuation=Actuation.hold_rest_length(task.period),
            output_interval=task.period,
        )
        found.append(np.linalg.norm(np.array([state.nodes[0] for state in states]) - run.nodes, axis=2))
    gaps = np.array(found)
    return {
        "largest": float(gaps.max()),
        "mean": float(gaps.mean()),
        "after_1_s": float(gaps[:, times <= 1.0 + 1e-9].max()),
        "reference": str(engine),
        "episodes": len(gaps),
        "seconds": float(times[-1]),
    }
