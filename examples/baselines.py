"""What simple policies score in the Gymnasium environments: standing still, chance, an open-loop gait, and LQR.

    python examples/baselines.py                 # a table: 20 seeds of each, some minutes
    python examples/baselines.py PrismReach

`learn_to_roll.py` sets a learned policy beside them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete

import tensegrity_mj as tmj
from tensegrity_mj.learning.tasks import State, Task, World, gait, task_of

SEEDS = range(1000, 1020)  # none that anything has learned with
Player = Callable[[State, int], np.ndarray]  # the robots (n), the number of the period -> actions (n, M)


def normalised(task: Task, lengths: np.ndarray) -> np.ndarray:
    """The actions that command rest lengths (..., M) [m]."""
    return 2 * (lengths - task.low) / (task.high - task.low) - 1


def stands(task: Task) -> Player:
    """All strings keep the rest lengths of the design."""
    still = normalised(task, task.scene.structure.rest_lengths)
    return lambda robots, _: np.broadcast_to(still, (len(robots.nodes), len(still)))


def at_random(task: Task) -> Player:
    """Every action is as likely."""
    generator = np.random.default_rng(0)
    return lambda robots, _: generator.uniform(-1, 1, (len(robots.nodes), len(task.low)))


def rolls(task: Task) -> Player:
    """The gait of docs/rolling.md, open loop, planned along x."""
    planned = gait(task)
    return lambda robots, period: np.broadcast_to(planned[period], (len(robots.nodes), len(task.low)))


def lqr(task: Task, effort: float = 1.0) -> Player:
    """LQR about the shape that brings the nodes to the goal by the least changes of rest lengths, by the linear model.

    Sampled as the environment is; it knows nothing of winches' speeds. Σ |y - goal|² + effort Σ |v|² is least, with y
    the middle of the nodes and v the changes of rest lengths, in metres both.
    """
    scene = task.scene
    assert task.goal is not None
    model = tmj.linearize(scene, nodes=scene.nodes0, velocities=0 * scene.nodes0)
    A, B, _, _, _ = cont2discrete((model.A, model.B, model.C, np.zeros((len(model.C), model.B.shape[1]))), task.period)
    rows = [3 * scene.structure.node_index[name] + axis for axis in range(3) for name in task.goal.nodes]
    C = model.C[rows].reshape(3, len(task.goal.nodes), -1).mean(axis=1)
    cost = effort * np.eye(B.shape[1])
    riccati = solve_discrete_are(A, B, C.T @ C + 1e-6 * np.eye(len(A)), cost)
    gain = np.linalg.solve(cost + B.T @ riccati @ B, B.T @ riccati @ A)
    still = np.linalg.solve(np.eye(len(A)) - A, B)  # of the state, by constant changes
    rest = -np.linalg.solve(model.A, model.residual)  # and without any: where it hangs under its weight
    reach = C @ still
    aim = reach.T @ np.linalg.inv(reach @ reach.T + 1e-6 * np.eye(3))

    def play(robots: State, _: int) -> np.ndarray:
        lengths = []
        for nodes, velocities, goal in zip(robots.nodes, robots.velocities, robots.goal, strict=True):
            v = aim @ (goal - task.middle(scene.nodes0) - C @ rest)
            off = model.deviation(nodes, velocities) - still @ v - rest
            lengths.append(scene.structure.rest_lengths + v - gain @ off)
        return normalised(task, np.array(lengths))

    return play


def episodes(task: Task, player: Player) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The rewards (20,) of an episode for each seed, and the sums of their terms."""
    world = World(task, len(SEEDS))
    everyone = np.arange(len(SEEDS))
    world.start(everyone, [np.random.default_rng(seed) for seed in SEEDS])
    total, terms = np.zeros(len(SEEDS)), {}
    for period in range(task.steps):
        out = world.step(everyone, player(world.state(), period))
        total += out.reward
        for name, term in out.terms.items():
            terms[name] = terms.get(name, 0.0) + term
    return total, terms


PLAYERS: dict[str, dict[str, Callable[[Task], Player]]] = {
    "SixBarRoll": {"stands": stands, "at random": at_random, "gait": rolls},
    "PrismReach": {"stands": stands, "at random": at_random, "LQR": lqr},
    "SpineReach": {"stands": stands, "at random": at_random, "LQR": lqr},
}


def main() -> None:
    """Print the table."""
    print("| task | policy | reward, 20 seeds | its deviation | of its terms |\n|---|---|---|---|---|")
    for name in sys.argv[1:] or PLAYERS:
        task = task_of(name)
        for policy, make in PLAYERS[name].items():
            reward, terms = episodes(task, make(task))
            parts = ", ".join(f"{term} {np.mean(each):.3f}" for term, each in terms.items())
            print(f"| {name} | {policy} | {reward.mean():.3f} | {reward.std():.3f} | {parts} |", flush=True)


if __name__ == "__main__":
    main()
