"""What a task is: a scene, what is commanded and observed, a reward in terms, a start and a goal. No learning library.

Arrays have a leading axis: n robots at once; dm_control has one. SI units, world frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.law import Command
from tensegrity_mj.dynamics.target import target_nodes
from tensegrity_mj.engines.mujoco.engine import MuJoCo
from tensegrity_mj.model.rods import centre_of_mass
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.tasks.starts import RandomStart


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


@dataclass(frozen=True)
class Goal:
    """A place that is drawn for each episode, evenly from a box, for the middle of some nodes.

    Attributes:
        nodes: their names.
        reach: half the sides of the box [m], about where the middle is by design.
    """

    nodes: tuple[str, ...]
    reach: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Task:
    """What a robot is to do.

    Attributes:
        scene: robot and surroundings.
        terms: reward of a control period by names, (n,) each, from the states before and after it; they are summed.
        low, high: limits of what is commanded (M,): rest lengths [m], or force densities [N/m].
        observed: names of READERS, in order.
        action: what is commanded.
        period: between two commands [s], a multiple of the engine's step.
        steps: periods in an episode.
        engine: step and integrator.
        start: random starts.
        goal: what is drawn for each episode.
        measured_error: as `measured_error` of this task gave it.
    """

    scene: Scene
    terms: Callable[[Task, State, State], Mapping[str, Array]]
    low: Array
    high: Array
    observed: tuple[str, ...]
    action: Command = Command.REST_LENGTH
    period: float = 0.1
    steps: int = 100
    engine: MuJoCo = field(default_factory=MuJoCo)
    start: RandomStart | None = None
    goal: Goal | None = None
    measured_error: Mapping[str, Any] = field(default_factory=dict)

    def observe(self, state: State) -> dict[str, Array]:
        """What is observed, (n, ...) each, by its name."""
        return {name: READERS[name](self, state) for name in self.observed}

    def commanded(self, actions: Array) -> Array:
        """Commands of normalised actions: -1 is `low`, 1 is `high`."""
        return self.low + 0.5 * (np.clip(actions, -1.0, 1.0) + 1.0) * (self.high - self.low)

    def draw_goal(self, generator: np.random.Generator) -> Array:
        """A goal (3,) [m]; zeros where there is none."""
        if self.goal is None:
            return np.zeros(3)
        return self.middle(self.scene.nodes0) + np.array(self.goal.reach) * generator.uniform(-1, 1, 3)

    def middle(self, nodes: Array) -> Array:
        """(..., 3) of the nodes (..., N, 3) that have the goal."""
        assert self.goal is not None
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
        return np.array(pairs).reshape(-1, 2)

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
    """Of each rod and body, by its two nodes: direction, angular velocity across it, a - g of the middle (n, I, 9)."""
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


def target_distance(task: Task, before: State, after: State) -> dict[str, Array]:
    """Minus the mean distance [m] of the moving nodes from their targets."""
    gaps = np.linalg.norm(after.nodes - task.targets(after), axis=2)
    return {"target": -gaps[:, task.moving].mean(axis=1)}


def effort(before: State, after: State, price: float) -> Array:
    """Minus `price` [1/J] times Σ T |ΔL0|: what the winches moved, against the tensions of before (n,)."""
    return -price * np.sum(before.tensions * np.abs(after.rest_lengths - before.rest_lengths), axis=1)
