"""Definition of a task: a scene, commands, observations, a reward in terms, a start and a goal. No learning library.

Episodes begin at the scene's start, or at random near it, in all ways that rods and supports allow.

Arrays have a leading axis: n robots at once; dm_control has one. SI units, world frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known, real_array
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import not_negative, whole
from tensegrity_mj.basics.texts import value_text
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.engines.mujoco.contact import spins
from tensegrity_mj.engines.mujoco.mjcf_tree import place
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import whole_ratio
from tensegrity_mj.model.elements.contact import overlaps
from tensegrity_mj.model.rods import centre_of_mass
from tensegrity_mj.model.scene import Scene

MOST_DRAWS = 100  # of a random start, before it is given up


@value("RandomStart", OptionError)
class RandomStart:
    """Episodes that start near the scene's start, drawn evenly and in all ways that rods and supports allow.

    In a scene with contact, starts at which something overlaps are drawn anew. No rod spins about its own axis. Tasks
    refuse scenes whose rods close loops, or whose nodes are held by linear constraints: a draw would tear them open.

    Attributes:
        displacement: largest shift and turn of each degree of freedom [m, rad], >= 0.
        speed: largest change of its velocity [m/s, rad/s], >= 0.
        seed: of the whole sequence of episodes, where nothing else seeds them.
    """

    displacement: float = field(not_negative(), default=0.0)
    speed: float = field(not_negative(), default=0.0)
    seed: int = field(whole(0), default=0)


def displace(model: Any, data: Any, scene: Scene, start: RandomStart, generator: np.random.Generator) -> None:
    """Move MjData from the scene's start to one near it, at which nothing overlaps that may touch.

    The draw is in MuJoCo's degrees of freedom, so that rods keep their lengths and their supports.

    Raises:
        OptionError: where so many draws overlap that hardly any would not.
    """
    qpos, qvel = np.array(data.qpos), np.array(data.qvel)
    sites = [model.site(name).id for name in scene.structure.node_names]
    inside: list[str] = []
    still = spins(scene.structure, model)
    for _ in range(MOST_DRAWS):
        drawn = generator.uniform(-1, 1, (2, model.nv))
        drawn[:, still] = 0.0  # no axial spin: it would only be round-off's
        data.qpos[:] = qpos
        mujoco.mj_integratePos(model, data.qpos, start.displacement * drawn[0], 1.0)
        data.qvel[:] = qvel + start.speed * drawn[1]
        if scene.structure.class_number > 1:  # rods that hang on others turn with them, about their own axes, too
            place(data, scene, *node_states(model, data, sites))
        if scene.contact is None:
            return
        mujoco.mj_kinematics(model, data)
        inside = overlaps(scene.structure, scene.contact, np.array(data.site_xpos[sites]))
        if not inside:
            return
    raise OptionError(
        f"{start}: {MOST_DRAWS} starts in a row overlap what they may touch; in the last {inside[0]}: draw "
        "smaller displacements, or begin farther away"
    )


def node_states(model: Any, data: Any, sites: list[int]) -> tuple[Array, Array]:
    """Positions [m] and velocities [m/s] of sites (N, 3), of the joints as they are."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)
    found = np.zeros((len(sites), 6))
    for row, site in zip(found, sites, strict=True):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, row, 0)
    return np.array(data.site_xpos[sites]), found[:, 3:]


LONGEST = 2**40  # control periods of an episode
MOST_SUBSTEPS = 1_000_000  # of the engine in a control period, which nothing interrupts: seconds


@dataclass(frozen=True)
class State:
    """Robots at the end of a control period.

    Attributes:
        time: (n,) [s] since the episodes began.
        nodes, velocities: (n, N, 3) [m], [m/s].
        lengths, rest_lengths, tensions: of strings (n, M) [m], [m], [N].
        accelerations: of nodes (n, N, 3) [m/s²], the mean over the period; zero at the start.
        goal: (n, 3) [m]; zeros where the task has none.
    """

    time: Array
    nodes: Array
    velocities: Array
    lengths: Array
    rest_lengths: Array
    tensions: Array
    accelerations: Array
    goal: Array


@value("Goal", OptionError)
class Goal:
    """A place that is drawn for each episode, evenly from a box, for the middle of some nodes.

    Attributes:
        nodes: their names.
        reach: half the sides of the box [m], about where the middle is by design.
    """

    nodes: tuple[str, ...] = field(kinds.names("node"))
    reach: tuple[float, float, float] = field(
        kinds.each("three numbers >= 0 [m]", **dict.fromkeys("xyz", kinds.not_negative("m")))
    )


