"""Many robots of this process as Stable-Baselines3 takes them, which needs stable_baselines3 and no extra."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from tensegrity_mj.basics.dependencies import optional
from tensegrity_mj.errors import OptionError

VecEnv: Any = optional("stable_baselines3.common.vec_env", "StableBaselinesVecEnv", "stable-baselines3").VecEnv


class StableBaselinesVecEnv(VecEnv):  # type: ignore[misc]
    """A vector of Gymnasium's environments as Stable-Baselines3's `VecEnv`: PPO("MlpPolicy", StableBaselinesVecEnv(v)).

    Stable-Baselines3 itself makes vectors of single environments only. `infos` have the terms of the reward,
    `terminal_observation` of an episode that ended, and `TimeLimit.truncated` where it was truncated and not
    terminated, so that the value of the state at the end is counted.

    Args:
        robots: a `TensegrityVectorEnv` with the autoreset mode "SameStep", as it is or in Gymnasium's wrappers.

    Raises:
        OptionError: for anything else.
        MissingPackageError: without stable_baselines3, when the name is imported.
    """

    def __init__(self, robots: VectorEnv[Any, Any, Any]) -> None:
        mode = getattr(robots, "metadata", {}).get("autoreset_mode")
        if not isinstance(robots, VectorEnv) or mode is not AutoresetMode.SAME_STEP:
            shown = f"{type(robots).__name__} with autoreset_mode = {mode}"
            raise OptionError(f"robots: {shown}; give a TensegrityVectorEnv with autoreset_mode='SameStep'")
        self.robots = robots
        super().__init__(robots.num_envs, robots.single_observation_space, robots.single_action_space)

    def reset(self) -> Any:
        """Begin all episodes, by the seeds of `seed`; the observations (n, size)."""
        seeds: Any = None if None in self._seeds else list(self._seeds)
        seen, _ = self.robots.reset(seed=seeds)
        self._reset_seeds()
        self._reset_options()
        return seen

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the actions of `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """A step of all; where an episode ended, the observation is the next one's first."""
        seen, reward, terminated, truncated, info = self.robots.step(self._actions)
        terms = {name: part for name, part in info.items() if not name.startswith(("_", "final_"))}
        infos: list[dict[str, Any]] = [{name: part[n] for name, part in terms.items()} for n in range(self.num_envs)]
        ended = terminated | truncated
        for number in np.flatnonzero(ended):
            infos[number]["terminal_observation"] = info["final_obs"][number]
            infos[number]["TimeLimit.truncated"] = bool(truncated[number] and not terminated[number])
        return seen, reward.astype(np.float32), ended, infos

    def close(self) -> None:
        """Close the windows."""
        self.robots.close()

    def get_images(self) -> Sequence[Any]:
        """Pictures (480, 640, 3) of all robots."""
        return list(self.robots.render() or ())

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector, which all robots share, once for each."""
        return [getattr(self.robots, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the vector, for all robots."""
        setattr(self.robots.unwrapped, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **options: Any) -> list[Any]:
        """Call a method of the vector once; its result, once for each robot."""
        result = getattr(self.robots, method_name)(*args, **options)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False: there are no wrappers of single environments."""
        return [False for _ in self._get_indices(indices)]
