"""The tasks that come with the package, by their names; docs/gymnasium.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import check_known
from tensegrity_mj.controllers.program import Program
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.errors import OptionError
from tensegrity_mj.learning.tasks.definition import Goal, RandomStart, State, Task, effort
from tensegrity_mj.library.prism import prism
from tensegrity_mj.library.rolling import SixBarRoll
from tensegrity_mj.library.six_bar import icosahedron
from tensegrity_mj.library.spine import spine
from tensegrity_mj.model.elements.contact import Contact
from tensegrity_mj.model.members import Support
from tensegrity_mj.model.rods import centre_of_mass
from tensegrity_mj.model.scene import Scene

# [m], as `measured_error(name)` gave it: three episodes of random actions. A robot that is thrown about so lands on
# another triangle for the least cause; on its `gait` it does not.
MEASURED: dict[str, dict[str, Any]] = {
    "SixBarRoll": {"largest": 3.6, "mean": 0.78, "after_1_s": 5.1e-3, "gait": 3.0e-4, "reference": "RK4, h = 125 µs"},
    "PrismReach": {"largest": 4.5e-6, "mean": 5.0e-7, "after_1_s": 9.4e-7, "reference": "DAE, rtol = atol = 1e-10"},
    "SpineReach": {"largest": 8.4e-5, "mean": 8.6e-6, "after_1_s": 7.1e-5, "reference": "DAE, rtol = atol = 1e-10"},
}
OBSERVED = ("velocities", "rest_lengths", "tensions", "imu")
# Steps of 2 ms do not resolve the default floor. This one, a quarter as hard, rolls 2 % less far than a rigid one.
SOFT = Contact(floor=0.0, stiffness=4e4, impedance=(0.01, 0.95, 2e-3, 0.5, 2.0))
STRAIGHT = 1.15  # rad: the way on which the robot rolls straight on, from where it stands (`library.rolling`)
NEAR = RandomStart(displacement=5e-3, speed=0.02)


def limited(scene: Scene, least: float, most: float, speed: float) -> tuple[Scene, Array, Array]:
    """The scene with winches of this speed [m/s], and limits of rest lengths (M,) as fractions of the designed ones."""
    designed = scene.structure.rest_lengths
    structure = scene.structure.with_strings(winch_speed=speed)
    return scene.with_(structure=structure), least * designed, most * designed


def _rolled(task: Task, before: State, after: State) -> dict[str, Array]:
    """Reward: the distance that the centre of mass moved along x [m], less what the winches spent."""
    places = [centre_of_mass(task.scene.structure, state.nodes)[:, 0] for state in (before, after)]
    return {"forward": places[1] - places[0], "effort": effort(before, after, 1e-4)}


def _reached(task: Task, before: State, after: State) -> dict[str, Array]:
    """Reward: minus the distance of the middle of its nodes from the goal [m], less what the winches spent."""
    distance = np.linalg.norm(task.middle(after.nodes) - after.goal, axis=1)
    return {"distance": -distance, "effort": effort(before, after, 1e-4)}


def six_bar_roll() -> Task:
    """The six-bar robot on a floor; forward is x."""
    robot = icosahedron(drop=0.01, tilt=(0.0, 0.0, -STRAIGHT), name="six_bar_roll")
    robot = robot.with_(contact=SOFT)
    scene, low, high = limited(robot, 0.35, 1.05, 0.3)
    return Task(scene, _rolled, low, high, ("shape", *OBSERVED), engine=MuJoCo(2e-3), start=NEAR)


def prism_reach() -> Task:
    """A prism of three rods on pinned feet, its top triangle to be moved to a place."""
    scene = prism(name="prism_reach", gravity=9.81)
    structure = scene.structure
    rods = tuple(replace(rod, support=Support.pinned()) for rod in structure.rods)
    strings = tuple(string for string in structure.strings if not string.name.startswith("bottom"))
    structure = replace(structure, rods=rods, strings=strings)
    scene, low, high = limited(scene.with_(structure=structure, contact=None), 0.6, 1.2, 0.2)
    goal = Goal(("r1b", "r2b", "r3b"), (0.04, 0.04, 0.02))
    observed = ("nodes", *OBSERVED, "goal")
    return Task(scene, _reached, low, high, observed, engine=MuJoCo(2e-3), period=0.04, start=NEAR, goal=goal)


def spine_reach() -> Task:
    """A spine of four vertebrae, its highest to be moved to a place."""
    scene, low, high = limited(spine(push=0.0, damping=5.0, name="spine_reach"), 0.6, 1.2, 0.2)
    goal = Goal(("left3", "right3", "front3", "back3"), (0.06, 0.06, 0.0))
    observed = ("nodes", *OBSERVED, "goal")
    return Task(scene, _reached, low, high, observed, engine=MuJoCo(1e-3), period=0.04, start=NEAR, goal=goal)


def gait(task: Task, steps: int = 6, move: float = 1.0, pause: float = 0.25) -> Array:
    """Actions (T, M) that roll `six_bar_roll()` forward, open loop; see `library.rolling.SixBarRoll`."""
    scene = SixBarRoll(steps=steps, heading=STRAIGHT, move=move, pause=pause)()
    assert scene.control is not None
    moves: Any = scene.control.options["moves"]
    law = Program(scene.structure, moves=moves)
    lengths = np.array([law(task.period * step) for step in range(task.steps)])
    return 2.0 * (lengths - task.low) / (task.high - task.low) - 1.0


TASKS: dict[str, Callable[[], Task]] = {
    "SixBarRoll": six_bar_roll,
    "PrismReach": prism_reach,
    "SpineReach": spine_reach,
}


@cache
def _named(name: str) -> Task:
    return replace(TASKS[name](), measured_error=MEASURED[name])


def task_of(task: str | Task) -> Task:
    """Return the task of that name; raise OptionError if there is none."""
    if isinstance(task, Task):
        return task
    if not isinstance(task, str):
        raise OptionError(f"task = {task!r}; use a Task, or the name of one: {', '.join(TASKS)}")
    check_known("task", task, TASKS, "task")
    return _named(task)