@value("task", OptionError, eq=False)
class Task:
    """Task for a robot, in episodes of a number of control periods.

    Episodes differ where something is drawn for them: `start`, `goal`, and the draws of a `World`. Without any of these
    every episode begins exactly at the scene's start, with any seed.

    Attributes:
        scene: robot and surroundings.
        terms: reward of a control period by names, (n,) or one number each, from the states before and after it; they
            are summed.
        low, high: limits of what is commanded, (M,) or one number: rest lengths [m], or force densities [N/m].
        observed: names of READERS, in order.
        action: what is commanded.
        period: between two commands [s], a multiple of the engine's step.
        steps: periods in an episode, which is truncated after them.
        engine: step and integrator.
        start: random starts.
        goal: what is drawn for each episode.
        measured_error: as `measured_error` of this task gave it.

    Raises:
        OptionError: naming the argument that is out of range, or does not fit the scene.
    """

    scene: Scene = field(kinds.part(Scene, "a Scene, or load_scene(name or path)"))
    terms: Callable[[Task, State, State], Mapping[str, Any]] = field(kinds.function("task, before, after"))
    low: Array = field(kinds.array("(M,)"))
    high: Array = field(kinds.array("(M,)"))
    observed: tuple[str, ...] = field(kinds.names("part of an observation"))
    action: Command = field(kinds.choice(Command), default=Command.REST_LENGTH)
    period: float = field(kinds.positive("s"), default=0.1)
    steps: int = field(kinds.whole(1, LONGEST), default=100)
    engine: MuJoCo = field(kinds.part(MuJoCo), factory=MuJoCo)
    start: RandomStart | None = field(kinds.part(RandomStart), default=None, none="None for the scene's start")
    goal: Goal | None = field(kinds.part(Goal), default=None, none="None")
    measured_error: Mapping[str, Any] = field(
        kinds.mapping(kinds.text(), kinds.Kind(lambda one: one), "a mapping", "number"), factory=dict
    )

    def __attrs_post_init__(self) -> None:
        structure, names = self.scene.structure, self.scene.structure.node_index
        if not structure.strings:
            raise refused(self, f"scene '{self.scene.name}' has no strings: there is nothing to act with")
        unit = "m" if self.action is Command.REST_LENGTH else "N/m"
        for name in ("low", "high"):
            limits = real_array(f"task: {name}", getattr(self, name), (len(structure.strings),), unit)
            object.__setattr__(self, name, limits)
        for string, low, high in zip(structure.strings, self.low, self.high, strict=True):
            if not 0 <= low <= high:
                raise refused(
                    self, f"string '{string.name}': low = {low:g}, high = {high:g} {unit}; allowed: 0 <= low <= high"
                )
        for name in self.observed:
            check_known("task: observed", name, READERS, "part of an observation")
        need = {
            "goal": (self.goal, "give the task a goal"),
            "target": (self.scene.target, f"scene '{self.scene.name}' has none"),
            "imu": (len(self.sensors), f"scene '{self.scene.name}' has neither rods nor bodies that carry sensors"),
        }
        for name in ("goal", "target", "imu"):
            if name in self.observed and not need[name][0]:
                raise refused(self, f"observed has '{name}': {need[name][1]}, or leave it out")
        if len(set(self.observed)) < len(self.observed):
            raise refused(self, f"observed = {self.observed}; name each once")
        if not self.observed:
            raise refused(self, f"observed = (); name at least one of {', '.join(READERS)}")
        for name in () if self.goal is None else self.goal.nodes:
            check_known("task: goal", name, names, "node")
        if self.goal is not None and not self.goal.nodes:
            raise refused(self, "goal: nodes = (); name at least one node")
        substeps(self.period, self.engine.timestep)
        if self.start is not None and (self.start.displacement or self.start.speed):
            require(None, self.scene, "random starts")

    def observe(self, state: State) -> dict[str, Array]:
        """Observations, (n, ...) each, by their names."""
        return {name: READERS[name](self, state) for name in self.observed}

    def scored(self, before: State, after: State, lost: NDArray[np.bool_] | None = None) -> dict[str, Array]:
        """The terms of the reward (n,) by their names; 0 of robots that are lost.

        Raises:
            OptionError: where `terms` returns no mapping of finite numbers.
        """
        found, kept = self.terms(self, before, after), np.ones(len(after.time), bool) if lost is None else ~lost
        if not isinstance(found, Mapping) or not all(isinstance(name, str) for name in found):
            raise OptionError(
                f"task: terms returned {value_text(found)}; it must be a mapping of names to numbers (n,)"
            )
        scores = {name: np.zeros(len(kept)) for name in found}
        for name, term in found.items():
            given = term[kept] if np.shape(term) == kept.shape else term
            scores[name][kept] = real_array(f"task: term {name!r} of the reward", given, (int(kept.sum()),))
        return scores

    def commanded(self, actions: Array) -> Array:
        """Commands of normalised actions: -1 is `low`, 1 is `high`."""
        return self.low + 0.5 * (np.clip(actions, -1.0, 1.0) + 1.0) * (self.high - self.low)

    def draw_goal(self, generator: np.random.Generator) -> Array:
        """A goal (3,) [m]; zeros where there is none."""
        if self.goal is None:
            return np.zeros(3)
        return self.middle(self.scene.nodes0) + np.array(self.goal.reach) * generator.uniform(-1, 1, 3)

    def middle(self, nodes: Array) -> Array:
        """Middle (..., 3) of the nodes (..., N, 3) that have the goal."""
        assert self.goal is not None  # as the task's check has it
        index = self.scene.structure.node_index
        return np.asarray(nodes[..., [index[name] for name in self.goal.nodes], :].mean(axis=-2))

    @cached_property
    def moving(self) -> list[int]:
        """Rows of the nodes that are not fixed."""
        structure = self.scene.structure
        return [row for name, row in structure.node_index.items() if name not in structure.fixed_nodes]

    @cached_property
    def sensors(self) -> Array:
        """Rows of two nodes (I, 2) of each rod, then of each body: its first two."""
        structure = self.scene.structure
        pairs = [pair.tolist() for pair in structure.rod_nodes]
        pairs += [[structure.node_index[name] for name in body.nodes[:2]] for body in structure.bodies]
        return np.array(pairs, int).reshape(-1, 2)

    def targets(self, state: State) -> Array:
        """Target node positions (n, N, 3) [m] at these times."""
        assert self.scene.target is not None
        return target_nodes(self.scene.structure, self.scene.target, state.time)


