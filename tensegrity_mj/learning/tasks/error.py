"""Error of a task's steps, against a fine reference: the same commands, held in another engine."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.checks import checked, real_array
from tensegrity_mj.basics.kinds import whole
from tensegrity_mj.controllers.replay import Replay
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.engines.reference.dae import DAE
from tensegrity_mj.learning.tasks.definition import Task
from tensegrity_mj.learning.tasks.robots import task_of
from tensegrity_mj.learning.tasks.world import World
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.simulation import simulate

FINER = 16  # the step of the reference in a scene with contact, which the DAE does not have


def measured_error(
    task: str | Task, episodes: int = 3, steps: int | None = None, seed: int = 0, actions: ArrayLike | None = None
) -> dict[str, Any]:
    """Measure how far nodes are from a fine reference, from starts drawn as the task has them.

    The reference is the DAE at tolerances of 1e-10, or for contact MuJoCo with RK4 and a step 16 times as short.

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
    contact = task.scene.contact is not None
    engine = MuJoCo(task.engine.timestep / FINER) if contact else DAE(rtol=1e-10, atol=1e-10)
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
