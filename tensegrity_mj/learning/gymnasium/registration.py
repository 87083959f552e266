"""The ids of the environments."""

from __future__ import annotations

import gymnasium

from tensegrity_mj.learning.tasks.robots import TASKS, task_of

HERE = "tensegrity_mj.learning.gymnasium.environments"


def register() -> None:
    """Register Tensegrity/SixBarRoll-v0 and the others; once is enough."""
    for name in TASKS:
        if f"Tensegrity/{name}-v0" not in gymnasium.registry:
            gymnasium.register(
                f"Tensegrity/{name}-v0",
                entry_point=f"{HERE}:unlimited",
                vector_entry_point=f"{HERE}:TensegrityVectorEnv",
                max_episode_steps=task_of(name).steps,
                kwargs={"task": name},
            )