def _shape(task: Task, state: State) -> Array:
    """Nodes from the point of the ground below their centre of mass."""
    centre = centre_of_mass(task.scene.structure, state.nodes)
    centre[:, 2] = 0.0
    return np.asarray(state.nodes - centre[:, None])


def _imu(task: Task, state: State) -> Array:
    """Direction, angular velocity across it, a - g of the middle (n, I, 9) of each rod and body, by its two nodes."""
    ends, rates, pulls = (part[:, task.sensors] for part in (state.nodes, state.velocities, state.accelerations))
    along = ends[:, :, 1] - ends[:, :, 0]
    length = np.linalg.norm(along, axis=2, keepdims=True)
    turning = np.cross(along, rates[:, :, 1] - rates[:, :, 0]) / length**2
    return np.concatenate([along / length, turning, pulls.mean(axis=2) - np.array(task.scene.gravity)], axis=2)


# What can be observed; docs/gymnasium.md has the sizes and units.
READERS: dict[str, Callable[[Task, State], Array]] = {
    "nodes": lambda task, state: state.nodes,
    "shape": _shape,
    "velocities": lambda task, state: state.velocities,
    "string_lengths": lambda task, state: state.lengths,
    "rest_lengths": lambda task, state: state.rest_lengths,
    "tensions": lambda task, state: state.tensions,
    "imu": _imu,
    "target": lambda task, state: task.targets(state),
    "goal": lambda task, state: state.goal - task.middle(state.nodes),
}


def substeps(period: float, timestep: float) -> int:
    """Steps of the engine in a control period; raise OptionError where it is no multiple, or has too many."""
    count = whole_ratio(period, timestep, "control period over the time step")
    if count > MOST_SUBSTEPS:
        raise OptionError(
            f"control period = {period:g} s: {count} steps of {timestep:g} s; at most {MOST_SUBSTEPS} are made in one"
        )
    return count


def target_distance(task: Task, before: State, after: State) -> dict[str, Array]:
    """Reward: minus the mean distance [m] of the moving nodes from their targets."""
    gaps = np.linalg.norm(after.nodes - task.targets(after), axis=2)
    return {"target": -gaps[:, task.moving].mean(axis=1)}


def effort(before: State, after: State, price: float) -> Array:
    """Reward (n,): minus `price` [1/J] times Σ T |ΔL0|, what the winches moved against the tensions of before."""
    return -price * np.sum(before.tensions * np.abs(after.rest_lengths - before.rest_lengths), axis=1)
