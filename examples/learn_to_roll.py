"""A policy that learns to roll the six-bar robot forward, by PPO of Stable-Baselines3, and the gait beside it.

    python -m pip install ".[gym]" stable-baselines3
    python examples/learn_to_roll.py                       # learns, plays, draws; under 20 minutes on two cores
    python examples/learn_to_roll.py --only-play           # with the policy of before
    tensegrity-mj validate six_bar_roll --law examples/learn_to_roll.py:Policy

All robots are in one process. The policy sees the nodes and their velocities alone, so that it is a law like any other:
`Policy` plays it without PyTorch. Writes into --out: policy.npz, curve.csv, curve.png, scores.csv, roll.mp4.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.settings import Integrator
from tensegrity_mj.learning.tasks import Task, task_of
from tensegrity_mj.model.rods import centre_of_mass

HERE = Path("build/roll")
SEEN = ("shape", "velocities")
HELD = 4  # control periods for which an action is held: a robot tips in some tenths of a second
ROBOTS, HORIZON = 32, 25  # of PPO: robots, and actions of each between two improvements: an episode


class Policy:
    """The learned policy as a law: rest lengths of the strings, from the nodes and their velocities.

    Args:
        scene: of the robot; sampled by the task's period, as in the environment. Actions are held for several.
        weights: the file that learning wrote.
    """

    command = tmj.Command.REST_LENGTH

    def __init__(self, scene: tmj.Scene, weights: str = str(HERE / "policy.npz")) -> None:
        self.task = task_of("SixBarRoll")
        with np.load(weights) as held:
            self.parts = dict(held)
        self._number, self._latest = -1, np.zeros(0)

    def __call__(self, moment: float, nodes: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """(M,) [m]."""
        number = int(moment / (HELD * self.task.period) + 1e-6)
        if number != self._number:
            self._number, self._latest = number, self.actions(nodes[None], velocities[None])[0]
        return np.asarray(self.task.commanded(self._latest))

    def actions(self, nodes: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """(n, M) within [-1, 1], of node positions and velocities (n, N, 3)."""
        below = centre_of_mass(self.task.scene.structure, nodes)[:, None] * [1.0, 1.0, 0.0]
        seen = np.concatenate([nodes - below, velocities], axis=1).reshape(len(nodes), -1)
        parts = self.parts
        value = np.clip((seen - parts["mean"]) / np.sqrt(parts["variance"] + 1e-8), -10.0, 10.0)
        for layer in range(int(parts["layers"])):
            value = np.tanh(value @ parts[f"weight{layer}"].T + parts[f"bias{layer}"])
        return np.clip(value @ parts["weight"].T + parts["bias"], -1.0, 1.0)


def learn(out: Path, periods: int, seed: int) -> None:
    """Write policy.npz and curve.csv after so many control periods of all robots together."""
    import torch
    from gymnasium.vector import VectorWrapper
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from tensegrity_mj.learning.gymnasium import StableBaselinesVecEnv, TensegrityVectorEnv

    class Held(VectorWrapper):  # type: ignore[type-arg]
        """Robots whose actions are held."""

        def step(self, actions: np.ndarray) -> Any:
            total: Any = 0.0
            for _ in range(HELD):
                seen, reward, lost, late, info = self.env.step(actions)
                total = total + reward
                if np.any(lost | late):
                    break  # all end together, but for what diverges
            return seen, total, lost, late, info

    torch.set_num_threads(1)  # the robots have threads of their own
    task = replace(task_of("SixBarRoll"), observed=SEEN)
    robots = VecNormalize(
        StableBaselinesVecEnv(Held(TensegrityVectorEnv(ROBOTS, task, autoreset_mode="SameStep"))), gamma=0.93
    )
    model = PPO(
        "MlpPolicy",
        robots,
        n_steps=HORIZON,
        batch_size=ROBOTS * HORIZON // 4,
        n_epochs=12,
        gamma=0.93,
        learning_rate=lambda left: 5e-4 * max(left, 0.1),
        policy_kwargs={"net_arch": [128, 64], "log_std_init": -1.0},
        seed=seed,
        device="cpu",
    )
    # It begins with strings about as long as designed.
    designed = 2 * (task.scene.structure.rest_lengths - task.low) / (task.high - task.low) - 1
    torch.nn.init.constant_(model.policy.action_net.bias, float(designed.mean()))
    curve: list[tuple[Any, ...]] = [("periods", "seconds", "reward per episode [m]")]
    began = time.monotonic()
    rewards: list[float] = []

    def note(held: dict[str, Any], _: Any = None) -> bool:
        rewards.append(float(np.mean(robots.get_original_reward())))
        done = len(rewards) * ROBOTS * HELD
        if len(rewards) % (4 * HORIZON) == 0:
            mean = HORIZON * float(np.mean(rewards[-4 * HORIZON :]))
            curve.append((done, round(time.monotonic() - began, 1), mean))
            print(f"{done} of {periods} periods, {curve[-1][1]} s: {mean:.3f} m an episode", flush=True)
        return True

    model.learn(periods // HELD, callback=note)
    parts: dict[str, Any] = {"mean": robots.obs_rms.mean, "variance": robots.obs_rms.var}
    layers = [one for one in model.policy.mlp_extractor.policy_net if isinstance(one, torch.nn.Linear)]
    for number, layer in enumerate(layers):
        parts[f"weight{number}"], parts[f"bias{number}"] = (p.detach().double().numpy() for p in layer.parameters())
    parts["weight"], parts["bias"] = (p.detach().double().numpy() for p in model.policy.action_net.parameters())
    np.savez(out / "policy.npz", layers=len(layers), **parts)
    with (out / "curve.csv").open("w", newline="") as file:
        csv.writer(file).writerows(curve)


def held(policy: Policy) -> Callable[[Any, int], np.ndarray]:
    """A player that holds each action as long as it did when it learned."""
    latest = np.zeros(0)

    def play(robots: Any, period: int) -> np.ndarray:
        nonlocal latest
        if period % HELD == 0:
            latest = policy.actions(robots.nodes, robots.velocities)
        return latest

    return play


def play(out: Path) -> None:
    """Write scores.csv, curve.png and roll.mp4."""
    import matplotlib.pyplot as plt
    from baselines import PLAYERS, Player, episodes  # beside this file; the law above needs neither

    task = task_of("SixBarRoll")
    fine = replace(task, engine=tmj.MuJoCo(task.engine.timestep / 4, Integrator(task.engine.integrator)))
    policy = Policy(task.scene, str(out / "policy.npz"))
    players: dict[str, Callable[[Task], Player]] = {
        "learned": lambda _: held(policy),
        **PLAYERS["SixBarRoll"],
    }
    rows: list[tuple[Any, ...]] = [("policy", "step [ms]", "reward", "its deviation", "distance [m]", "its deviation")]
    for name, player in players.items():
        for one in (task, fine) if name in ("learned", "gait") else (task,):
            reward, terms = episodes(one, player(one))
            numbers = [float(f(of)) for of in (reward, terms["forward"]) for f in (np.mean, np.std)]
            rows.append((name, 1e3 * one.engine.timestep, *(round(number, 4) for number in numbers)))
            print(*rows[-1])
    with (out / "scores.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    curve = np.loadtxt(out / "curve.csv", delimiter=",", skiprows=1)
    figure, panel = plt.subplots(figsize=(6, 3.4), layout="constrained")
    panel.plot(curve[:, 0], curve[:, 2], label="while it learns, with noise")
    for number, (name, _, reward, *_) in enumerate(row for row in rows[1:] if row[1] == 1e3 * task.engine.timestep):
        panel.axhline(float(reward), color=f"C{number + 1}", ls="--", label=f"{name}, 20 seeds")
    panel.set(xlabel="control periods", ylabel="reward of an episode of 10 s [m]")
    panel.legend(fontsize=8, loc="center right")
    figure.savefig(out / "curve.png", dpi=150)
    run = tmj.simulate(
        task.scene, policy, task.engine, duration=10.0, actuation=tmj.Actuation.hold_rest_length(task.period)
    )
    tmj.render(run, out / "roll.mp4")


def main() -> None:
    """Learn, then play."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE, help="folder (default: %(default)s)")
    parser.add_argument("--periods", type=int, default=250_000, help="control periods (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only-play", action="store_true", help="play the policy of before")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if not options.only_play:
        learn(options.out, options.periods, options.seed)
    play(options.out)


if __name__ == "__main__":
    main()
