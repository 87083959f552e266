"""Stand-ins for Stable-Baselines3, which the tests do not install: its vectors, and a PPO that learns nothing."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest


class StandIn:
    """The part of Stable-Baselines3's VecEnv that acts when it is made and seeded."""

    def __init__(self, num_envs: int, observation_space: Any, action_space: Any) -> None:
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
        self.render_mode = self.get_attr("render_mode")[0]
        self._reset_seeds()

    def _reset_seeds(self) -> None:
        self._seeds: list[Any] = [None] * self.num_envs

    def _reset_options(self) -> None:
        pass

    def _get_indices(self, indices: Any) -> Any:
        return range(self.num_envs) if indices is None else [indices] if isinstance(indices, int) else indices

    def seed(self, seed: int) -> None:
        self._seeds = [seed + number for number in range(self.num_envs)]

    def get_attr(self, name: str, indices: Any = None) -> list[Any]:
        raise NotImplementedError


class PPO:
    """A model that plays two steps in place of learning, and predicts one action whatever it sees."""

    def __init__(self, policy: str, robots: Any, *, seed: int, **options: Any) -> None:
        self.robots = robots
        self.action = np.random.default_rng(seed).uniform(-1, 1, robots.action_space.shape).astype(np.float32)

    def learn(self, total_timesteps: int) -> None:
        self.robots.reset()
        for _ in range(2):
            self.robots.step_async(np.tile(self.action, (self.robots.num_envs, 1)))
            seen, reward, done, infos = self.robots.step_wait()
            assert len(seen) == len(reward) == len(done) == len(infos) == self.robots.num_envs

    def predict(self, seen: Any, deterministic: bool = False) -> tuple[Any, None]:
        return np.tile(self.action, (len(seen), 1)), None

    def save(self, path: str) -> None:
        Path(f"{path}.zip").touch()


@contextmanager
def stand_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Put the stand-ins in the place of the library; gives the adapter to it."""
    for name in ("stable_baselines3", "stable_baselines3.common", "stable_baselines3.common.vec_env"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setattr(sys.modules["stable_baselines3"], "PPO", PPO, raising=False)
    monkeypatch.setattr(sys.modules["stable_baselines3.common.vec_env"], "VecEnv", StandIn, raising=False)
    monkeypatch.delitem(sys.modules, "tensegrity_mj.learning.gymnasium.stable_baselines", raising=False)
    from tensegrity_mj.learning.gymnasium.stable_baselines import StableBaselinesVecEnv

    try:
        yield StableBaselinesVecEnv
    finally:
        import tensegrity_mj.learning.gymnasium as room

        sys.modules.pop("tensegrity_mj.learning.gymnasium.stable_baselines", None)
        vars(room).pop("StableBaselinesVecEnv", None)
